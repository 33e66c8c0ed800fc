"""What a dictionary leaves of a shape: planted answers, and scipy as an independent judge."""

import numpy as np
import pytest

from benchmarks.lower_bounds import best_combination, nearest_atom
from shapefit.evaluation.metrics import similarity
from shapefit.geometry.rotations import random_rotations


@pytest.fixture
def atoms(rng):
    """Variants of one shape, as exemplars are: a rotation fits all of them or none."""
    atoms = rng.standard_normal((3, 9)) + 0.4 * rng.standard_normal((4, 3, 9))
    return atoms - atoms.mean(axis=-1, keepdims=True)


def test_the_nearest_atom_is_the_one_that_the_shape_was_made_from(atoms, rng):
    made_from = np.array([2, 0, 3, 2])
    noise = 0.01 * rng.standard_normal((4, 3, 9))
    shapes = 5 * random_rotations(4, rng) @ (atoms[made_from] + noise) + 7
    np.testing.assert_allclose(
        nearest_atom(shapes, atoms), similarity(atoms[made_from], shapes), rtol=1e-12
    )


def test_a_combination_of_atoms_is_found_whichever_way_it_is_turned_and_sized(atoms, rng):
    c = np.abs(rng.standard_normal((6, 4)))
    mixed = np.einsum("nk,kap->nap", c, atoms)
    shapes = 3 * random_rotations(6, rng) @ mixed + rng.standard_normal((6, 3, 1))
    np.testing.assert_allclose(best_combination(shapes, atoms), 3 * mixed, atol=1e-3)
    np.testing.assert_allclose(similarity(best_combination(shapes, atoms), shapes), 0, atol=1e-3)
