"""The recommended way for people on motion capture, as in benchmarks/notes/posterior.md."""

from pathlib import Path

import numpy as np
import pytest

from shapefit.config.loader import load_config
from shapefit.evaluation import metrics
from shapefit.geometry.cameras import turntable
from shapefit.geometry.normalisation import normalise
from shapefit.io import LandmarkSet, read_results, read_shapes
from shapefit.pipelines.fit import run as fit
from tests.io.files import save

CONFIGS = Path(__file__).resolve().parents[3] / "configs" / "people"

pytestmark = [pytest.mark.slow, pytest.mark.real_data]


@pytest.fixture(scope="module")
def lift(people_of_86, tmp_path_factory):
    """Return what lifts views of shapes by configs/people: the result."""

    def lift(shapes, landmarks):
        folder = tmp_path_factory.mktemp("lifted")
        images = LandmarkSet(
            landmarks=landmarks, landmark_names=shapes.landmark_names, items=shapes.items
        )
        save(folder / "landmarks.h5", images)
        arguments = {
            "landmarks": [str(folder / "landmarks.h5")],
            "dictionary": str(people_of_86),
            "output": str(folder / "result.h5"),
        }
        config = load_config("fit", CONFIGS / "fit.yaml", arguments=arguments)
        for _ in fit.run(config):
            pass
        return read_results(folder / "result.h5")

    return lift


def views(real_data, subject):
    """Every 30th frame of a subject, and its landmarks as the turntable shows them."""
    shapes = read_shapes([real_data / "mocap" / f"subject{subject}_24fps.h5"])
    sequences = np.array(shapes.sequences)
    turns = np.empty(len(shapes))
    for name in dict.fromkeys(shapes.sequences):
        rows = np.flatnonzero(sequences == name)
        turns[rows] = np.arange(len(rows)) / len(rows)
    kept = np.arange(0, len(shapes), 30)
    some = shapes.take(kept)
    return some, (turntable(turns[kept], "y") @ some.shapes)[:, :2]


def errors(result, shapes):
    return metrics.similarity(result.shapes, shapes.shapes) / metrics.truth_scale(
        result.shapes, shapes.shapes
    )


@pytest.mark.parametrize(
    ("subject", "error", "noisy"),
    [(13, 0.2268, 0.2503), (14, 0.2288, 0.2534)],
)
def test_headline_figures(real_data, lift, subject, error, noisy):
    shapes, landmarks = views(real_data, subject)
    sequences = np.array(shapes.sequences)

    def mean_error(landmarks):
        off = errors(lift(shapes, landmarks), shapes)
        return np.mean([off[sequences == name].mean() for name in set(shapes.sequences)])

    noise = 0.02 * np.random.default_rng(0).standard_normal(landmarks.shape)
    found = mean_error(landmarks), mean_error(landmarks + noise)
    assert found == pytest.approx((error, noisy), rel=0.02)


def test_one_landmark_that_is_wrong_leaves_the_others(real_data, lift):
    """It moves by half the size of the shape, the mean standard deviation of its coordinates."""
    shapes, landmarks = views(real_data, 13)
    rng = np.random.default_rng(0)
    n, _, p = landmarks.shape
    wrong, angle = rng.integers(0, p, n), 2 * np.pi * rng.random(n)
    moved = landmarks.copy()
    size = normalise(landmarks).scale
    step = 0.5 * size[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    moved[np.arange(n), :, wrong] += step
    found = []
    for each in (landmarks, moved):
        result = lift(shapes, each)
        hidden = result.shapes.copy()
        hidden[np.arange(n), :, wrong] = np.nan
        found.append(errors(result.replaced(shapes=hidden), shapes).mean())
    assert found[1] < 1.1 * found[0]
