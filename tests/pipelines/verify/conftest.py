"""Results of every kind, fitted once, and what verify says of them."""

import shutil
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from shapefit.config import LearnDictConfig, ProjectConfig
from shapefit.io import read_shapes, write_shapes
from shapefit.pipelines import projection as projecting
from shapefit.pipelines.learn_dict import run as learn_dict
from shapefit.pipelines.verify import Request, run
from tests.io.files import load, save

TERMS = {
    "squared": {},
    "l1": {"outliers": "l1"},
    "sparse-error": {"outliers": "sparse-error"},
}
"""Data term -> the keys of `fit` that choose it."""


KINDS = ("people", "prior", "cars", "walk")


@pytest.fixture(scope="session")
def dictionaries(world):
    return {kind: world.dictionary(kind) for kind in (*KINDS, "other people")}


@pytest.fixture(scope="session")
def landmarks(world):
    return {kind: world.images("people" if kind == "prior" else kind) for kind in KINDS}


@pytest.fixture(scope="session")
def fitted(world):
    """Return what fits people or cars with some keys, each such fit once."""
    return world.fit


@pytest.fixture
def changed(tmp_path):
    """Return what copies a result and changes the copy."""

    def copy(path, change):
        target = tmp_path / "changed.h5"
        shutil.copy(path, target)
        with h5py.File(target, "r+") as file:
            file.attrs.pop("attributes_sha256", None)  # as whoever changes attributes would
            change(file)
        return target

    return copy


def verify_file(result, dictionary, landmarks=()):
    outcomes = list(run(Request(result, dictionary, tuple(landmarks))))
    return SimpleNamespace(
        done=sum(outcome.done for outcome in outcomes),
        failures={one.item: one.reason for outcome in outcomes for one in outcome.failures},
        note=outcomes[-1].note,
        data=outcomes[-1].data(),
    )


@pytest.fixture
def verify():
    """Return what verifies a file: `done`, `failures` (item -> reason), `note`, `data`."""
    return verify_file


@pytest.fixture
def item_of():
    """Return what gives the item of an image in a file."""

    def item(path, image):
        with h5py.File(path) as file:
            return file["item"].asstr()[image]

    return item


@pytest.fixture(scope="session")
def real(real_data, tmp_path_factory):
    """A dictionary of subject 86 and images of subject 13; one of all cars, and cars."""
    folder = tmp_path_factory.mktemp("real")
    shapes = read_shapes([real_data / "mocap/subject13_24fps.h5"])
    chosen = np.linspace(0, len(shapes) - 1, 150).astype(int)
    write_shapes(folder / "shapes.h5", shapes.take(chosen))
    save(folder / "cars.h5", load(real_data / "cars/annotated_cars.h5").take(slice(0, None, 8)))
    keys = {"camera": {"view": "turntable"}, "output": str(folder / "people.h5")}
    list(projecting.run(ProjectConfig(shapes=[str(folder / "shapes.h5")], **keys)))
    training = [str(real_data / "mocap/subject86_24fps.h5")]
    keys = {"k": 32, "iterations": 2, "every": 40, "output": str(folder / "people-dict.h5")}
    list(learn_dict.run(LearnDictConfig(shapes=training, **keys)))
    models = [str(real_data / "cars/models.h5")]
    keys = {"method": "exemplars", "align": "none", "output": str(folder / "cars-dict.h5")}
    list(learn_dict.run(LearnDictConfig(shapes=models, **keys)))
    return folder
