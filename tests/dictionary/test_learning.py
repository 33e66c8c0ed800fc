"""Coding and learning: certificates, planted optima and atoms, a falling objective, PCA
bases.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.arrays import Floats
from shapefit.dictionary.coding import flat, objectives, sparse_code
from shapefit.dictionary.learning import (
    learn_atoms,
    principal_components,
    replace_dead_atoms,
    scale_of_atoms,
    update_atoms,
)
from shapefit.geometry.normalisation import normalise


def duality_gaps(
    shapes: Floats, atoms: Floats, beta: float, coefficients: Floats
) -> Floats:
    """objective - D(t R) >= objective - optimum for each shape; (n,), for beta > 0.

    The dual is max D(Y) = <Y, S> - 1/2 ||Y||^2 subject to <B_i, Y> <= beta. Y = t R
    with the residual R and the best t >= 0 that is feasible.
    """
    X, B = flat(shapes), flat(atoms)
    R = X - coefficients @ B
    correlation, energy, highest = (
        (R * X).sum(axis=1),
        (R**2).sum(axis=1),
        (R @ B.T).max(axis=1),
    )
    free = np.divide(correlation, energy, out=np.zeros_like(energy), where=energy > 0)
    feasible = np.divide(
        beta, highest, out=np.full_like(energy, np.inf), where=highest > 0
    )
    t = np.clip(free, 0.0, feasible)
    dual = t * correlation - 0.5 * t**2 * energy
    return objectives(shapes, atoms, beta, coefficients) - dual


PRICE = 0.3


@pytest.fixture
def atoms(rng):
    return rng.standard_normal((12, 3, 6))


@pytest.fixture
def coded(rng, atoms):
    mixed = np.tensordot(
        rng.random((40, 12)) * (rng.random((40, 12)) < 0.4), atoms, axes=1
    )
    return mixed + 0.3 * rng.standard_normal(mixed.shape)


class TestOptimality:
    def test_kkt_certificate(self, coded, atoms):
        C = sparse_code(coded, atoms, PRICE)
        slope = (C @ flat(atoms) - flat(coded)) @ flat(atoms).T + PRICE
        assert (C >= 0).all()
        assert (slope >= -1e-11).all()
        assert_allclose(slope[C > 0], 0, atol=1e-11)
        assert (C > 0).any(axis=1).all()
        assert (C == 0).any(axis=1).all()


class TestHostileAtoms:
    """Atoms that depend on each other, exactly and nearly; more atoms than
    dimensions.
    """

    def families(self, rng):
        few = rng.standard_normal((8, 3, 4))
        plane = np.tensordot(rng.standard_normal((20, 2)), few[:2], axes=1)
        yield "copies", np.concatenate([few, few])
        yield "scaled copies", np.concatenate([few, 1.3 * few, 0.2 * few])
        yield (
            "near copies",
            np.concatenate([few, few + 1e-6 * rng.standard_normal(few.shape)]),
        )
        yield "overcomplete", rng.standard_normal((100, 3, 4))
        yield "positive overcomplete", np.abs(rng.standard_normal((100, 3, 4)))
        yield "one plane", plane
        yield "with zeros", np.concatenate([few, np.zeros((2, 3, 4))])

    @pytest.mark.parametrize("beta", [1.0, 0.1, 1e-3])
    def test_certificate(self, rng, beta):
        coded = rng.standard_normal((50, 3, 4))
        energy = 0.5 * (coded**2).sum(axis=(1, 2))
        for name, atoms in self.families(rng):
            C = sparse_code(coded, atoms, beta)
            gaps = duality_gaps(coded, atoms, beta, C)
            assert (C >= 0).all(), name
            assert (gaps <= 1e-7 * energy).all(), name
            for c in C:  # atoms in use are independent
                assert np.linalg.matrix_rank(flat(atoms)[c > 0]) == (c > 0).sum(), name


@pytest.mark.parametrize("size", [0.01, 1.0, 100.0])
def test_the_tolerance_is_a_share_of_the_shape(coded, atoms, size):
    # No single coefficient, set to its best, would move the shape by more than the
    # tolerance.
    B = size * flat(atoms)
    C = sparse_code(coded, size * atoms, size * PRICE, tolerance=0.1)
    slope = (C @ B - flat(coded)) @ B.T + size * PRICE
    squares = (B**2).sum(axis=1)
    moves = np.abs(np.maximum(C - slope / squares, 0) - C) * np.sqrt(squares)
    shares = (moves / np.linalg.norm(flat(coded), axis=1)[:, None]).max(axis=1)
    assert (shares <= 0.1).all()
    assert shares.max() > 0.01


BETA = 0.1


def last(rounds):
    *_, state = rounds
    return state


def relative_error(shapes, state):
    missed = shapes - np.tensordot(state.coefficients, state.atoms, axes=1)
    return np.linalg.norm(missed) / np.linalg.norm(shapes)


def norms(shapes):
    return np.linalg.norm(shapes, axis=(-2, -1))


@pytest.fixture
def shapes(rng):
    """Noisy mixtures of five forms, centred, of the size of normalised shapes."""
    forms = rng.standard_normal((5, 3, 6))
    mixed = np.tensordot(rng.random((80, 5)) ** 3, forms, axes=1)
    return normalise(mixed + 0.1 * rng.standard_normal(mixed.shape)).points


class TestDescent:
    @pytest.mark.parametrize(
        ("k", "beta"), [(1, 0.1), (8, 0.01), (8, 1.0), (30, 0.1), (80, 0.1)]
    )
    def test_no_half_step_raises_the_objective(self, shapes, k, beta):
        state = last(learn_atoms(shapes, k, beta, iterations=30))
        assert (np.diff(state.trace) <= 1e-13 * state.trace[0]).all()

    def test_coefficients_are_optimal_for_the_atoms(self, shapes):
        state = last(learn_atoms(shapes, 8, BETA, iterations=5))
        gaps = duality_gaps(shapes, state.atoms, BETA, state.coefficients)
        assert (gaps <= 1e-9).all()


class TestPlanted:
    def test_finds_the_atoms_that_made_the_shapes(self, rng):
        # 2 of 6 atoms a shape. Evenly spaced pure shapes start it near each atom.
        atoms = rng.standard_normal((6, 3, 8))
        atoms -= atoms.mean(axis=-1, keepdims=True)
        atoms /= norms(atoms)[:, None, None]
        C = np.zeros((600, 6))
        for row in C:
            row[rng.choice(6, 2, replace=False)] = rng.uniform(2, 6, 2)
        for i, j in enumerate(np.linspace(0, 599, 6).round().astype(int)):
            C[j] = 0.3
            C[j, i] = 5
        shapes = np.tensordot(C, atoms, axes=1)
        state = last(learn_atoms(shapes, 6, 1e-3, iterations=300))
        overlap = np.tensordot(state.atoms, atoms, axes=([1, 2], [1, 2]))
        assert_allclose(np.diag(overlap), 1, atol=1e-4)
        assert_allclose(state.coefficients, C, atol=0.05)
        assert relative_error(shapes, state) < 1e-3


class TestDeadAtoms:
    def test_the_worst_shape_takes_the_place(self, shapes):
        atoms = shapes[:3] / norms(shapes[:3])[:, None, None]
        C = np.zeros((80, 3))
        C[:, [0, 2]] = sparse_code(shapes, atoms[[0, 2]], BETA)
        replaced = replace_dead_atoms(shapes, C, atoms)
        worst = norms(shapes - np.tensordot(C, atoms, axes=1)).argmax()
        assert_allclose(replaced[1], shapes[worst] / norms(shapes[worst]))
        assert_array_equal(replaced[[0, 2]], atoms[[0, 2]])
        after = objectives(shapes, replaced, BETA, C)
        assert_array_equal(after, objectives(shapes, atoms, BETA, C))

    def test_one_round_brings_them_to_life(self, shapes):
        # All 8 shapes that learning starts from are the same one.
        shapes[np.linspace(0, 79, 8).round().astype(int)] = shapes[0]
        start = np.repeat(shapes[:1] / norms(shapes[0]), 8, axis=0)
        first = sparse_code(shapes, start, BETA)
        assert (first.max(axis=0) == 0).sum() == 7
        state = next(learn_atoms(shapes, 8, BETA, iterations=1))
        assert state.coefficients.any(axis=0).all()
        assert (np.diff(state.trace) < 0).all()


LIMIT = 3.3
"""Between the norms of the best free atoms."""


@pytest.fixture
def coefficients(rng):
    return rng.random((30, 5)) * (rng.random((30, 5)) < 0.6)


@pytest.fixture
def mixtures(rng, coefficients):
    return np.tensordot(coefficients, rng.standard_normal((5, 3, 4)), axes=1) + 0.1 * (
        rng.standard_normal((30, 3, 4))
    )


@pytest.fixture
def start(rng):
    atoms = rng.standard_normal((5, 3, 4))
    return atoms / np.linalg.norm(atoms, axis=(1, 2), keepdims=True)


def test_certificate(mixtures, coefficients, start):
    # KKT: the slope at B_i is -u_i B_i with u_i >= 0, and u_i = 0 inside the ball.
    usual, five = (
        update_atoms(mixtures, coefficients, start, LIMIT, **n)
        for n in ({}, {"sweeps": 5})
    )
    assert_array_equal(usual, five)
    atoms = update_atoms(mixtures, coefficients, start, LIMIT, sweeps=2000)
    norms = np.linalg.norm(atoms, axis=(1, 2))
    residual = mixtures - np.tensordot(coefficients, atoms, axes=1)
    slope = -np.tensordot(coefficients, residual, axes=(0, 0))
    u = -(slope * atoms).sum(axis=(1, 2)) / norms**2
    inside = norms < LIMIT * (1 - 1e-9)
    assert inside.any()
    assert (~inside).any()
    assert (norms <= LIMIT * (1 + 1e-12)).all()
    assert (u > -1e-9).all()
    assert_allclose(u[inside], 0, atol=1e-8)
    assert_allclose(slope, -u[:, None, None] * atoms, atol=1e-8)


def test_sizes_of_atoms_are_those_of_the_shapes_that_use_them():
    atoms = np.zeros((3, 3, 2))
    atoms[0, 0], atoms[1, 1], atoms[2, 2] = [1, -1], [1, -1], [1, -1]
    C = np.array([[1.0, 2, 0], [0, 4, 0]])
    # The deviation of each atom is 1/3; the second is used twice by the first shape,
    # four times by the other; nobody uses the third.
    found = scale_of_atoms(atoms, C, np.array([1.0, 3]))
    assert_allclose(found, [3, 3 * (2 + 12) / 6, 6])


class TestPrincipalComponents:
    def test_as_many_as_the_energy_needs_and_no_more(self, rng):
        # Of energies 25, 4, 1 the first holds 0.833, the first two 0.967.
        components = np.linalg.qr(rng.standard_normal((18, 3)))[0].T
        C = np.linalg.qr(np.column_stack([np.ones(30), rng.standard_normal((30, 3))]))[
            0
        ][:, 1:]
        planted = rng.standard_normal((3, 6)) + ((C * [5, 2, 1]) @ components).reshape(
            30, 3, 6
        )
        shares = (0.5, 0.83, 0.84, 0.96, 0.97, 0.999)
        counts = [len(principal_components(planted, share)) for share in shares]
        assert counts == [1, 1, 2, 2, 3, 3]

    @pytest.mark.parametrize("components", [1, 4, 9])
    def test_they_leave_the_least_residual(self, shapes, components):
        """Certificate (Eckart and Young): the residual is the sum of the other squared
        values.
        """
        found = principal_components(shapes, components).reshape(components, -1)
        assert_allclose(found @ found.T, np.eye(components), atol=1e-12)
        X = (shapes - shapes.mean(axis=0)).reshape(len(shapes), -1)
        residual = np.linalg.norm(X - X @ found.T @ found) ** 2
        least = (np.linalg.svd(X, compute_uv=False)[components:] ** 2).sum()
        assert residual == pytest.approx(least, rel=1e-12)

    def test_never_more_than_the_rank(self, shapes):
        for bases in (1 - 1e-15, 99):
            assert len(principal_components(shapes[:5], bases)) == 4

    def test_rounding_of_single_precision_is_no_motion(self, shapes, rng):
        still = np.repeat(10 * shapes[:1], 40, axis=0)
        rounded = still * (
            1 + np.finfo(np.float32).eps * rng.uniform(-0.5, 0.5, still.shape)
        )
        assert len(principal_components(rounded)) == 0
        moving = rounded + 1e-4 * np.sin(np.arange(40))[:, None, None] * shapes[1]
        assert len(principal_components(moving)) == 1
