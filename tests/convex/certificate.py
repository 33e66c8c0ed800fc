"""What any transforms and any dual point prove about the optimum, for a batch of images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shapefit import core
from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.convex.transforms import Transforms, nuclear_norm


@dataclass(frozen=True)
class Certificate:
    """D <= optimum <= P, and the points that prove it.

    objective P and relative_gap (P - D) / P (n,); residual (n,), ||Omega o (W - sum M_i B_i -
    T 1^T)||_F / ||Omega o (W - mean)||_F; translation T (n, 2) and errors E (n, 2, p), weighted,
    that go with the transforms; dual Y (n, 2, p), feasible.
    """

    objective: Floats
    relative_gap: Floats
    residual: Floats
    translation: Floats
    errors: Floats
    dual: Floats


def certify_transforms(
    problem: Problem, transforms: Floats, dual: Floats, errors: Floats | None = None
) -> Certificate:
    """P = f(Omega o (W - sum M_i B_i - T 1^T)) + lambda sum ||M_i||_2 and its dual bound D.

    D = <Y, Omega o W> - f*(Y), f* the conjugate of the loss, with ||(Omega o Y) B_i^T||_* <=
    lambda for all i and Y omega = 0. transforms M (n, k, 2, 3); dual Y (n, 2, p), any: it is made
    orthogonal to omega and scaled until it is feasible; errors E (n, 2, p), weighted, 0 if not
    given, from which T follows: the mean of what transforms and errors leave of the landmarks,
    weighted by omega^2 where the loss has a quadratic. Under the EXACT loss
    P counts lambda sum ||M_i||_2 alone and means something where the residual is small.
    """
    n, _, p = problem.landmarks.shape
    E = np.zeros((n, 2, p)) if errors is None else np.array(errors, dtype=np.float64)
    Y = np.array(dual, dtype=np.float64)
    objective, gap, residual, T = np.empty(n), np.empty(n), np.empty(n), np.empty((n, 2))
    core.certify(
        **problem.arrays, delta=float(problem.loss.has_quadratic), bound=problem.bound, threads=0,
        **Transforms.of(transforms).arrays, translation=T, dual=Y, errors=E,
        objective=objective, relative_gap=gap, residual=residual,
    )  # fmt: skip
    return Certificate(objective, gap, residual, T, E, Y)


def lambda_max(problem: Problem) -> Floats:
    """max_i ||(omega^2 o (W - mean)) B_i^T||_*, the least lambda whose optimum is zero, (n,).

    The mean is weighted by omega^2. Squared loss only: raises ValueError for any other.
    """
    problem.require_squared("lambda_max")
    square = problem.weights[:, None, :] ** 2
    W = np.where(square > 0, problem.landmarks, 0.0)
    mean = (square * W).sum(axis=2, keepdims=True) / square.sum(axis=2, keepdims=True)
    R = square * (W - mean)
    return nuclear_norm(R[:, None] @ problem.atoms.swapaxes(1, 2)).max(axis=1)
