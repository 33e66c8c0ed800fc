"""Results of every kind, fitted once, and what verify says of them."""

import shutil
from types import SimpleNamespace

import h5py
import pytest

from shapefit.config import FitConfig
from shapefit.config.paths import ResultFolder
from shapefit.errors import InputError
from shapefit.io.contents import digest_contents
from shapefit.io.layout import CONTENTS
from shapefit.pipelines.partition.run import fit_parts
from shapefit.pipelines.verify import Request
from shapefit.pipelines.verify import verify_results as run

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


def reseal(file):
    """Store the digest of what an open file holds now, as a liar would."""
    if CONTENTS in file.attrs:
        file.attrs[CONTENTS] = digest_contents(
            file, lambda name, rows: file[name][rows]
        )


@pytest.fixture
def changed(tmp_path):
    """Return what copies a result, changes the copy, and seals it anew."""

    def copy(path, change, *, seal=True):
        target = tmp_path / "changed.h5"
        target.unlink(missing_ok=True)  # HDF5 may still hold the last one
        shutil.copy(path, target)
        with h5py.File(target, "r+") as file:
            change(file)
            if seal:
                reseal(file)
        return target

    return copy


def verify_file(result, dictionary, landmarks=()):
    outcomes = list(run(Request(result, dictionary, tuple(landmarks))))
    return SimpleNamespace(
        done=sum(outcome.done for outcome in outcomes),
        failures={
            one.item: one.reason for outcome in outcomes for one in outcome.failures
        },
        note=outcomes[-1].note,
        data=outcomes[-1].data(),
    )


@pytest.fixture
def verify():
    """Return what verifies a file: `done`, `failures` (item -> reason), `note`,
    `data`.
    """
    return verify_file


def is_accepted(verify, *given):
    try:
        return not verify(*given).failures
    except InputError:
        return False


@pytest.fixture(scope="session")
def honest(dictionaries, landmarks, tmp_path_factory):
    """A folder with two parts of one file."""
    folder = tmp_path_factory.mktemp("parts") / "honest"
    config = FitConfig(
        landmarks=[str(landmarks["cars"])],
        dictionary=str(dictionaries["cars"]),
        output=ResultFolder(folder, 64),
    )
    list(fit_parts(config))
    return folder


@pytest.fixture
def folder(honest, tmp_path):
    """A copy of it, to change."""
    copy = tmp_path / "folder"
    shutil.copytree(honest, copy)
    return copy
