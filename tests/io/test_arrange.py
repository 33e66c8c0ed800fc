"""Landmarks by name."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shapefit.io.arrange import arrange
from shapefit.io.names import match_landmarks
from shapefit.io.readers.items import keep_shape_landmarks
from shapefit.records import Shapes


@pytest.mark.parametrize(
    ("wanted", "told"),
    [
        (
            ["head", "left hnad"],
            ["there is no landmark 'left hnad'; did you mean 'left hand' "],
        ),
        (
            ["head", "xyz"],
            ["there is no landmark 'xyz'; use one of: left hand, right "],
        ),
        (
            ["door", "roof"],
            ["none of the 2 landmarks (door, roof) is known; known are "],
        ),
        ([*"abcdefghijkl", "head"], [*["there is no landmark"] * 10, "... and 2 more"]),
    ],
)
def test_landmarks_that_are_not_there(problems, wanted, told):
    have = ["left hand", "right hand", "head", "foot"]
    lines = problems(match_landmarks, have, wanted, "views.h5")
    for line, start in zip(lines, told, strict=True):
        assert line.removeprefix("views.h5: ").startswith(start)


def test_what_is_not_there_is_hidden(landmarks):
    names = ("foot", "tail", "head", "right hand", "left hand")
    arranged = arrange(landmarks, names)
    assert arranged.landmark_names == names
    assert_array_equal(arranged.landmarks[:, [2, 4, 3, 0]], landmarks.landmarks)
    assert_array_equal(arranged.confidence[:, [2, 4, 3, 0]], landmarks.confidence)
    assert np.isnan(arranged.landmarks[:, 1]).all()
    assert (arranged.confidence[:, 1] == 0).all()
    joined = dataclasses.replace(landmarks, edges=np.array([[0, 1], [0, 3], [0, 9]]))
    assert arrange(joined, ("foot", "head"), omit=True).edges.tolist() == [[1, 0]]


@pytest.mark.parametrize("kind", [bool, np.int8])
def test_labels_go_with_their_landmarks(landmarks, rng, kind):
    labels = (rng.random((5, 4)) < 0.5).astype(kind)
    square = np.arange(20.0).reshape(5, 4)  # has the shape of labels, by chance
    extras = {"corrupted": labels, "outliers": labels[:, :3], "bounding_box": square}
    names = ("foot", "tail", "head", "right hand", "left hand")
    arranged = arrange(dataclasses.replace(landmarks, extras=extras), names)
    moved = arranged.extras["corrupted"]
    assert moved.dtype == kind
    assert_array_equal(moved[:, [2, 4, 3, 0]], labels)
    assert not moved[:, 1].any()
    assert_array_equal(arranged.extras["bounding_box"], square)
    # of something else
    assert_array_equal(arranged.extras["outliers"], labels[:, :3])


def test_shapes_lack_no_landmark(shapes, problems):
    line, _ = problems(arrange, shapes, ("head", "foot"), "cars.h5")
    assert line.startswith("cars.h5: there is no landmark 'left hand'")


CHAIN = np.array([[0, 1], [1, 2], [2, 3], [1, 4]])
"""A tree of five landmarks: from hip to knee, ankle and toe, and from knee to shin."""


def chain(rng, **fields):
    names = ("hip", "knee", "ankle", "toe", "shin")
    return Shapes(rng.normal(size=(2, 5, 3)), landmark_names=names, **fields)


def bones_of(shapes):
    names = shapes.landmark_names
    return {(names[above], names[below]) for above, below in shapes.edges}


@pytest.mark.parametrize(
    ("names", "bones"),
    [
        (("hip", "toe", "shin"), {("hip", "toe"), ("hip", "shin")}),
        (("shin", "knee", "toe"), {("knee", "shin"), ("knee", "toe")}),
        (("toe", "shin"), set()),
    ],
)
def test_what_is_kept_of_a_tree_hangs_on_the_nearest_ancestor(rng, names, bones):
    shapes = chain(rng, edges=CHAIN)
    kept = keep_shape_landmarks(shapes, names)
    assert kept.landmark_names == names
    assert bones_of(kept) == bones


def test_what_is_kept_of_edges_that_are_no_tree_has_those_that_are_whole(rng):
    ring = np.array([[0, 1], [1, 2], [2, 0], [0, 3], [2, 3]])
    kept = keep_shape_landmarks(chain(rng, edges=ring), ("hip", "toe"))
    assert bones_of(kept) == {("hip", "toe")}


def test_what_is_kept_knows_of_no_mirror(rng):
    """The partner of a landmark may be gone."""
    paired = chain(rng, mirror_index=np.array([1, 0, 2, 3, 4]))
    assert keep_shape_landmarks(paired, ("hip", "toe")).mirror_index is None
