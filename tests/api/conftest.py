"""The commands in this process, for results to compare with, and dictionaries of sample
data.
"""

from pathlib import Path

import h5py
import numpy as np
import pytest

import shapefit
from shapefit.config import load_config
from shapefit.pipelines.evaluate.run import evaluate_results
from shapefit.pipelines.fit.fit import fit
from shapefit.pipelines.learn_dict.run import learn_dictionary
from shapefit.pipelines.projection import project_shapes

PIPELINES = {
    "learn-dict": learn_dictionary,
    "project": project_shapes,
    "fit": fit,
    "eval": evaluate_results,
}


def run_command(command: str, **arguments) -> None:
    """Run a command to its end; keys of its config as keyword arguments."""
    for _ in PIPELINES[command](load_config(command, arguments=arguments)):
        pass


def same_file(one: Path, other: Path, but: tuple[str, ...] = ()) -> None:
    """Fail unless two files have the same datasets, bit for bit, those in `but`
    aside.
    """
    with h5py.File(one) as a, h5py.File(other) as b:
        assert a.keys() == b.keys()
        for name in sorted(a.keys() - set(but)):
            x, y = (
                f[name].asstr()[()] if f[name].dtype.kind in "OS" else f[name][()]
                for f in (a, b)
            )
            assert (x.dtype.kind, x.shape) == (y.dtype.kind, y.shape), name
            if x.dtype.kind == "f" and x.dtype == y.dtype:
                x = x.view(np.uint8)
                y = y.view(np.uint8)
            assert np.array_equal(x, y, equal_nan=x.dtype.kind == "f"), name
        for name in ("unit", "method", "y_axis", "metres_from"):
            one, other = (f.attrs.get(name) for f in (a, b))
            assert _text(one) == _text(other), name


def _text(value: object) -> object:
    """Return an attribute, of a fixed length or not, as text."""
    return value.decode() if isinstance(value, bytes) else value


@pytest.fixture(scope="session")
def sample(project) -> Path:
    return project / "sample_data"


@pytest.fixture(scope="session")
def people(sample, tmp_path_factory) -> dict[str, Path]:
    """Dictionaries of people as the command learns them, by method."""
    folder = tmp_path_factory.mktemp("people")
    shapes = str(sample / "people_train.h5")
    prior = {"components": 2, "floor": 0.01}
    keys = {
        "sparse-coding": {"k": 24, "iterations": 2, "prior": prior},
        "pca-bases": {},
        "exemplars": {},
    }
    for method, options in keys.items():
        run_command(
            "learn-dict",
            shapes=shapes,
            output=str(folder / f"{method}.h5"),
            method=method,
            every=20,
            **options,
        )
    return {method: folder / f"{method}.h5" for method in keys}


@pytest.fixture(scope="session")
def views(sample, tmp_path_factory) -> Path:
    """48 frames of three sequences with confidences, some of them 0, and unseen
    landmarks.
    """
    rng = np.random.default_rng(5)
    truth = shapefit.read_shapes(sample / "people_test.h5")
    rows = np.concatenate([start + np.arange(16) for start in (0, 80, 320)])
    points = 300 * truth.shapes[rows][..., :2] + rng.standard_normal((48, 15, 2))
    points[rng.random((48, 15)) < 0.1] = np.nan
    confidence = rng.uniform(0.3, 1, (48, 15)) * (rng.random((48, 15)) > 0.05)
    images = shapefit.Landmarks(
        points,
        landmark_names=truth.landmark_names,
        confidence=confidence,
        items=[truth.items[row] for row in rows],
        sequences=[truth.sequences[row] for row in rows],
        unit="px",
        y_axis="up",
    )
    path = tmp_path_factory.mktemp("views") / "views.h5"
    shapefit.write_landmarks(path, images)
    return path
