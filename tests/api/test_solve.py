"""`solve` proves its optimum."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import shapefit

LAMBDA = 0.2


WEIGHTS = np.array([1, 1, 0.5, 1, 0, 1, 2, 1, 1])


def combine(transforms, atoms):
    """Return the sum of M_i B_i."""
    return np.einsum("kab,kbp->ap", transforms, atoms)


@pytest.fixture
def program(rng):
    """Landmarks (2, 9) of two of six atoms, with noise, and the atoms."""
    atoms = rng.normal(size=(6, 3, 9))
    M = np.zeros((6, 2, 3))
    M[1] = 0.8 * np.eye(3)[:2]
    M[4] = -0.3 * np.eye(3)[1:]
    noise = 0.05 * rng.normal(size=(2, 9))
    W = combine(M, atoms) + noise + [[3.0], [-2.0]]
    return W, atoms


def test_the_objective_is_that_of_the_transforms(program):
    W, B = program
    found = shapefit.solve(W, B, LAMBDA, weights=WEIGHTS)
    fitted = combine(found.transforms, B) + found.translation[:, None]
    residual = WEIGHTS * (W - fitted)
    norms = np.linalg.norm(found.transforms, 2, axis=(1, 2))
    objective = (residual**2).sum() / 2 + LAMBDA * norms.sum()
    assert found.status == "optimal"
    assert found.objective == pytest.approx(objective, rel=1e-12)


def test_the_dual_proves_the_optimum(program):
    """A feasible dual bounds every objective from below, and this one from 1e-6
    below.
    """
    W, B = program
    found = shapefit.solve(W, B, LAMBDA, weights=WEIGHTS)
    correlations = (WEIGHTS * found.dual) @ np.moveaxis(B, 1, 2)
    dual_norms = np.linalg.norm(correlations, "nuc", axis=(1, 2))
    Y = found.dual * min(1.0, LAMBDA / dual_norms.max())
    bound = (W * WEIGHTS * Y).sum() - (Y**2).sum() / 2
    gap = found.objective - bound
    assert_allclose((WEIGHTS * Y).sum(axis=1), 0, atol=1e-9)
    assert 0 <= gap <= 2e-6 * found.objective


def test_what_does_not_fit_is_refused(program):
    W, B = program
    with pytest.raises(ValueError, match=r"must be \(n, 2, p\), \(k, 3, p\)"):
        shapefit.solve(W[:, :5], B, 0.1)
    with pytest.raises(ValueError, match="'huge' is not a valid Loss"):
        shapefit.solve(W, B, 0.1, loss="huge")
