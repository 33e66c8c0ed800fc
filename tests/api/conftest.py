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


ATTRIBUTES = ("unit", "method", "y_axis", "metres_from")


def read_values(dataset: h5py.Dataset) -> np.ndarray:
    """Return the values of a dataset, texts as such."""
    is_text = dataset.dtype.kind in "OS"
    return np.asarray(dataset.asstr()[()] if is_text else dataset[()])


def assert_same_values(name: str, values: np.ndarray, others: np.ndarray) -> None:
    """Fail unless two arrays are the same, bit for bit."""
    assert values.dtype.kind == others.dtype.kind, name
    assert values.shape == others.shape, name
    if values.dtype.kind == "f" and values.dtype == others.dtype:
        values = values.view(np.uint8)
        others = others.view(np.uint8)
    has_nan = values.dtype.kind == "f"
    assert np.array_equal(values, others, equal_nan=has_nan), name


def same_file(one: Path, other: Path, but: tuple[str, ...] = ()) -> None:
    """Fail unless two files have the same datasets, bit for bit, those in `but`
    aside.
    """
    with h5py.File(one) as file, h5py.File(other) as other_file:
        assert file.keys() == other_file.keys()
        for name in sorted(file.keys() - set(but)):
            values = read_values(file[name])
            assert_same_values(name, values, read_values(other_file[name]))
        for name in ATTRIBUTES:
            text = _text(file.attrs.get(name))
            assert text == _text(other_file.attrs.get(name)), name


LEARN_KEYS = {
    "sparse-coding": {
        "k": 24,
        "iterations": 2,
        "prior": {"components": 2, "floor": 0.01},
    },
    "pca-bases": {},
    "exemplars": {},
}
"""Method -> keys with which people are learned."""


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
    files = {}
    for method, keys in LEARN_KEYS.items():
        files[method] = folder / f"{method}.h5"
        arguments = {"shapes": shapes, "output": str(files[method]), "every": 20}
        run_command("learn-dict", method=method, **arguments, **keys)
    return files


@pytest.fixture(scope="session")
def views(sample, tmp_path_factory) -> Path:
    """48 frames of three sequences with confidences, some of them 0, and unseen
    landmarks.
    """
    rng = np.random.default_rng(5)
    truth = shapefit.read_shapes(sample / "people_test.h5")
    rows = np.concatenate([start + np.arange(16) for start in (0, 80, 320)])
    exact = 300 * truth.shapes[rows][..., :2]
    points = exact + rng.standard_normal((48, 15, 2))
    points[rng.random((48, 15)) < 0.1] = np.nan
    scores = rng.uniform(0.3, 1, (48, 15))
    confidence = scores * (rng.random((48, 15)) > 0.05)
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
