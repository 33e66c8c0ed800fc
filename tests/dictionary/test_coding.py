"""Coding: hand-solved cases, planted optima, certificates, scikit-learn and scipy as judges."""

import numpy as np
import pytest
from scipy.optimize import nnls

from shapefit.dictionary.coding import duality_gaps, objectives, sparse_code

BETA = 0.3


def flat(shapes):
    return shapes.reshape(len(shapes), -1)


@pytest.fixture
def atoms(rng):
    return rng.standard_normal((12, 3, 6))


@pytest.fixture
def shapes(rng, atoms):
    mixed = np.tensordot(rng.random((40, 12)) * (rng.random((40, 12)) < 0.4), atoms, axes=1)
    return mixed + 0.3 * rng.standard_normal(mixed.shape)


class TestOptimality:
    def test_kkt_certificate(self, shapes, atoms):
        C = sparse_code(shapes, atoms, BETA)
        slope = (C @ flat(atoms) - flat(shapes)) @ flat(atoms).T + BETA
        assert (C >= 0).all()
        assert (slope >= -1e-11).all()
        np.testing.assert_allclose(slope[C > 0], 0, atol=1e-11)
        assert (C > 0).any(axis=1).all()
        assert (C == 0).any(axis=1).all()

    def test_planted_optimum(self, rng):
        # Choose the residual Y, scale the atoms so that <B_i, Y> = beta for those in use and less
        # for the others; then S = sum c_i B_i + Y has the coefficients c.
        Y = rng.standard_normal((3, 6))
        atoms = rng.standard_normal((10, 3, 6))
        overlap = np.tensordot(atoms, Y, axes=2)
        used = np.arange(10) < 4
        wanted = np.where(used, BETA, 0.8 * BETA)
        atoms *= (wanted / np.abs(overlap) * np.where(used, np.sign(overlap), 1))[:, None, None]
        c = np.where(used, rng.uniform(1, 3, 10), 0)
        S = np.tensordot(c, atoms, axes=1) + Y
        np.testing.assert_allclose(sparse_code(S[None], atoms, BETA)[0], c, atol=1e-10)

    @pytest.mark.slow
    def test_agrees_with_scikit_learn(self, shapes, atoms):
        from sklearn.linear_model import Lasso

        C = sparse_code(shapes, atoms, BETA)
        size = atoms[0].size
        judge = Lasso(
            alpha=BETA / size, positive=True, fit_intercept=False, tol=1e-14, max_iter=10**6
        )
        for S, c in zip(flat(shapes), C, strict=True):
            expected = judge.fit(flat(atoms).T, S).coef_
            np.testing.assert_allclose(c, expected, atol=1e-7)

    def test_without_beta_agrees_with_scipy(self, shapes, atoms):
        C = sparse_code(shapes, atoms, beta=0.0)
        for S, c in zip(flat(shapes), C, strict=True):
            np.testing.assert_allclose(c, nnls(flat(atoms).T, S)[0], atol=1e-10)


class TestDualityGap:
    def test_bounds_what_is_lost_by_any_coefficients(self, shapes, atoms, rng):
        best = objectives(shapes, atoms, BETA, sparse_code(shapes, atoms, BETA))
        for size in (0.0, 0.01, 1.0, 100.0):
            C = size * rng.random((40, 12))
            lost = objectives(shapes, atoms, BETA, C) - best
            gaps = duality_gaps(shapes, atoms, BETA, C)
            assert (gaps >= lost - 1e-10 * (1 + lost)).all()
            assert (lost > 0).all()

    @pytest.mark.parametrize("beta", [BETA, 1e3])
    def test_is_that_of_the_best_dual_along_the_residual(self, shapes, atoms, rng, beta):
        """max over feasible t of D(t R), on a fine grid; t = 1 is not feasible, or not the best."""
        C = 0.2 * rng.random((40, 12))
        gaps = duality_gaps(shapes, atoms, beta, C)
        for S, c, gap in zip(shapes, C, gaps, strict=True):
            R = S - np.tensordot(c, atoms, axes=1)
            highest = np.tensordot(atoms, R, axes=2).max()
            t = np.linspace(0, min(beta / highest, 9) if highest > 0 else 9, 100_001)
            dual = t * (R * S).sum() - 0.5 * t**2 * (R**2).sum()
            primal = 0.5 * (R**2).sum() + beta * c.sum()
            assert gap == pytest.approx(primal - dual.max(), rel=1e-6)


