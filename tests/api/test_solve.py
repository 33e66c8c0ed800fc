"""shapefit.solve: one image, several, hidden landmarks, and a certificate that NumPy checks."""

import numpy as np
import pytest

import shapefit


@pytest.fixture
def program(rng):
    atoms = rng.normal(size=(6, 3, 9))
    M = np.zeros((6, 2, 3))
    M[1], M[4] = 0.8 * np.eye(3)[:2], -0.3 * np.eye(3)[1:]
    W = np.einsum("kab,kbp->ap", M, atoms) + 0.05 * rng.normal(size=(2, 9)) + [[3.0], [-2.0]]
    return W, atoms


def test_the_dual_proves_the_optimum(program):
    """A feasible dual bounds every objective from below, and this one from 1e-6 below."""
    W, B = program
    weights = np.array([1, 1, 0.5, 1, 0, 1, 2, 1, 1])
    found = shapefit.solve(W, B, 0.2, weights=weights)
    assert found.status == "optimal"
    residual = weights * (W - np.einsum("kab,kbp->ap", found.transforms, B))
    residual -= weights * found.translation[:, None]
    norms = np.linalg.norm(found.transforms, 2, axis=(1, 2))
    objective = (residual**2).sum() / 2 + 0.2 * norms.sum()
    assert found.objective == pytest.approx(objective, rel=1e-12)
    weighted = weights * found.dual
    dual_norms = np.linalg.norm(weighted @ B.swapaxes(1, 2), "nuc", axis=(1, 2))
    Y = found.dual * min(1.0, 0.2 / dual_norms.max())
    np.testing.assert_allclose((weights * Y).sum(axis=1), 0, atol=1e-9)
    bound = (W * weights * Y).sum() - (Y**2).sum() / 2
    assert 0 <= objective - bound <= 2e-6 * objective


def test_images_together_are_those_alone(program):
    W, B = program
    hidden = W.copy()
    hidden[:, 2] = np.nan
    both = shapefit.solve([W, hidden], B, 0.1)
    assert both.status == ("optimal", "optimal")
    for number, image in enumerate((W, hidden)):
        alone = shapefit.solve(image, B, 0.1)
        np.testing.assert_allclose(both.transforms[number], alone.transforms, atol=1e-6)


def test_what_does_not_fit_is_refused(program):
    W, B = program
    with pytest.raises(ValueError, match=r"must be \(n, 2, p\), \(k, 3, p\)"):
        shapefit.solve(W[:, :5], B, 0.1)
    with pytest.raises(ValueError, match="'huge' is not a valid Loss"):
        shapefit.solve(W, B, 0.1, loss="huge")
