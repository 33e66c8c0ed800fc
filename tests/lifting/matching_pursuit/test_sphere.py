"""Least squares on a sphere: optimality, planted minimisers, scipy, the hard case, symmetries."""

import numpy as np
import pytest

from shapefit.lifting.matching_pursuit import minimise_on_sphere

RADIUS = 1.7


def minimiser(G, g, radius=RADIUS, before=None):
    y = np.ones(len(g)) if before is None else np.array(before, dtype=float)
    found, multiplier = minimise_on_sphere(np.array([G]), np.array([g]), radius, y[None])
    return found[0], multiplier[0]


def assert_optimal(G, g, radius, y, multiplier):
    """Stationary, on the sphere, and the Hessian of the Lagrangian is positive semidefinite."""
    size = np.linalg.norm(G, 2) + np.linalg.norm(g) / radius
    assert np.linalg.norm(y) == pytest.approx(radius, rel=1e-14)
    residual = np.linalg.norm(G @ y + multiplier * y - g)
    assert residual <= 1e-12 * size * radius
    assert np.linalg.eigvalsh(G)[0] + multiplier >= -1e-13 * size


def make_case(rng, m, rank=None):
    A = rng.standard_normal((m if rank is None else rank, m))
    return A.T @ A, A.T @ rng.standard_normal(len(A))


@pytest.mark.parametrize("m", [1, 2, 3, 5, 16])
@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e3])
def test_it_meets_the_optimality_conditions(rng, m, radius):
    for _ in range(20):
        G, g = make_case(rng, m)
        y, multiplier = minimiser(G, g, radius)
        assert_optimal(G, g, radius, y, multiplier)


@pytest.mark.parametrize("multiplier", [-0.3, 0.0, 4.0])
def test_a_planted_minimiser_is_found(rng, multiplier):
    # G + multiplier I >= 0.2 I makes it the only one.
    for _ in range(20):
        V, _ = np.linalg.qr(rng.standard_normal((6, 6)))
        G = (V * rng.uniform(0.5, 5, 6)) @ V.T
        planted = rng.standard_normal(6)
        planted *= RADIUS / np.linalg.norm(planted)
        y, found = minimiser(G, G @ planted + multiplier * planted)
        np.testing.assert_allclose(y, planted, atol=1e-12)
        assert found == pytest.approx(multiplier, abs=1e-12)


class TestHardCase:
    """g has no part along the least eigenvalue: the eigenvector fills up y."""

    @pytest.mark.parametrize("side", [-1, 1])
    def test_of_two_minimisers_the_nearer_is_taken(self, side):
        G, g = np.diag([1.0, 3.0, 4.0]), np.array([0.0, 2.0, 0.0])
        y, multiplier = minimiser(G, g, before=[side, 0.1, 0.2])
        np.testing.assert_allclose(y, [side * np.sqrt(RADIUS**2 - 1), 1, 0], atol=1e-14)
        assert multiplier == pytest.approx(-1)

    def test_a_singular_matrix(self, rng):
        for _ in range(20):
            G, g = make_case(rng, 6, rank=3)
            y, multiplier = minimiser(G, g, radius=50.0)
            assert_optimal(G, g, 50.0, y, multiplier)
            assert multiplier == pytest.approx(0, abs=1e-12)