class TestHostileAtoms:
    """Atoms that depend on each other, exactly and nearly; more atoms than dimensions."""

    def families(self, rng):
        few = rng.standard_normal((8, 3, 4))
        plane = np.tensordot(rng.standard_normal((20, 2)), few[:2], axes=1)
        yield "copies", np.concatenate([few, few])
        yield "scaled copies", np.concatenate([few, 1.3 * few, 0.2 * few])
        yield "near copies", np.concatenate([few, few + 1e-6 * rng.standard_normal(few.shape)])
        yield "overcomplete", rng.standard_normal((100, 3, 4))
        yield "positive overcomplete", np.abs(rng.standard_normal((100, 3, 4)))
        yield "one plane", plane
        yield "with zeros", np.concatenate([few, np.zeros((2, 3, 4))])

    @pytest.mark.parametrize("beta", [1.0, 0.1, 1e-3])
    def test_certificate(self, rng, beta):
        shapes = rng.standard_normal((50, 3, 4))
        energy = 0.5 * (shapes**2).sum(axis=(1, 2))
        for name, atoms in self.families(rng):
            C = sparse_code(shapes, atoms, beta)
            gaps = duality_gaps(shapes, atoms, beta, C)
            assert (C >= 0).all(), name
            assert (gaps <= 1e-7 * energy).all(), name
            assert ((C > 0).sum(axis=1) <= 12).all(), name

    def test_atoms_in_use_are_independent(self, rng):
        shapes = rng.standard_normal((50, 3, 4))
        for name, atoms in self.families(rng):
            start = rng.random((50, len(atoms)))
            for c in sparse_code(shapes, atoms, 0.1, start=start):
                in_use = flat(atoms)[c > 0]
                assert np.linalg.matrix_rank(in_use) == len(in_use), name


class TestStart:
    def test_the_start_does_not_change_the_answer(self, shapes, atoms, rng):
        start = 10 * rng.random((40, 12))
        warm = sparse_code(shapes, atoms, BETA, start=start)
        np.testing.assert_allclose(warm, sparse_code(shapes, atoms, BETA), atol=1e-10)

    @pytest.mark.parametrize("start", [np.zeros((40, 11)), np.full((40, 12), -1e-9)])
    def test_a_wrong_start_is_refused(self, shapes, atoms, start):
        with pytest.raises(ValueError, match="start"):
            sparse_code(shapes, atoms, BETA, start=start)


@pytest.mark.parametrize("size", [0.01, 1.0, 100.0])
def test_the_tolerance_is_a_share_of_the_shape(shapes, atoms, size):
    # No single coefficient, set to its best, would move the shape by more than the tolerance.
    B = size * flat(atoms)
    C = sparse_code(shapes, size * atoms, size * BETA, tolerance=0.1)
    slope = (C @ B - flat(shapes)) @ B.T + size * BETA
    squares = (B**2).sum(axis=1)
    moves = np.abs(np.maximum(C - slope / squares, 0) - C) * np.sqrt(squares)
    shares = (moves / np.linalg.norm(flat(shapes), axis=1)[:, None]).max(axis=1)
    assert (shares <= 0.1).all()
    assert shares.max() > 0.01


def test_an_unreachable_tolerance_warns(shapes, atoms):
    with pytest.warns(RuntimeWarning, match="40 of 40 shapes"):
        sparse_code(shapes, atoms, BETA, tolerance=-1.0)


def test_objectives_are_what_they_say(shapes, atoms, rng):
    C = rng.random((40, 12)) * (rng.random((40, 12)) < 0.5)
    residual = flat(shapes) - C @ flat(atoms)
    expected = 0.5 * (residual**2).sum(axis=1) + BETA * C.sum(axis=1)
    np.testing.assert_allclose(objectives(shapes, atoms, BETA, C), expected, rtol=1e-14)
