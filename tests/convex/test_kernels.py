"""Each compiled kernel against plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from shapefit.convex.block_kernels import (
    correlate,
    jacobian_rows,
    largest_nuclear_norm,
    moreau,
    prox_block,
)
from shapefit.convex.linear_kernels import newton_direction
from shapefit.convex.newton_kernels import soft_squared
from shapefit.convex.reduction_kernels import expand_rows, find_visible, reduce_rows
from shapefit.convex.spectral_norm import nuclear_norm, prox_spectral_norm


def as_rows(blocks: np.ndarray) -> np.ndarray:
    """(k, 2, 3) -> (6, k), the layout of the kernels."""
    return np.ascontiguousarray(blocks.reshape(-1, 6).T)


@pytest.mark.parametrize("q", [1, 3, 4, 5, 14])
def test_correlate_is_y_times_the_transposed_atoms(rng: np.random.Generator, q: int) -> None:
    Y, B = rng.standard_normal((2, q)), rng.standard_normal((7, 3, q))
    N = np.full((6, 7), np.nan)
    correlate(Y, np.ascontiguousarray(B.transpose(1, 2, 0)), N)
    np.testing.assert_allclose(N, as_rows(Y @ B.swapaxes(1, 2)), rtol=1e-13, atol=1e-14)


def test_largest_nuclear_norm(rng: np.random.Generator) -> None:
    blocks = rng.standard_normal((9, 2, 3))
    assert largest_nuclear_norm(as_rows(blocks)) == pytest.approx(nuclear_norm(blocks).max())
    assert largest_nuclear_norm(np.zeros((6, 8))) == 0


def test_moreau_sums_the_squares_of_the_prox(rng: np.random.Generator) -> None:
    M, N, dN = rng.standard_normal((3, 40, 2, 3))
    N[:3], dN[:3], M[:3] = 0, 0, 0
    step, sigma, t = 0.7, 1.3, 2.5
    argument = M + sigma * (N + step * dN)
    total = np.empty(40)
    value = moreau(as_rows(M), as_rows(N), step, as_rows(dN), sigma, t, total)
    prox = prox_spectral_norm(argument, t)
    assert value == pytest.approx((prox**2).sum(), rel=1e-13)
    np.testing.assert_allclose(total, nuclear_norm(argument), rtol=1e-14)
    tight = np.abs(np.diff(np.linalg.svd(prox, compute_uv=False))[:, 0]) < 1e-12
    active = total > t
    assert (tight & active).any()  # all three cases of the prox were met
    assert (~tight & active).any()
    assert (~active).any()


def test_soft_squared_sums_what_exceeds_the_threshold(rng: np.random.Generator) -> None:
    E, Y, D = rng.standard_normal((3, 2, 11))
    rho = rng.uniform(0.5, 2.0, 11)
    argument = np.abs(E + rho * (Y + 0.3 * D))
    expected = (np.maximum(argument - 0.8, 0) ** 2 / rho).sum()
    assert soft_squared(E, Y, 0.3, D, rho, 0.8) == pytest.approx(expected, rel=1e-13)


BLOCKS = {
    "tight": (np.array([[2.0, 0.3, -0.1], [0.2, 1.5, 0.4]]), 1.9),
    "shrunk": (np.array([[3.0, 0.3, -0.1], [0.2, 0.5, 0.4]]), 0.7),
    "barely shrunk": (np.array([[3.0, 0.3, -0.1], [0.2, 2.5, 0.4]]), 1e-3),
    "equal singular values": (np.array([[0.0, 2.0, 0], [-2.0, 0, 0]]), 1.0),
    "rank one": (np.outer([0.6, 0.8], [1.0, 2.0, -2.0]), 1.2),
    "second row zero": (np.array([[2.0, 1.0, 0.5], [0, 0, 0]]), 0.4),
}


@pytest.mark.parametrize("name", BLOCKS)
def test_prox_block_agrees_with_the_batched_prox(name: str) -> None:
    Q, t = BLOCKS[name]
    out = np.empty(6)
    norm = prox_block(Q.reshape(6), t, out)
    P = prox_spectral_norm(Q, t)
    np.testing.assert_allclose(out.reshape(2, 3), P, atol=1e-14)
    assert norm == pytest.approx(np.linalg.svd(P, compute_uv=False)[0], rel=1e-13)


@pytest.mark.parametrize("name", BLOCKS)
def test_jacobian_rows_against_finite_differences(rng: np.random.Generator, name: str) -> None:
    """sum f^T f = sigma L^T D L with D the derivative of the prox and L Y = Y B^T."""
    (Q, t), sigma, n = BLOCKS[name], 1.7, 5
    B = rng.standard_normal((3, n))
    F = np.full((8, 2 * n), np.nan)
    count = jacobian_rows(Q.reshape(6), t, sigma, B, F, 0)
    step = 1e-6
    moves = step * np.eye(6).reshape(6, 2, 3)
    differences = prox_spectral_norm(Q + moves, t) - prox_spectral_norm(Q - moves, t)
    D = differences.reshape(6, 6).T / (2 * step)
    L = np.kron(np.eye(2), B)  # rows: the six entries of Y B^T, columns: those of Y
    expected = sigma * L.T @ D @ L
    found = F[:count].T @ F[:count]
    assert count == (4 if name in ("tight", "equal singular values") else 6)
    np.testing.assert_allclose(found, expected, atol=2e-8 * np.abs(expected).max())


NO_ERRORS = np.zeros((2, 0))


@pytest.mark.parametrize("rows", [0, 3, 9, 10, 11, 26])
@pytest.mark.parametrize("by_rows", [True, False])
def test_newton_direction_against_numpy(rng: np.random.Generator, rows: int, by_rows: bool) -> None:
    n, shift = 10, 1.0
    F, gradient = rng.standard_normal((30, n)), rng.standard_normal(n)
    H, small, d = np.empty((n, n)), np.empty(n), np.empty(n)
    newton_direction(F, rows, NO_ERRORS, np.empty(0), shift, by_rows, gradient, H, small, d)
    expected = -np.linalg.solve(shift * np.eye(n) + F[:rows].T @ F[:rows], gradient)
    np.testing.assert_allclose(d, expected, rtol=1e-10)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("by_rows", [True, False])
def test_newton_direction_with_the_curvature_of_errors(
    rng: np.random.Generator, share: float, by_rows: bool
) -> None:
    seen, rows, shift = 8, 3, 1.0
    q = seen - 1
    visible, h = np.zeros(seen, np.int64), np.zeros(seen)
    find_visible(rng.uniform(0.5, 2.0, seen), visible, h)
    curvature = rng.uniform(0.1, 3.0, (2, seen)) * (rng.random((2, seen)) < share)
    F, gradient = rng.standard_normal((rows + 2 * seen, 2 * q)), rng.standard_normal(2 * q)
    steps = (np.eye(seen) - np.outer(h, h))[:, :q]  # what each E feels of the dual
    expected = shift * np.eye(2 * q) + F[:rows].T @ F[:rows]
    expected[:q, :q] += steps.T @ np.diag(curvature[0]) @ steps
    expected[q:, q:] += steps.T @ np.diag(curvature[1]) @ steps
    H, small, d = np.empty((2 * q, 2 * q)), np.empty(2 * q), np.empty(2 * q)
    newton_direction(F, rows, curvature, h, shift, by_rows, gradient, H, small, d)
    np.testing.assert_allclose(d, -np.linalg.solve(expected, gradient), rtol=1e-10)


def test_newton_direction_descends_where_the_matrix_is_singular(rng: np.random.Generator) -> None:
    F, gradient = np.zeros((4, 6)), rng.standard_normal(6)
    F[:3] = rng.standard_normal((3, 6))
    F[3] = F[0]
    d = np.empty(6)
    H, small = np.empty((6, 6)), np.empty(6)
    newton_direction(F, 4, NO_ERRORS, np.empty(0), 1e-13, False, gradient, H, small, d)
    assert np.isfinite(d).all()
    assert d @ gradient < 0


def reduced(X: np.ndarray, omega: np.ndarray) -> np.ndarray:
    visible, h = np.zeros(len(omega), np.int64), np.zeros(len(omega))
    seen = find_visible(omega, visible, h)
    out = np.empty((len(X), seen - 1))
    reduce_rows(X, omega, visible, h, seen, out)
    return out


def expanded(y: np.ndarray, omega: np.ndarray) -> np.ndarray:
    visible, h = np.zeros(len(omega), np.int64), np.zeros(len(omega))
    seen = find_visible(omega, visible, h)
    out = np.full((len(y), len(omega)), np.nan)
    expand_rows(y, visible, h, seen, out)
    return out


@pytest.mark.parametrize(
    "omega", [np.ones(6), np.array([0, 1, 0, 1, 1.0, 0]), np.array([1e-3, 0, 2, 1e3, 0.5, 1])]
)
def test_reduction_keeps_all_but_the_translation(
    rng: np.random.Generator, omega: np.ndarray
) -> None:
    X = rng.standard_normal((3, 6))
    small = reduced(X, omega)
    assert small.shape == (3, (omega > 0).sum() - 1)
    scale = np.abs(X * omega).max()
    # a translation is lost, and nothing else: distances are those after the best translation
    np.testing.assert_allclose(reduced(X + 5.0, omega), small, atol=1e-14 * scale * 10)
    mean = (X @ omega**2 / (omega @ omega))[:, None]
    best = ((X - mean) * omega) @ ((X - mean) * omega).T
    np.testing.assert_allclose(small @ small.T, best, atol=1e-13 * scale**2)

    y = rng.standard_normal(small.shape)
    Y = expanded(y, omega)
    assert not Y[:, omega == 0].any()
    np.testing.assert_allclose(Y @ omega, 0, atol=1e-14 * omega.max() * 10)
    np.testing.assert_allclose(Y @ Y.T, y @ y.T, rtol=1e-13)
    np.testing.assert_allclose((Y * omega) @ X.T, y @ small.T, atol=1e-13 * scale)


def test_find_visible_counts_down_to_none() -> None:
    visible, h = np.zeros(3, np.int64), np.zeros(3)
    assert find_visible(np.zeros(3), visible, h) == 0
    assert find_visible(np.array([0, 0.5, 0]), visible, h) == 1
    assert find_visible(np.array([0.5, 0, 2]), visible, h) == 2
    assert visible[:2].tolist() == [0, 2]
