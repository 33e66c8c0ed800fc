"""Atom update: hand-solved, certified, and judged by cvxpy."""

import numpy as np
import pytest

from shapefit.dictionary import atoms as atoms_module
from shapefit.dictionary.atoms import Products
from shapefit.geometry.rotations import random_rotations

BOUND = 3.3  # between the norms of the best free atoms


def update_atoms(shapes, coefficients, atoms, bound, sweeps=5):
    products = Products.zero(atoms).add(shapes, coefficients)
    return atoms_module.update_atoms(products, atoms, bound, sweeps)


@pytest.fixture
def coefficients(rng):
    return rng.random((30, 5)) * (rng.random((30, 5)) < 0.6)


@pytest.fixture
def shapes(rng, coefficients):
    return np.tensordot(coefficients, rng.standard_normal((5, 3, 4)), axes=1) + 0.1 * (
        rng.standard_normal((30, 3, 4))
    )


@pytest.fixture
def start(rng):
    atoms = rng.standard_normal((5, 3, 4))
    return atoms / np.linalg.norm(atoms, axis=(1, 2), keepdims=True)


def misfit(shapes, coefficients, atoms):
    return 0.5 * ((shapes - np.tensordot(coefficients, atoms, axes=1)) ** 2).sum()


def test_one_atom_by_hand():
    # Two copies of S with coefficients 1 and 3 are fitted best by (1 + 3) / (1 + 9) S.
    S = np.ones((3, 2))
    shapes, coefficients = np.array([S, S]), np.array([[1.0], [3]])
    free = update_atoms(shapes, coefficients, np.zeros((1, 3, 2)), bound=10, sweeps=1)
    np.testing.assert_allclose(free[0], 0.4 * S)
    held = update_atoms(shapes, coefficients, np.zeros((1, 3, 2)), bound=0.5, sweeps=1)
    np.testing.assert_allclose(held[0], 0.5 * S / np.sqrt(6))


def test_without_the_bound_it_is_least_squares(shapes, coefficients, start):
    found = update_atoms(shapes, coefficients, start, bound=1e6, sweeps=2000)
    expected = np.linalg.lstsq(coefficients, shapes.reshape(30, -1))[0].reshape(5, 3, 4)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_certificate(shapes, coefficients, start):
    # KKT: the slope at B_i is -u_i B_i with u_i >= 0, and u_i = 0 inside the ball.
    atoms = update_atoms(shapes, coefficients, start, BOUND, sweeps=2000)
    norms = np.linalg.norm(atoms, axis=(1, 2))
    residual = shapes - np.tensordot(coefficients, atoms, axes=1)
    slope = -np.tensordot(coefficients, residual, axes=(0, 0))
    u = -(slope * atoms).sum(axis=(1, 2)) / norms**2
    inside = norms < BOUND * (1 - 1e-9)
    assert inside.any()
    assert (~inside).any()
    assert (norms <= BOUND * (1 + 1e-12)).all()
    assert (u > -1e-9).all()
    np.testing.assert_allclose(u[inside], 0, atol=1e-8)
    np.testing.assert_allclose(slope, -u[:, None, None] * atoms, atol=1e-8)


@pytest.mark.slow
def test_agrees_with_cvxpy(shapes, coefficients, start):
    import cvxpy

    atoms = update_atoms(shapes, coefficients, start, BOUND, sweeps=2000)
    B = cvxpy.Variable((5, 12))
    problem = cvxpy.Problem(
        cvxpy.Minimize(0.5 * cvxpy.sum_squares(shapes.reshape(30, 12) - coefficients @ B)),
        [cvxpy.norm(B, axis=1) <= BOUND],
    )
    problem.solve(solver=cvxpy.CLARABEL)
    assert misfit(shapes, coefficients, atoms) == pytest.approx(problem.value, rel=1e-7)
    np.testing.assert_allclose(atoms.reshape(5, 12), B.value, atol=1e-4)


def test_every_sweep_lowers_the_misfit(shapes, coefficients, start):
    atoms = start
    values = [misfit(shapes, coefficients, atoms)]
    for _ in range(6):
        atoms = update_atoms(shapes, coefficients, atoms, 1.0, sweeps=1)
        values.append(misfit(shapes, coefficients, atoms))
    assert (np.diff(values) < 0).all()


def test_unused_atoms_stay(shapes, coefficients, start):
    coefficients[:, 2] = 0
    atoms = update_atoms(shapes, coefficients, start, 1.0)
    np.testing.assert_array_equal(atoms[2], start[2])
    assert (np.abs(np.delete(atoms - start, 2, axis=0)).max(axis=(1, 2)) > 1e-3).all()


def test_the_start_is_left_alone(shapes, coefficients, start):
    before = start.copy()
    update_atoms(shapes, coefficients, start, 1.0)
    np.testing.assert_array_equal(start, before)


def test_atoms_turn_with_the_shapes(shapes, coefficients, start, rng):
    R = random_rotations(1, rng)[0]
    turned = update_atoms(R @ shapes, coefficients, R @ start, 1.0)
    expected = R @ update_atoms(shapes, coefficients, start, 1.0)
    np.testing.assert_allclose(turned, expected, atol=1e-12)


def test_products_do_not_depend_on_where_batches_end(shapes, coefficients, start):
    whole = Products.zero(start).add(shapes, coefficients)
    np.testing.assert_allclose(whole.overlaps, coefficients.T @ coefficients, rtol=1e-12)
    expected = np.tensordot(coefficients, shapes, axes=(0, 0))
    np.testing.assert_allclose(whole.pulls, expected, atol=1e-12)
    parts = Products.zero(start)
    for rows in (slice(0, 1), slice(1, 8), slice(8, 30)):
        parts.add(shapes[rows], coefficients[rows])
    np.testing.assert_array_equal(parts.overlaps, whole.overlaps)
    np.testing.assert_array_equal(parts.pulls, whole.pulls)
