"""The figures of people by the posterior and by sequences are measured again."""

import json
from pathlib import Path

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
    lasting_noise,
    measure,
    place_before_camera,
    random_gaps,
)
from shapefit.evaluation.metrics import similarity_error
from shapefit.geometry.normalisation import normalise
from shapefit.io import read_shapes
from shapefit.pipelines.evaluate.measure import with_shapes_of
from shapefit.records import Landmarks
from tests.io.files import load
from tests.pipelines.fitted import fit_images
from tests.stated_figures import (
    BAND,
    keep_images,
    read_report,
    report,
    runner,
    within,
)

WHOLE_SEQUENCES = ("13_07", "13_09", "14_04", "14_05")


ON_THEM = {
    ("posterior", "Subject 13"): "0.2883",
    ("posterior", "Subject 14"): "0.1446",
    ("sequences", "Subject 13"): "0.1956",
    ("sequences", "Subject 14"): "0.0544",
}
"""Mean similarity errors, normalised, of two short sequences of each subject: 830
images.
"""


INSIDE = {("posterior", "Subject 13"): "0.974", ("sequences", "Subject 13"): "0.868"}
"""Share of their landmarks inside the 90% ellipsoids."""


def of_whole_sequences(images: Landmarks) -> np.ndarray:
    """Return the numbers of the images of WHOLE_SEQUENCES."""
    sequences = np.array(images.sequences, dtype=str)
    return np.flatnonzero(np.isin(sequences, WHOLE_SEQUENCES))


@pytest.mark.slow
@pytest.mark.real_data
def test_the_posterior_and_sequences_on_motion_capture(
    project, real_data, people_of_86, tmp_path
):
    folder = tmp_path / "results/people"
    results = {
        "posterior": "results/people/result.h5",
        "sequences": "results/people/sequences.h5",
    }
    run = runner(project, tmp_path, f"data={real_data / 'mocap'}")
    run("project", "mocap/project")
    (folder / "dictionary.h5").symlink_to(people_of_86)
    views = tmp_path / "results/mocap/landmarks.h5"
    count = keep_images(views, of_whole_sequences)
    run("fit", "people/fit")
    run("fit", "mocap/fit-sequences")
    run("eval", "people/eval", "--set", f"results={json.dumps(results)}")
    figures = report(folder / "report/report.csv")
    shares = shares_inside(folder / "report/report.csv")
    assert count == 830
    for (method, group), stated in ON_THEM.items():
        mean, _ = figures[method, "similarity", "normalised", group]
        assert within(mean, stated), (method, group, mean, stated)
    for column, stated in INSIDE.items():
        assert within(shares[column], stated), (column, shares[column])


def shares_inside(path: Path) -> dict[tuple[str, str], float]:
    """Return method and group -> share of landmarks inside the 90% ellipsoids."""
    shares = {}
    for row in read_report(path):
        if row["metric"] == "inside_90":
            shares[row["method"], row["group"]] = float(row["mean"])
    return shares


def points_of(shapes, names):
    """Return the shapes (n, 3, p) of these landmarks."""
    return shapes.as_columns()[
        ..., [shapes.landmark_names.index(name) for name in names]
    ]


@pytest.fixture
def error(tmp_path):
    """Mean normalised similarity error of landmarks lifted by the dictionary people."""

    def error(images, truth, names, **keys):
        fit, _ = fit_images(tmp_path, images, "people", **keys)
        result = with_shapes_of(fit, names)
        rows = [truth.items.index(item) for item in result.items]
        true = normalise(points_of(truth, names)[rows]).points
        errors = similarity_error(points_of(result, names), true)
        return float(errors.mean())

    return error


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("method", "stated"), [("posterior", 0.181), ("sequences", 0.155)]
)
def test_a_body_before_a_camera_at_rest(real_data, error, method, stated):
    shapes = read_shapes([real_data / "mocap/subject13_24fps.h5"])
    rng = np.random.default_rng(13)
    clips = choose_clips(shapes, 2, 3.0, rng)
    images, truth = film(shapes, clips, rng)
    measured = error(images, truth, truth.landmark_names, method=method)
    assert measured == pytest.approx(stated, rel=BAND)


RATIOS = {
    "to the hips, 1 m": 0.900,
    "half hidden for a second": 0.888,
    "left and right swapped": 0.797,
    "stands": 0.846,
    "walks off": 0.868,
    "10 frames a second": 0.869,
    "COCO and MediaPipe": 0.844,
}
"""What is filmed -> the error of sequences by that of images."""


@pytest.mark.slow
@pytest.mark.real_data
@pytest.mark.parametrize("name", RATIOS)
def test_sequences_are_no_worse_than_their_images(real_data, name):
    """By the dictionary of the package, which knows the body: rough bars, the same
    comparison.
    """
    shapes = read_bodies(real_data / "mocap", ["other_subjects"], ["10"])["10"]
    (cell,) = (cell for cell in CELLS if cell.name == name)
    people = shapefit.read_dictionary("people")
    measured = measure(cell, shapes, people, 2, 3.0)
    assert measured["ratio"] == pytest.approx(RATIOS[name], rel=BAND)
    assert measured["ratio"] < 1.02
    assert measured["sequences holds"] > 0.6


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("method", "stated"), [("posterior", 0.230), ("sequences", 0.213)]
)
def test_a_detected_man_on_a_beam(real_data, error, method, stated):
    folder = real_data / "detected/pose2sim_balancing"
    images = load(folder / "cam03.h5").take(slice(0, 100, 3))
    truth = read_shapes([folder / "cam03_truth.h5"], gaps=True)
    measured = error(images, truth, THIRTEEN, method=method, frame_rate=20)
    assert measured == pytest.approx(stated, rel=BAND)


def test_noise_lasts(rng):
    noise = lasting_noise(4000, 5, 24.0, rng)
    centred = noise - noise.mean(axis=0)
    covariance = (centred[1:] * centred[:-1]).mean()
    correlation = covariance / (centred**2).mean()
    expected = np.exp(-1 / (24 * 0.11))
    assert correlation == pytest.approx(expected, abs=0.03)


def test_gaps_have_their_share(rng):
    assert random_gaps(4000, 5, rng).mean() == pytest.approx(0.1, abs=0.02)


def test_the_camera_sees_the_whole_body_upright(rng):
    """y points down: the head is above."""
    feet, head = 0, 3
    body = np.zeros((3, 3, 4))
    body[:, 1] = [0.0, 0.5, 1.0, 1.7]
    for _ in range(20):
        visible, focal = place_before_camera(body, rng)
        y = visible[:, 1]
        assert (visible[:, 2] > 0).all()
        assert (y[:, head] < y[:, feet]).all()
        assert 0.8 * SIZE[0] <= focal <= 1.5 * SIZE[0]
