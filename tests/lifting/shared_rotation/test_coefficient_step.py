"""The exact l1 step: scikit-learn's answer, optimality conditions, planted coefficients."""

import numpy as np
import pytest

from shapefit import core
from shapefit.geometry.rotations import random_rotations


def solve(w, atoms, R, lam, *, signed=False, start=None):
    c = np.zeros(len(atoms)) if start is None else start.copy()
    return c, core.parts.sparse_coefficients(w, atoms, R, lam, signed, c)


def project(atoms, R):
    """Return the projected atoms as columns (2 q, k)."""
    return (R[:2] @ atoms).reshape(len(atoms), -1).T


def objective(w, atoms, R, lam, c):
    return 0.5 * ((w.ravel() - project(atoms, R) @ c) ** 2).sum() + lam * np.abs(c).sum()


def assert_optimal(w, atoms, R, lam, c, *, signed):
    """The conditions of Karush, Kuhn and Tucker."""
    A = project(atoms, R)
    correlation = A.T @ (w.ravel() - A @ c)
    used = c != 0
    if not signed:
        assert (c >= 0).all()
    assert (np.abs(correlation) if signed else correlation).max() <= lam * (1 + 1e-8)
    np.testing.assert_allclose(correlation[used], lam * np.sign(c[used]), rtol=1e-7)


@pytest.fixture
def make_case(rng):
    def make(k=30, q=8):
        atoms = rng.standard_normal((3, q)) + rng.standard_normal((k, 3, q))
        atoms /= np.linalg.norm(atoms, axis=(1, 2), keepdims=True)
        R = random_rotations(1, rng)[0]
        c = rng.standard_normal(k) * (rng.random(k) < 0.3)
        w = (project(atoms, R) @ c).reshape(2, q) + 0.1 * rng.standard_normal((2, q))
        return w, atoms, R

    return make


signs = pytest.mark.parametrize("signed", [False, True])


@signs
@pytest.mark.parametrize("lam", [1e-4, 0.03, 0.3])
@pytest.mark.parametrize(("k", "q"), [(1, 1), (5, 12), (30, 8), (64, 3), (64, 14)])
def test_the_conditions_of_optimality_hold(make_case, signed, lam, k, q):
    for _ in range(10):
        w, atoms, R = make_case(k, q)
        c, value = solve(w, atoms, R, lam, signed=signed)
        assert_optimal(w, atoms, R, lam, c, signed=signed)
        assert value == pytest.approx(objective(w, atoms, R, lam, c), rel=1e-10)
        assert (c != 0).sum() <= 2 * q


@pytest.mark.slow
@signs
@pytest.mark.parametrize("lam", [0.01, 0.1])
def test_scikit_learn_agrees(make_case, signed, lam):
    from sklearn.linear_model import Lasso

    for _ in range(10):
        w, atoms, R = make_case()
        c, value = solve(w, atoms, R, lam, signed=signed)
        lasso = Lasso(
            alpha=lam / w.size,
            fit_intercept=False,
            positive=not signed,
            tol=1e-13,
            max_iter=1_000_000,
        ).fit(project(atoms, R), w.ravel())
        np.testing.assert_allclose(c, lasso.coef_, atol=1e-6)
        assert value <= objective(w, atoms, R, lam, lasso.coef_) * (1 + 1e-12)


@signs
def test_a_planted_optimum_comes_back(rng, signed):
    """Any residual whose correlations are lam on the support and less off it is optimal."""
    lam, k, q = 0.2, 20, 10
    for _ in range(10):
        R = random_rotations(1, rng)[0]
        atoms = rng.standard_normal((k, 3, q))
        residual = rng.standard_normal((2, q))
        correlation = project(atoms, R).T @ residual.ravel()
        share = np.where(np.arange(k) < 4, 1.0, rng.uniform(0.1, 0.9, k))
        atoms *= (lam * share / np.abs(correlation))[:, None, None]
        c = np.zeros(k)
        c[:4] = rng.uniform(0.5, 2, 4) * np.sign(correlation[:4])
        if not signed:  # an atom whose correlation is negative must not be used
            atoms[:4] *= np.sign(correlation[:4])[:, None, None]
            atoms[4:] *= 5 * (correlation[4:] < 0)[:, None, None] + 1
            c = np.abs(c)
        w = residual + (project(atoms, R) @ c).reshape(2, q)
        found, _ = solve(w, atoms, R, lam, signed=signed)
        np.testing.assert_allclose(found, c, atol=1e-9)


@signs
def test_the_start_does_not_matter(make_case, signed, rng):
    for _ in range(10):
        w, atoms, R = make_case()
        c, value = solve(w, atoms, R, 0.05, signed=signed)
        _, other, other_R = make_case()
        start, _ = solve(w, other, other_R, 0.05, signed=signed)
        again, same = solve(w, atoms, R, 0.05, signed=signed, start=start)
        np.testing.assert_allclose(again, c, atol=1e-8)
        assert same == pytest.approx(value, rel=1e-12)


@signs
def test_copies_and_sums_of_atoms_do_no_harm(make_case, signed):
    for _ in range(20):
        w, atoms, R = make_case(k=12, q=6)
        sums = 0.5 * (atoms[:6] + atoms[6:])
        many = np.concatenate([atoms, atoms, sums, -atoms[:3], np.zeros((1, 3, 6))])
        c, value = solve(w, many, R, 0.05, signed=signed)
        assert_optimal(w, many, R, 0.05, c, signed=signed)
        if signed:  # sums and mirror images of atoms cannot lower the l1 norm
            _, alone = solve(w, atoms, R, 0.05, signed=signed)
            assert value == pytest.approx(alone, rel=1e-9)
