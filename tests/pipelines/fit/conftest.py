"""Planted images of six atoms, and what fits them from files to files."""

import numpy as np
import pytest

from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import random_rotations
from shapefit.io import write_dictionary
from shapefit.records import Landmarks
from tests.columns import in_rows
from tests.io.files import save
from tests.pipelines.fit.filmed import film_people, fit_sequences
from tests.pipelines.fitted import fit_file

NAMES = tuple(f"point{j}" for j in range(10))


@pytest.fixture
def atoms(rng):
    return normalise(rng.standard_normal((6, 3, 10))).points / 5


@pytest.fixture(scope="session")
def people(project, tmp_path_factory):
    """Sequences of people, and a dictionary with a prior."""
    return film_people(project / "sample_data", tmp_path_factory.mktemp("people"))


@pytest.fixture
def lift_sequences(people, tmp_path):
    """Fit images or a file by `sequences`, or as the keys say; return the result and
    the warnings.
    """

    def lift(landmarks, dictionary=people.dictionary, **keys):
        return fit_sequences(tmp_path, landmarks, dictionary, **keys)

    return lift


@pytest.fixture
def dictionary(tmp_path, atoms):
    path = tmp_path / "dictionary.h5"
    mean = normalise(atoms.mean(0)).points
    covariance = 0.1 * np.eye(30)
    prior = Mixture(np.ones(1), mean[None], covariance[None])
    write_dictionary(path, Dictionary(atoms, NAMES, mean, prior=prior))
    return path


@pytest.fixture
def rotations(rng):
    return random_rotations(8, rng)


@pytest.fixture
def images(atoms, rotations):
    """One atom each, turned, 20 px large, at (100, 50)."""
    shapes = 20 * rotations @ atoms[np.arange(8) % 6]
    centre = np.array([100.0, 50.0])
    return Landmarks(
        in_rows(shapes[:, :2]) + centre,
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
            path = tmp_path / "views.h5"
            save(path, images)
        elif isinstance(images, str):
            path = tmp_path / "views.csv"
            path.write_text(images)
        return fit_file(path, dictionary, tmp_path / "result.h5", **keys)

    return fit
