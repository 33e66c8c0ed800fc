"""Landmarks that a detector leaves at the border of the image, and sides that it exchanges."""

from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.io import LandmarkSet
from shapefit.pipelines.fit.lift import at_border
from shapefit.pipelines.fit.sequences import restore_sides

NAMES = ("hip", "knee", "ankle", "head")
EDGES = np.array([[0, 1], [1, 2], [0, 3]])
W, H = 640.0, 480.0


def images(points, **columns):
    return LandmarkSet(
        landmarks=np.array(points, float).T[None],
        landmark_names=NAMES,
        items=("a",),
        unit="px",
        columns=columns,
    )


def lifter(names=NAMES, size=None):
    dictionary = SimpleNamespace(edges=EDGES, landmark_names=names)
    return SimpleNamespace(dictionary=dictionary, image_size=size)


@pytest.mark.parametrize(
    ("points", "hidden"),
    [
        ([(300, 400), (300, 478), (320, 479), (300, 100)], "knee ankle"),
        ([(300, 400), (300, 470), (320, 479), (300, 100)], ""),  # its neighbour is in the image
        ([(300, 479), (300, 470), (320, 479), (300, 100)], ""),  # no neighbours
        ([(3, 200), (2, 300), (300, 400), (5, 100)], "hip knee head"),
        ([(3, 200), (638, 300), (300, 400), (300, 100)], ""),  # of other sides
    ],
)
def test_neighbours_at_one_border_are_not_seen(points, hidden):
    for found in (
        at_border(images(points, image_size=np.array([W, H])), lifter()),
        at_border(images(points), lifter(size=(W, H))),
    ):
        assert [name for name, at in zip(NAMES, found[0], strict=True) if at] == hidden.split()
    assert not at_border(images(points), lifter()).any()
    assert not at_border(images(points), lifter(("a", "b", "c", "d"), (W, H))).any()


def test_exchanged_frames_are_put_back_with_their_scores(rng):
    t, partner = 60, np.array([1, 0, 3, 2, 5, 4, 7, 6])
    left = rng.normal(size=(2, 4)) + np.array([[3.0], [0.0]])
    w = np.empty((t, 2, 8))
    w[..., ::2], w[..., 1::2] = left, -left
    w += 0.1 * np.sin(np.arange(t) / 5)[:, None, None]
    score = np.tile(np.linspace(0.2, 0.9, 8), (t, 1))
    clean = LandmarkSet(
        landmarks=w,
        landmark_names=tuple("abcdefgh"),
        items=tuple(map(str, range(t))),
        sequences=("walk",) * t,
        confidence=score,
        unit="px",
        columns={},
    )
    exchanging = SimpleNamespace(dictionary=SimpleNamespace(mirror_index=partner), frame_rate=24.0)
    wrong = np.isin(np.arange(t), range(20, 28))
    landmarks = np.where(wrong[:, None, None], w[..., partner], w)
    confidence = np.where(wrong[:, None], score[:, partner], score)
    mixed = clean.replaced(landmarks=landmarks, confidence=confidence)
    found = restore_sides(mixed, np.ones((t, 8), bool), exchanging)
    np.testing.assert_array_equal(found.exchanged, wrong)
    np.testing.assert_array_equal(found.images.landmarks, w)
    np.testing.assert_array_equal(found.images.confidence, score)
    assert not found.unsure.any()
    late = np.arange(t) >= 30
    half = clean.replaced(landmarks=np.where(late[:, None, None], w[..., partner], w))
    assert restore_sides(half, np.ones((t, 8), bool), exchanging).unsure.all()
