"""Coding: hand-solved cases, planted optima, certificates."""

import numpy as np
import pytest

from shapefit.dictionary.coding import sparse_code
from tests.dictionary.conftest import duality_gaps

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
            for c in C:  # atoms in use are independent
                assert np.linalg.matrix_rank(flat(atoms)[c > 0]) == (c > 0).sum(), name


class TestStart:
    def test_the_start_does_not_change_the_answer(self, shapes, atoms, rng):
        start = 10 * rng.random((40, 12))
        warm = sparse_code(shapes, atoms, BETA, start=start)
        np.testing.assert_allclose(warm, sparse_code(shapes, atoms, BETA), atol=1e-10)


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
