"""Combinations of atoms: the sum, and rounding that other images have no part in."""

import numpy as np
import pytest

from shapefit.lifting.reconstruction import combine


@pytest.fixture
def atoms(rng):
    return rng.standard_normal((64, 3, 15))


def test_is_the_sum_over_the_atoms(rng, atoms):
    c = rng.standard_normal((5, 64))
    np.testing.assert_allclose(combine(c, atoms), np.einsum("nk,kap->nap", c, atoms), atol=1e-12)


@pytest.mark.parametrize("size", [1, 2, 7, 64, 100])
def test_does_not_depend_on_the_other_images(rng, atoms, size):
    c = rng.standard_normal((203, 64))
    parts = [combine(c[at : at + size], atoms) for at in range(0, len(c), size)]
    np.testing.assert_array_equal(np.concatenate(parts), combine(c, atoms))


def test_no_images(atoms):
    assert combine(np.empty((0, 64)), atoms).shape == (0, 3, 15)
