"""lambda from the noise: against noise drawn anew, and what it depends on."""

import numpy as np
import pytest

from shapefit.lifting.lift import LEAST, lambda_for_noise, noise_dual_norm


@pytest.fixture
def atoms(rng):
    atoms = rng.standard_normal((5, 3, 40))
    return atoms - atoms.mean(axis=2, keepdims=True)


def drawn(atoms, visible, rng, draws=4000):
    """max_i ||G B_i^T||_* averaged over noise G on the visible landmarks, about their mean."""
    G = rng.standard_normal((draws, 1, 2, visible.sum()))
    G -= G.mean(axis=-1, keepdims=True)
    products = G @ atoms[..., visible].swapaxes(1, 2)
    return np.linalg.norm(products, "nuc", axis=(2, 3)).max(axis=1).mean()


def test_the_dual_norm_of_noise_is_the_mean_of_the_largest_over_the_atoms(atoms, rng):
    expected = drawn(atoms, np.ones(40, bool), rng)
    np.testing.assert_allclose(noise_dual_norm(atoms), expected, rtol=0.02)
    assert noise_dual_norm(atoms) == noise_dual_norm(atoms)


def test_hidden_landmarks_lower_lambda_as_the_noise_that_is_left(atoms, rng):
    visible = np.arange(40) % 4 == 0
    found = lambda_for_noise(atoms, 1.0, np.ones(1), np.array([visible.mean()]))
    np.testing.assert_allclose(found, drawn(atoms, visible, rng), rtol=0.05)


def test_lambda_is_the_noise_in_normalised_units_and_never_0(atoms):
    scale = np.array([1.0, 4.0, 1e9])
    found = lambda_for_noise(atoms, 2.0, scale, np.ones(3))
    one = 2.0 * noise_dual_norm(atoms)
    np.testing.assert_allclose(found, [one, one / 4.0, LEAST], rtol=1e-12)
