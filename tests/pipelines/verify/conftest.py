"""Results of every kind, fitted once, and what verify says of them."""

import shutil
from types import SimpleNamespace

import h5py
import pytest

from shapefit.config import LearnDictConfig
from shapefit.pipelines.learn_dict import run as learn_dict
from shapefit.pipelines.verify import Request, run
from tests.pipelines.fitted import fit_file

TERMS = {
    "squared": {},
    "exact": {"loss": "exact"},
    "l1": {"outliers": {"method": "l1"}},
    "sparse-error": {"outliers": {"method": "sparse-error"}},
}
"""Data term -> the keys of `fit` that choose it."""


@pytest.fixture(scope="session")
def dictionaries(project, tmp_path_factory):
    """Small dictionaries of people and of cars, from sample_data."""
    folder, data = tmp_path_factory.mktemp("dictionaries"), project / "sample_data"
    kinds = {
        "people": {"shapes": [str(data / "people_train.h5")], "k": 12, "iterations": 2, "every": 8},
        "other_people": {
            "shapes": [str(data / "people_train.h5")], "k": 12, "iterations": 1, "every": 9,
        },
        "cars": {"shapes": [str(data / "cars.h5")], "method": "exemplars", "align": "none"},
    }  # fmt: skip
    paths = {}
    for name, keys in kinds.items():
        paths[name] = folder / f"{name}.h5"
        list(learn_dict.run(LearnDictConfig(output=str(paths[name]), **keys)))
    prior = project / "shapefit/dictionaries/people.h5"
    return paths | {"prior": prior, "detected": prior}


@pytest.fixture(scope="session")
def landmarks(project):
    data = project / "sample_data"
    people = data / "people_views.csv"
    cars, walk = data / "cars_views.h5", data / "openpose"
    return {"people": people, "prior": people, "cars": cars, "detected": walk}


@pytest.fixture(scope="session")
def fitted(dictionaries, landmarks, tmp_path_factory):
    """Return what fits people or cars with some keys, each such fit once."""
    folder, known = tmp_path_factory.mktemp("fitted"), {}

    def fit_once(kind, **keys):
        keys = {"input": {"keypoints": "body_25"}} | keys if kind == "detected" else keys
        name = f"{kind} {sorted(keys.items())}"
        if name not in known:
            known[name] = folder / f"{len(known)}.h5"
            fit_file(landmarks[kind], dictionaries[kind], known[name], **keys)
        return known[name]

    return fit_once


@pytest.fixture
def changed(tmp_path):
    """Return what copies a result and changes the copy."""

    def copy(path, change):
        target = tmp_path / "changed.h5"
        shutil.copy(path, target)
        with h5py.File(target, "r+") as file:
            change(file)
        return target

    return copy


def verify_file(result, dictionary, landmarks=()):
    outcomes = list(run(Request(result, dictionary, tuple(landmarks))))
    return SimpleNamespace(
        done=sum(outcome.done for outcome in outcomes),
        failures={one.item: one.reason for outcome in outcomes for one in outcome.failures},
        note=outcomes[-1].note,
    )


@pytest.fixture
def verify():
    """Return what verifies a file: `done`, `failures` (item -> reason) and the table, `note`."""
    return verify_file


@pytest.fixture
def item_of():
    """Return what gives the item of an image in a file."""

    def item(path, image):
        with h5py.File(path) as file:
            return file["item"].asstr()[image]

    return item
