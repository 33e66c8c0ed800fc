"""The convex program alone, on arrays, with its certificate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from shapefit.arrays import Floats
from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solver import solve_newton


@dataclass(frozen=True, repr=False)
class Optimum:
    """The optimum of the convex program; without the axis n for a single image.

    transforms    M (n, k, 2, 3), most of them 0
    translation   T (n, 2)
    dual          Y (n, 2, p): with sum_j omega_j Y_j = 0 and ||(Omega o Y) B_i^T||_* <=
                  lambda, its
                  value <W, Omega o Y> - 1/2 ||Y||^2 (squared loss) is a lower bound
    objective     (n,), of M and T
    relative_gap  (n,), how far the objective may be above the optimum, as a share of it
    status        `optimal`, or why not: one text, or (n,) of them
    """

    transforms: Floats
    translation: Floats
    dual: Floats
    objective: Floats
    relative_gap: Floats
    status: str | tuple[str, ...]


def solve(
    landmarks: ArrayLike,
    atoms: ArrayLike,
    lam: float,
    *,
    weights: ArrayLike | None = None,
    loss: str = "squared",
    beta: float = 0.1,
    tolerance: float = 1e-6,
    max_iterations: int = 1000,
    threads: int = 0,
) -> Optimum:
    """Solve the convex program of images, and return its optimum with a certificate.

    It is min_{M,T} f(Omega o (W - sum_i M_i B_i - T 1^T)) + lambda sum_i ||M_i||_2, for
    landmarks W (2, p) of one image or (n, 2, p), nan where unseen; atoms B (k, 3, p);
    weights Omega (p,) or (n, p) >= 0; loss f: squared, exact, l1 or sparse-error with
    its weight beta. Nothing is normalised or centred, as `fit` does. Raises ValueError
    on what does not fit together. The method: shapefit/core/convex/newton.hpp.
    """
    W = np.asarray(landmarks, np.float64)
    B = np.asarray(atoms, np.float64)
    omega = None if weights is None else np.asarray(weights, np.float64)
    problem = build_problem(W, B, lam, weights=omega, loss=Loss(loss), beta=beta)
    solution = solve_newton(
        problem, tolerance=tolerance, max_iterations=max_iterations, threads=threads
    )
    only = 0 if W.ndim == 2 else slice(None)
    status = tuple(code.value for code in solution.status)
    return Optimum(
        solution.transforms.dense()[only],
        solution.translation[only],
        solution.dual[only],
        solution.objective[only],
        solution.relative_gap[only],
        status[0] if W.ndim == 2 else status,
    )
