"""Each compiled kernel against plain NumPy."""

import numpy as np
import pytest

from shapefit.convex.transforms import nuclear_norm
from shapefit.core import parts
from tests.convex.admm import prox_spectral_norm


def as_rows(blocks: np.ndarray) -> np.ndarray:
    """(k, 2, 3) -> (6, k), the layout of the kernels."""
    return np.ascontiguousarray(blocks.reshape(-1, 6).T)


def test_moreau_sums_the_squares_of_the_prox(rng: np.random.Generator) -> None:
    M, N, dN = rng.standard_normal((3, 40, 2, 3))
    N[:3], dN[:3], M[:3] = 0, 0, 0
    step, sigma, t = 0.7, 1.3, 2.5
    argument = M + sigma * (N + step * dN)
    total = np.empty(40)
    value = parts.moreau(as_rows(M), as_rows(N), step, as_rows(dN), sigma, t, total)
    prox = prox_spectral_norm(argument, t)
    assert value == pytest.approx((prox**2).sum(), rel=1e-13)
    np.testing.assert_allclose(total, nuclear_norm(argument), rtol=1e-14)
    tight = np.abs(np.diff(np.linalg.svd(prox, compute_uv=False))[:, 0]) < 1e-12
    active = total > t
    assert (tight & active).any()  # all three cases of the prox were met
    assert (~tight & active).any()
    assert (~active).any()


BLOCKS = {
    "tight": (np.array([[2.0, 0.3, -0.1], [0.2, 1.5, 0.4]]), 1.9),
    "shrunk": (np.array([[3.0, 0.3, -0.1], [0.2, 0.5, 0.4]]), 0.7),
    "barely shrunk": (np.array([[3.0, 0.3, -0.1], [0.2, 2.5, 0.4]]), 1e-3),
    "equal singular values": (np.array([[0.0, 2.0, 0], [-2.0, 0, 0]]), 1.0),
    "rank one": (np.outer([0.6, 0.8], [1.0, 2.0, -2.0]), 1.2),
    "second row zero": (np.array([[2.0, 1.0, 0.5], [0, 0, 0]]), 0.4),
}


def derivative(
    Q: np.ndarray, t: float, sigma: float, B: np.ndarray, moved: np.ndarray, *, resolvent: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Prox, rows of the derivative with the right-hand side last, and W moved."""
    prox, weighted, rows = np.empty(6), np.empty(6), np.empty((6, 2 * B.shape[1] + 1))
    count = parts.derivative(Q.reshape(6), t, sigma, resolvent, B, moved, prox, weighted, rows)
    return prox.reshape(2, 3), rows[:count], weighted


def differences_of_prox(Q: np.ndarray, t: float) -> np.ndarray:
    """D (6, 6), the derivative of the prox by central differences."""
    step = 1e-6
    moves = step * np.eye(6).reshape(6, 2, 3)
    differences = prox_spectral_norm(Q + moves, t) - prox_spectral_norm(Q - moves, t)
    return differences.reshape(6, 6).T / (2 * step)


@pytest.mark.parametrize("name", BLOCKS)
def test_rows_of_the_derivative_against_finite_differences(
    rng: np.random.Generator, name: str
) -> None:
    """sum f^T f = sigma L^T D L with D the derivative of the prox and L Y = Y B^T."""
    (Q, t), sigma, n = BLOCKS[name], 1.7, 5
    B, moved = rng.standard_normal((3, n)), rng.standard_normal(6)
    _, rows, weighted = derivative(Q, t, sigma, B, moved, resolvent=False)
    D = differences_of_prox(Q, t)
    L = np.kron(np.eye(2), B)  # rows: the six entries of Y B^T, columns: those of Y
    expected = sigma * L.T @ D @ L
    F, f = rows[:, :-1], rows[:, -1]
    assert len(rows) == (4 if name in ("tight", "equal singular values") else 6)
    np.testing.assert_allclose(F.T @ F, expected, atol=2e-8 * np.abs(expected).max())
    np.testing.assert_allclose(weighted, D @ moved, atol=1e-7)
    np.testing.assert_allclose(F.T @ f, -L.T @ D @ moved, atol=1e-7)


@pytest.mark.parametrize("name", BLOCKS)
def test_weights_of_the_resolvent_are_those_of_the_derivative(
    rng: np.random.Generator, name: str
) -> None:
    """W = D (I - D)^-1 with eigenvalues of at most a thousand."""
    (Q, t), sigma, n = BLOCKS[name], 0.6, 4
    B, moved = rng.standard_normal((3, n)), rng.standard_normal(6)
    _, rows, weighted = derivative(Q, t, sigma, B, moved, resolvent=True)
    values, vectors = np.linalg.eigh(differences_of_prox(Q, t))
    values = np.clip(values, 0.0, 1000 / 1001)
    W = (vectors * (values / (1 - values))) @ vectors.T
    L = np.kron(np.eye(2), B)
    F, f = rows[:, :-1], rows[:, -1]
    size = np.abs(W).max()
    np.testing.assert_allclose(F.T @ F, sigma * L.T @ W @ L, atol=2e-5 * size)
    np.testing.assert_allclose(weighted, W @ moved, atol=2e-5 * size)
    np.testing.assert_allclose(F.T @ f, -L.T @ W @ moved, atol=2e-5 * size)


NO_MATRIX = np.zeros((0, 0))


@pytest.mark.parametrize("n", [2, 10, 34])
@pytest.mark.parametrize("rows", [0, 9, 10, 61])
@pytest.mark.parametrize("by_rows", [True, False])
def test_gram_system_against_numpy(
    rng: np.random.Generator, n: int, rows: int, by_rows: bool
) -> None:
    F, f, r = rng.standard_normal((rows, n)), rng.standard_normal(rows), rng.standard_normal(n)
    x, shift = np.empty(n), 0.3
    parts.solve_gram(F, f, r, NO_MATRIX, shift, by_rows, x)
    expected = np.linalg.solve(shift * np.eye(n) + F.T @ F, r + F.T @ f)
    np.testing.assert_allclose(x, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("n", [2, 6, 28])
def test_gram_system_with_a_matrix_of_its_own(rng: np.random.Generator, n: int) -> None:
    F, f, r = rng.standard_normal((5, n)), rng.standard_normal(5), rng.standard_normal(n)
    root = rng.standard_normal((n, n))
    C, x = root @ root.T + np.eye(n), np.empty(n)
    parts.solve_gram(F, f, r, C, 0.0, False, x)
    np.testing.assert_allclose(x, np.linalg.solve(C + F.T @ F, r + F.T @ f), rtol=1e-9)


def test_a_singular_gram_system_still_gives_a_descent_direction(rng: np.random.Generator) -> None:
    F, gradient = np.zeros((4, 6)), rng.standard_normal(6)
    F[:3] = rng.standard_normal((3, 6))
    F[3] = F[0]
    d = np.empty(6)
    parts.solve_gram(F, np.zeros(4), -gradient, NO_MATRIX, 1e-13, False, d)
    assert np.isfinite(d).all()
    assert d @ gradient < 0
