"""Solve the convex program for many images with the compiled core, on several threads."""

from __future__ import annotations

import numpy as np

from shapefit import core
from shapefit.convex.problem import Loss, Problem
from shapefit.convex.solution import Solution, read_statuses
from shapefit.convex.transforms import Transforms


def solve_newton(
    problem: Problem,
    *,
    tolerance: float = 1e-4,
    max_iterations: int = 1000,
    threads: int = 0,
) -> Solution:
    """Solve every image to a relative duality gap <= tolerance by semismooth Newton steps.

    `threads` = 0 means all cores. For the EXACT loss the relative residual ||W - sum M_i B_i|| /
    ||W|| must fall below the tolerance too, and the gap is nan where it does not. An image with
    fewer than two visible landmarks is DEGENERATE. The method is written down in
    shapefit/core/convex/newton.hpp.
    """
    n, _, p = problem.landmarks.shape
    k = len(problem.atoms)
    first, count = np.zeros(n, np.int64), np.zeros(n, np.int64)
    atom, blocks = np.empty(n * k, np.int64), np.empty((n * k, 2, 3))
    translation, dual = np.zeros((n, 2)), np.zeros((n, 2, p))
    errors = np.zeros((n, 2, 0 if problem.loss is Loss.SQUARED else p))
    objective, gap, residual = np.zeros(n), np.zeros(n), np.zeros(n)
    steps, codes = np.zeros(n, np.int64), np.zeros(n, np.int64)
    core.solve_convex(
        **problem.arrays, delta=float(problem.loss.has_quadratic), bound=problem.bound,
        tolerance=tolerance, most_steps=max_iterations, threads=threads,
        first=first, count=count, atom=atom, blocks=blocks, used=np.zeros(1, np.int64),
        translation=translation, dual=dual, errors=errors,
        objective=objective, relative_gap=gap, residual=residual, steps=steps, status=codes,
    )  # fmt: skip
    if problem.loss is Loss.EXACT:  # P is no bound while the landmarks are not met
        gap[residual > tolerance] = np.nan
    if problem.loss is Loss.SQUARED:
        errors = np.broadcast_to(0.0, dual.shape)
    transforms = Transforms.gathered(first, count, atom, blocks, k)
    status = read_statuses(codes)
    return Solution(transforms, translation, dual, errors, objective, gap, residual, steps, status)
