"""The trust region step on the rotation: Manopt's answer, certificates, planted rotations."""

import numpy as np
import pymanopt
import pytest
from pymanopt.manifolds import Stiefel
from pymanopt.optimizers import TrustRegions

from shapefit import core
from shapefit.geometry.rotations import random_rotations, rotation_about

MANIFOLD = Stiefel(3, 2)


def turn(w, S, start, *, free=False):
    """Return the rotation that the step reaches, its misfit, and the scale."""
    R = start.copy()
    value, s = core.parts.rotation_step(S @ S.T, w @ S.T, free, R)
    return R, value + 0.5 * (w**2).sum(), s


def misfit(w, S, R, s=1.0):
    return 0.5 * ((w - s * R[:2] @ S) ** 2).sum()


def riemannian_gradient(w, S, R, s=1.0):
    G = s * (s * R[:2] @ S - w) @ S.T
    inner = R[:2] @ G.T
    return G - 0.5 * (inner + inner.T) @ R[:2]


def judge(w, S, start):
    """Minimise with pymanopt's trust regions; points are 3x2 there."""
    P, D = S @ S.T, w @ S.T

    @pymanopt.function.numpy(MANIFOLD)
    def cost(X):
        return 0.5 * ((w - X.T @ S) ** 2).sum()

    @pymanopt.function.numpy(MANIFOLD)
    def gradient(X):
        return P @ X - D.T

    @pymanopt.function.numpy(MANIFOLD)
    def hessian(_X, U):
        return P @ U

    problem = pymanopt.Problem(
        MANIFOLD, cost, euclidean_gradient=gradient, euclidean_hessian=hessian
    )
    optimizer = TrustRegions(verbosity=0, min_gradient_norm=1e-9, max_iterations=200)
    return optimizer.run(problem, initial_point=start[:2].T.copy()).point.T


@pytest.fixture
def make_case(rng):
    def make(q=10, noise=0.3):
        S = rng.uniform(0.3, 2, (3, 1)) * rng.standard_normal((3, q))
        R = random_rotations(1, rng)[0]
        w = R[:2] @ S + noise * rng.standard_normal((2, q))
        return w, S, R

    return make


@pytest.mark.parametrize("noise", [0.0, 0.3, 3.0])
@pytest.mark.parametrize("q", [2, 3, 12])
def test_pymanopt_finds_the_same_minimiser_from_the_same_start(make_case, rng, q, noise):
    for start in random_rotations(8, rng):
        w, S, _ = make_case(q, noise)
        R, _, _ = turn(w, S, start)
        np.testing.assert_allclose(R[:2], judge(w, S, start), atol=1e-6)


@pytest.mark.parametrize("seed", [663, 702, 2236, 4205, 5886])
def test_a_step_that_would_rise_is_refused(seed):
    """Long thin shapes, and starts from which accepting every step ends in another minimum."""
    rng = np.random.default_rng(seed)
    S = np.array([[30.0], [1.0], [0.03]]) * rng.normal(size=(3, 5))
    truth, start = random_rotations(2, rng)
    w = truth[:2] @ S + rng.normal(size=(2, 5))
    R, _, _ = turn(w, S, start)
    np.testing.assert_allclose(R[:2], judge(w, S, start), atol=1e-6)


def test_a_planted_rotation_comes_back_with_its_scale(make_case):
    for scale in (0.01, 0.7, 5.0):
        w, S, truth = make_case(noise=0.0)
        nearby = truth @ rotation_about(np.array([1.0, 2.0, -1.0]), np.array([0.3]))[0]
        R, _, s = turn(scale * w, S, nearby, free=True)
        np.testing.assert_allclose(R, truth, atol=1e-9)
        assert s == pytest.approx(scale, rel=1e-9)


@pytest.mark.parametrize("free", [False, True])
def test_it_ends_at_a_local_minimum(make_case, rng, free):
    for start in random_rotations(100, rng):
        w, S, _ = make_case(noise=1.0)
        if np.sum(w * (start[:2] @ S)) < 0:  # else the best scale is 0, and stays there
            start[:2] *= -1
        R, value, s = turn(w, S, start, free=free)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(R) == pytest.approx(1)
        assert value == pytest.approx(misfit(w, S, R, s), rel=1e-11)
        gradient = riemannian_gradient(w, S, R, s)
        assert np.linalg.norm(gradient) < 1e-9 * (np.linalg.norm(w @ S.T) + (S**2).sum())
        if free:
            best = np.sum(w * (R[:2] @ S)) / np.sum((R[:2] @ S) ** 2)
            assert s == pytest.approx(best, rel=1e-12)
        for axis in rng.standard_normal((5, 3)):
            moved = rotation_about(axis, np.array([1e-3]))[0] @ R
            assert misfit(w, S, moved, s) >= misfit(w, S, R, s)


@pytest.mark.parametrize("free", [False, True])
def test_without_a_shape_the_rotation_stays(rng, free):
    R = random_rotations(1, rng)[0]
    before = R.copy()
    value, s = core.parts.rotation_step(np.zeros((3, 3)), np.zeros((2, 3)), free, R)
    np.testing.assert_array_equal(R, before)
    assert value == 0
    assert s == (0 if free else 1)
