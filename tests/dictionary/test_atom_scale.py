"""Sizes of learned atoms: known ones, bounds by those of the shapes, and whole dictionaries."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shapefit.dictionary import atom_scale
from shapefit.dictionary.learning import learn
from shapefit.geometry.normalisation import normalise, spread
from shapefit.meshes.dense import metric_scale


def scale_of_atoms(atoms, coefficients, scale):
    use, measured = coefficients.sum(axis=0), scale @ coefficients
    return atom_scale.scale_of_atoms(atoms, use, measured, scale.mean())


@pytest.fixture
def shapes(rng):
    return normalise(rng.standard_normal((3, 8)) + 0.2 * rng.standard_normal((20, 3, 8))).points


def test_exemplars_that_only_their_own_shape_uses_have_its_size(shapes, rng):
    scale = rng.uniform(1, 3, 20)
    np.testing.assert_allclose(scale_of_atoms(shapes, np.eye(20), scale), scale, rtol=1e-12)
    halves = scale_of_atoms(0.5 * shapes, 2 * np.eye(20), scale)
    np.testing.assert_allclose(halves, 2 * scale, rtol=1e-12)


def test_an_atom_is_as_large_as_its_users_by_their_shares(shapes):
    use = np.array([[3.0, 0], [1, 0], [0, 2]])
    sizes = scale_of_atoms(shapes[:2], use, np.array([1.0, 2, 7]))
    np.testing.assert_allclose(sizes, [1.25, 7], rtol=1e-12)


def test_an_atom_without_users_is_as_large_as_the_mean(shapes):
    use = np.array([[1.0, 0], [1, 0]])
    np.testing.assert_allclose(scale_of_atoms(shapes[:2], use, np.array([1.0, 3])), 2, rtol=1e-12)


@given(seed=st.integers(0, 2**32 - 1))
def test_grown_atoms_lie_between_the_smallest_and_the_largest_shape(seed):
    rng = np.random.default_rng(seed)
    atoms = rng.standard_normal((4, 3, 6))
    use = np.maximum(rng.standard_normal((9, 4)), 0)
    scale = rng.uniform(0.1, 10, 9)
    sizes = scale_of_atoms(atoms, use, scale) * spread(atoms)
    assert (sizes >= scale.min() * (1 - 1e-12)).all()
    assert (sizes <= scale.max() * (1 + 1e-12)).all()


def test_shapes_of_one_size_are_measured_right_in_whichever_unit(shapes):
    """A fit of the training shapes themselves gives back 2.5 m, up to what the fit misses."""
    *_, learned = learn(shapes, 12, 0.0, iterations=10)
    sizes = scale_of_atoms(learned.atoms, learned.coefficients, np.full(20, 2.5))
    rebuilt = np.tensordot(learned.coefficients, learned.atoms, axes=1)
    length = metric_scale(learned.atoms, learned.coefficients, sizes) * spread(rebuilt)
    np.testing.assert_allclose(length, 2.5, rtol=0.02)
    in_mm = scale_of_atoms(learned.atoms, learned.coefficients, np.full(20, 2500.0))
    np.testing.assert_allclose(in_mm, 1000 * sizes, rtol=1e-12)
