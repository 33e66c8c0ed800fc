"""Problems of all kinds, and a certificate in plain NumPy as independent judge."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.convex.problem import Loss, Problem, build_problem
from shapefit.convex.solver import Status
from shapefit.convex.transforms import nuclear_norm
from shapefit.geometry.normalisation import normalise
from tests.points import draw_rotations, transpose, unit_norm, with_noise

LOSSES = list(Loss)

TINY = 1e-300
"""In place of 0 where a share of it is asked for."""


@pytest.fixture(params=LOSSES, ids=[loss.value for loss in LOSSES])
def loss(request: pytest.FixtureRequest) -> Loss:
    return request.param


@pytest.fixture
def make_problem(rng: np.random.Generator) -> Callable[..., Problem]:
    """Normalised atoms and images of a few turned atoms plus noise, with masks and
    weights.

    An EXACT problem has no noise, so that its constraint can be met.
    """

    def make(
        n: int = 8,
        k: int = 12,
        p: int = 10,
        *,
        loss: Loss = Loss.SQUARED,
        **options: Any,
    ) -> Problem:
        noise = 0.0 if loss is Loss.EXACT else options.get("noise", 0.3)
        atoms = unit_norm(normalise(rng.standard_normal((k, 3, p))).points)
        size = rng.uniform(0, 4, (n, k))
        used = rng.random((n, k)) < 3 / k
        rotations = draw_rotations(n, k, rng)
        shapes = np.einsum("nk,nkab,kbp->nap", size * used, rotations, atoms)

        landmarks = shapes[:, :2] + rng.standard_normal((n, 2, 1))
        landmarks = with_noise(landmarks, noise, rng)
        weights = np.ones((n, p))
        if options.get("weighted", True):
            confidence = rng.uniform(0.2, 1.0, (n, p))
            visible = rng.random((n, p)) > 0.2
            weights = confidence * visible
            weights[:, :3] = 1.0
        lam = options.get("lam", 0.1)
        return build_problem(landmarks, atoms, lam, weights=weights, loss=loss)

    return make


def judge(problem, transforms, translation, dual):
    """Return objective P, bound D and relative residual (n,) of all images.

    Straight from docs/method.md, one image at a time, every norm by an SVD.
    """
    images = range(len(problem.landmarks))
    judged = [
        _judge_image(problem, i, transforms[i], translation[i], dual[i]) for i in images
    ]
    P, D, residual = np.array(judged).T
    return P, D, residual


def _judge_image(problem, image, M, T, Y):
    """Return P, D and the relative residual of one image."""
    omega = problem.weights[image]
    lam = problem.lam[image]
    W = np.where(omega > 0, problem.landmarks[image], 0.0)
    centre = _weighted_mean(W, omega)

    r = omega * (W - np.einsum("kab,kbp->ap", M, problem.atoms) - T[:, None])
    spectral_norms = np.linalg.svd(M, compute_uv=False)[:, 0]
    P = _losses(problem, r).sum() + lam * spectral_norms.sum()

    D = _dual_bound(problem, Y, omega, lam, W - centre)
    whole = np.linalg.norm(omega * (W - centre))
    residual = np.linalg.norm(r) / whole if whole > 0 else 0.0
    return P, D, residual


def _weighted_mean(W, omega):
    """Return the mean (2, 1) of landmarks with weights omega^2."""
    square = omega**2
    return (W @ square / square.sum())[:, None]


def _losses(problem, r):
    """Return f of each entry of a residual."""
    size = np.abs(r)
    squared = 0.5 * size**2
    if not np.isfinite(problem.max_dual_entry):
        return squared if problem.loss.has_quadratic else np.zeros_like(size)
    if not problem.loss.has_quadratic:
        return problem.max_dual_entry * size
    linear = problem.max_dual_entry * (size - 0.5 * problem.max_dual_entry)
    return np.where(size > problem.max_dual_entry, linear, squared)


def _dual_bound(problem, Y, omega, lam, centred_landmarks):
    """Return D of a dual Y, which is first made feasible and scaled at its best."""
    off = np.outer(Y @ omega / (omega @ omega), omega)
    Y = (Y - off) * (omega > 0)
    yw = (Y * omega * centred_landmarks).sum()
    yy = (Y**2).sum()

    singular_values = np.linalg.svd(
        (Y * omega) @ transpose(problem.atoms), compute_uv=False
    )
    nuclear = singular_values.sum(axis=1).max()
    scales = [lam / max(nuclear, TINY)]
    if np.isfinite(problem.max_dual_entry):
        highest = np.abs(Y).max()
        scales.append(problem.max_dual_entry / max(highest, TINY))
    if problem.loss.has_quadratic:
        scales.append(yw / max(yy, TINY))
    scale = max(min(scales), 0.0)
    if problem.loss.has_quadratic:
        return scale * yw - 0.5 * scale**2 * yy
    return scale * yw


def assert_certified(problem, solution, tolerance):
    """All images are OPTIMAL, and the independent certificate says so too."""
    assert set(solution.status) == {Status.OPTIMAL}
    M = solution.transforms.dense()
    P, D, residual = judge(problem, M, solution.translation, solution.dual)

    largest = np.abs(problem.landmarks).max()
    rounding = 1e-15 * largest * problem.landmarks[0].size  # of W - T
    assert_allclose(P, solution.objective, rtol=1e-9, atol=rounding)

    # tolerance and the rounding of P and D themselves
    gap_allowed = tolerance * P * (1 + 1e-6)
    assert (P - D <= gap_allowed + 1e-14 * P + rounding).all()
    if problem.loss is Loss.EXACT:
        assert (residual <= tolerance * (1 + 1e-6)).all()
        assert (D - P <= gap_allowed).all()


def lambda_max(problem):
    """max_i ||(omega^2 o (W - mean)) B_i^T||_* (n,): the least lambda whose optimum is
    zero.
    """
    square = problem.weights[:, None, :] ** 2
    W = np.where(square > 0, problem.landmarks, 0.0)
    total = square.sum(axis=2, keepdims=True)
    mean = (square * W).sum(axis=2, keepdims=True) / total
    R = square * (W - mean)
    products = R[:, None] @ transpose(problem.atoms)
    return nuclear_norm(products).max(axis=1)
