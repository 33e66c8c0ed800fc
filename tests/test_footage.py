"""Slices of the footage and of detected people: errors stay within 2% of what they were."""

import numpy as np
import pytest

import shapefit
from benchmarks.coverage import read_bodies
from benchmarks.detected import THIRTEEN
from benchmarks.footage import (
    CELLS,
    SIZE,
    choose_clips,
    film,
    gaps,
    lasting_noise,
    look,
    measure,
)
from shapefit.evaluation.metrics import similarity
from shapefit.geometry.normalisation import normalise
from shapefit.io import read_shapes
from shapefit.pipelines.evaluate.measure import with_shapes_of
from tests.io.files import load
from tests.pipelines.fitted import fit_images

BAND = 0.02


@pytest.fixture
def error(tmp_path):
    """Mean normalised similarity error of landmarks lifted by the dictionary people."""

    def error(images, truth, names, **keys):
        found = with_shapes_of(fit_images(tmp_path, images, "people", **keys)[0], names)
        rows = [truth.items.index(item) for item in found.items]
        true = truth.shapes[rows][..., [truth.landmark_names.index(name) for name in names]]
        own = found.shapes[..., [found.landmark_names.index(name) for name in names]]
        return float(similarity(own, normalise(true).points).mean())

    return error


@pytest.mark.real_data
@pytest.mark.parametrize(("method", "stated"), [("posterior", 0.190), ("sequences", 0.155)])
def test_a_body_before_a_camera_at_rest(real_data, error, method, stated):
    shapes = read_shapes([real_data / "mocap/subject13_24fps.h5"])
    rng = np.random.default_rng(13)
    images, truth = film(shapes, choose_clips(shapes, 2, 3.0, rng), rng)
    found = error(images, truth, truth.landmark_names, method=method)
    assert found == pytest.approx(stated, rel=BAND)


@pytest.mark.slow
@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "ratio"),
    [
        ("to the hips, 1 m", 0.847),
        ("half hidden for a second", 0.822),
        ("left and right swapped", 0.744),
        ("stands", 0.797),
        ("walks off", 0.803),
        ("10 frames a second", 0.807),
        ("COCO and MediaPipe", 0.764),
    ],
)
def test_sequences_are_no_worse_than_their_images(real_data, name, ratio):
    """By the dictionary of the package, which knows the body: rough bars, the same comparison."""
    shapes = read_bodies(real_data / "mocap", ["other_subjects"], ["10"])["10"]
    (cell,) = (cell for cell in CELLS if cell.name == name)
    found = measure(cell, shapes, shapefit.read_dictionary("people"), 2, 3.0)
    assert found["ratio"] == pytest.approx(ratio, rel=BAND)
    assert found["ratio"] < 1.02
    assert found["sequences holds"] > 0.6


@pytest.mark.real_data
@pytest.mark.parametrize(("method", "stated"), [("posterior", 0.239), ("sequences", 0.213)])
def test_a_detected_man_on_a_beam(real_data, error, method, stated):
    folder = real_data / "detected/pose2sim_balancing"
    images = load(folder / "cam03.h5").take(slice(0, 100, 3))
    truth = read_shapes([folder / "cam03_truth.h5"], gaps=True)
    found = error(images, truth, THIRTEEN, method=method, frame_rate=20)
    assert found == pytest.approx(stated, rel=BAND)


def test_noise_lasts_and_gaps_have_their_share(rng):
    noise = lasting_noise(4000, 5, 24.0, rng)
    left = noise - noise.mean(axis=0)
    from_frame_to_frame = (left[1:] * left[:-1]).mean() / (left**2).mean()
    assert from_frame_to_frame == pytest.approx(np.exp(-1 / (24 * 0.11)), abs=0.03)
    assert gaps(4000, 5, rng).mean() == pytest.approx(0.1, abs=0.02)


def test_the_camera_sees_the_whole_body_upright(rng):
    body = np.zeros((3, 3, 4))
    body[:, 1] = [0.0, 0.5, 1.0, 1.7]
    for _ in range(20):
        visible, focal = look(body, rng)
        assert (visible[:, 2] > 0).all()
        assert (visible[:, 1, 3] < visible[:, 1, 0]).all()  # y points down: the head is above
        assert 0.8 * SIZE[0] <= focal <= 1.5 * SIZE[0]
