"""Problems of all kinds, and a certificate in plain NumPy as independent judge."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from shapefit.convex.problem import Loss, Problem, build_problem
from shapefit.convex.solver import Status
from shapefit.convex.transforms import nuclear_norm
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.rotations import random_rotations

LOSSES = list(Loss)


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
        atoms = normalise(rng.standard_normal((k, 3, p))).points
        atoms /= np.linalg.norm(atoms, axis=(1, 2), keepdims=True)
        coefficients = rng.uniform(0, 4, (n, k)) * (rng.random((n, k)) < 3 / k)
        rotations = random_rotations(n * k, rng).reshape(n, k, 3, 3)
        shapes = np.einsum("nk,nkab,kbp->nap", coefficients, rotations, atoms)
        landmarks = shapes[:, :2] + rng.standard_normal((n, 2, 1))
        landmarks += noise * rng.standard_normal(landmarks.shape)
        weights = np.ones((n, p))
        if options.get("weighted", True):
            weights = rng.uniform(0.2, 1.0, (n, p)) * (rng.random((n, p)) > 0.2)
            weights[:, :3] = 1.0
        return build_problem(
            landmarks, atoms, options.get("lam", 0.1), weights=weights, loss=loss
        )

    return make


def judge(problem, transforms, translation, dual):
    """Return objective P, bound D and relative residual.

    Straight from docs/method.md, one image at a time, every norm by an SVD.
    """
    found = []
    quadratic, robust = problem.loss.has_quadratic, np.isfinite(problem.bound)
    for image in range(len(problem.landmarks)):
        omega, lam = problem.weights[image], problem.lam[image]
        W = np.where(omega > 0, problem.landmarks[image], 0.0)
        M, T, Y = transforms[image], translation[image][:, None], dual[image]
        r = omega * (W - np.einsum("kab,kbp->ap", M, problem.atoms) - T)
        mean = (W @ omega**2 / (omega @ omega))[:, None]
        size = np.abs(r)
        f = 0.5 * size**2 if quadratic else np.zeros_like(size)
        if robust:
            over = problem.bound * (size - 0.5 * problem.bound)
            f = (
                np.where(size > problem.bound, over, f)
                if quadratic
                else problem.bound * size
            )
        P = f.sum() + lam * np.linalg.svd(M, compute_uv=False)[:, 0].sum()

        Y = (Y - np.outer(Y @ omega / (omega @ omega), omega)) * (omega > 0)
        nuclear = np.linalg.svd(
            (Y * omega) @ problem.atoms.swapaxes(1, 2), compute_uv=False
        )
        scales = [lam / max(nuclear.sum(axis=1).max(), 1e-300)]
        yw, yy = (Y * omega * (W - mean)).sum(), (Y**2).sum()
        if robust:
            scales.append(problem.bound / max(np.abs(Y).max(), 1e-300))
        if quadratic:
            scales.append(yw / max(yy, 1e-300))
        scale = max(min(scales), 0.0)
        D = scale * yw - (0.5 * scale**2 * yy if quadratic else 0.0)
        whole = np.linalg.norm(omega * (W - mean))
        found.append((P, D, np.linalg.norm(r) / whole if whole > 0 else 0.0))
    P, D, residual = np.array(found).T
    return P, D, residual


def assert_certified(problem, solution, tolerance):
    """All images are OPTIMAL, and the independent certificate says so too."""
    assert set(solution.status) == {Status.OPTIMAL}
    P, D, residual = judge(
        problem, solution.transforms.dense(), solution.translation, solution.dual
    )
    rounding = (
        1e-15 * np.abs(problem.landmarks).max() * problem.landmarks[0].size
    )  # of W - T
    np.testing.assert_allclose(P, solution.objective, rtol=1e-9, atol=rounding)
    # tolerance and the rounding of P and D themselves
    assert (P - D <= tolerance * P * (1 + 1e-6) + 1e-14 * P + rounding).all()
    if problem.loss is Loss.EXACT:
        assert (residual <= tolerance * (1 + 1e-6)).all()
        assert (D - P <= tolerance * P * (1 + 1e-6)).all()


def lambda_max(problem):
    """max_i ||(omega^2 o (W - mean)) B_i^T||_* (n,): the least lambda whose optimum is
    zero.
    """
    square = problem.weights[:, None, :] ** 2
    W = np.where(square > 0, problem.landmarks, 0.0)
    mean = (square * W).sum(axis=2, keepdims=True) / square.sum(axis=2, keepdims=True)
    R = square * (W - mean)
    return nuclear_norm(R[:, None] @ problem.atoms.swapaxes(1, 2)).max(axis=1)
