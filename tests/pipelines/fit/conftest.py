"""Planted images of six atoms, and what fits them from files to files."""

import numpy as np
import pytest

from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import random_rotations
from shapefit.io import write_dictionary
from shapefit.records import Landmarks
from tests.io.files import save
from tests.pipelines.fitted import fit_file

NAMES = tuple(f"point{j}" for j in range(10))


@pytest.fixture
def atoms(rng):
    return normalise(rng.standard_normal((6, 3, 10))).points / 5


@pytest.fixture
def dictionary(tmp_path, atoms):
    path = tmp_path / "dictionary.h5"
    prior = Mixture(
        np.ones(1), normalise(atoms.mean(0)).points[None], 0.1 * np.eye(30)[None]
    )
    write_dictionary(path, Dictionary(atoms, NAMES, prior.means[0], prior=prior))
    return path


@pytest.fixture
def rotations(rng):
    return random_rotations(8, rng)


@pytest.fixture
def images(atoms, rotations):
    """One atom each, turned, 20 px large, at (100, 50)."""
    shapes = 20 * rotations @ atoms[np.arange(8) % 6]
    return Landmarks(
        (shapes[:, :2] + np.array([100.0, 50.0])[:, None]).swapaxes(1, 2),
        landmark_names=NAMES,
        items=tuple(f"image{i}" for i in range(8)),
        sequences=("a",) * 4 + ("b",) * 4,
        unit="px",
        y_axis="down",
        extras={"true_rotation": rotations},
        file_extras={"camera_matrix": np.eye(3)},
    )


@pytest.fixture
def fit(tmp_path):
    """Return what fits landmarks given as records, text or a path: (result,
    outcomes).
    """

    def fit(dictionary, images, **keys):
        path = images
        if isinstance(images, Landmarks):
            save(path := tmp_path / "views.h5", images)
        elif isinstance(images, str):
            path = tmp_path / "views.csv"
            path.write_text(images)
        return fit_file(path, dictionary, tmp_path / "result.h5", **keys)

    return fit
