"""Solve the convex program for many images with the compiled core, on several threads."""

from __future__ import annotations

import numpy as np

from shapefit import core
from shapefit.convex.problem import Loss, Problem
from shapefit.convex.solution import Solution, Status

_STATUS = (Status.OPTIMAL, Status.ITERATION_LIMIT, Status.DEGENERATE, Status.NUMERICAL_FAILURE)


def solve_newton(
    problem: Problem,
    *,
    tolerance: float = 1e-4,
    max_iterations: int = 1000,
    threads: int = 0,
    start: Solution | None = None,
) -> Solution:
    """Solve every image to a relative duality gap <= tolerance by semismooth Newton steps.

    `threads` = 0 means all cores. `start` is a solution for the same images, weights and loss at
    another lambda, for example, and is left as it is. For the EXACT loss the relative residual
    ||W - sum M_i B_i|| / ||W|| must fall below the tolerance too, and the gap is nan where it does
    not. An image with fewer than two visible landmarks is DEGENERATE. The method is written down in
    shapefit/core/convex: primal_dual.hpp and lagrangian.hpp.
    """
    n, _, p = problem.landmarks.shape
    k = len(problem.atoms)
    transforms, translation = np.zeros((n, k, 2, 3)), np.zeros((n, 2))
    dual, errors = np.zeros((n, 2, p)), np.zeros((n, 2, p))
    if start is not None:
        transforms, dual, errors = start.transforms.copy(), start.dual.copy(), start.errors.copy()
    objective, gap, residual = np.zeros(n), np.zeros(n), np.zeros(n)
    steps, codes = np.zeros(n, np.int64), np.zeros(n, np.int64)
    core.solve_convex(
        **problem.arrays, delta=float(problem.loss.has_quadratic), bound=problem.bound,
        tolerance=tolerance, most_steps=max_iterations, started=start is not None, threads=threads,
        transforms=transforms, translation=translation, dual=dual, errors=errors,
        objective=objective, relative_gap=gap, residual=residual, steps=steps, status=codes,
    )  # fmt: skip
    if problem.loss is Loss.EXACT:  # P is no bound while the landmarks are not met
        gap[residual > tolerance] = np.nan
    status = tuple(_STATUS[code] for code in codes)
    return Solution(transforms, translation, dual, errors, objective, gap, residual, steps, status)
