"""At the default tolerance the answer is determined, and not only its objective."""

import numpy as np
import pytest

from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import random_rotations
from shapefit.io import LandmarkSet, write_dictionary

N, K, P = 96, 24, 12
LIMIT = 2e-4  # of the size; docs/verify.md: a few hundredths of a percent
NAMES = tuple(f"point{j}" for j in range(P))


@pytest.fixture
def planted(rng):
    """Noisy images of sparse mixtures, all landmarks seen, and the atoms."""
    atoms = normalise(rng.standard_normal((K, 3, P))).points
    mixed = np.einsum("nk,kap->nap", rng.random((N, K)) * (rng.random((N, K)) < 0.2), atoms)
    turned = 20 * (random_rotations(N, rng) @ mixed)[:, :2]
    return LandmarkSet(
        landmarks=turned + 0.5 * rng.standard_normal((N, 2, P)),
        landmark_names=NAMES,
        items=tuple(f"image{i}" for i in range(N)),
    ), Dictionary(atoms, NAMES, normalise(atoms.mean(axis=0)).points)


@pytest.mark.parametrize(
    "term",
    [
        {},
        {"outliers": "l1"},
        {"outliers": "sparse-error"},
    ],
    ids=["squared", "l1", "sparse-error"],
)
def test_shapes_are_those_of_a_gap_of_1e_9(fit, tmp_path, planted, term):
    images, dictionary = planted
    write_dictionary(tmp_path / "dictionary.h5", dictionary)
    usual, _ = fit(tmp_path / "dictionary.h5", images, **term)
    best, _ = fit(tmp_path / "dictionary.h5", images, **term, tolerance=1e-9)
    size = np.linalg.norm(best.shapes, axis=(1, 2))
    assert (size > 0).all()
    error = np.linalg.norm(usual.shapes - best.shapes, axis=(1, 2)) / size
    assert error.max() < LIMIT
