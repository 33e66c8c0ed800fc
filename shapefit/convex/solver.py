"""Solve the convex program for many images: one status, certificate and set of
transforms each.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.convex.problem import Loss, Problem
from shapefit.convex.span import find_span, reduce_images
from shapefit.convex.transforms import Transforms


class Status(Enum):
    """How the work on one image ended; the value is the word in files and reports.

    CONVERGED is the end of a method without a certificate: a local optimum, or
    transforms that have stopped changing.
    """

    OPTIMAL = "optimal"
    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration limit"
    DEGENERATE = "degenerate input"
    NUMERICAL_FAILURE = "numerical failure"


def read_statuses(codes: NDArray[np.int64]) -> tuple[Status, ...]:
    """Return the statuses of the codes (n,) that kernels write: their order above."""
    return tuple(map(tuple(Status).__getitem__, codes.tolist()))


class Solution(NamedTuple):
    """Optimum of the convex program for n images.

    transforms M; translation T (n, 2); dual Y (n, 2, p), feasible up to scaling; errors
    E (n, 2, p), the sparse errors of a robust loss in the units of the landmarks, else
    zero; objective and relative_gap (n,), computed from scratch at the end; residual
    (n,),
    ||Omega o (W - sum M_i B_i - T 1^T)||_F / ||Omega o (W - mean)||_F; iterations (n,);
    status, a Status per image.
    """

    transforms: Transforms
    translation: Floats
    dual: Floats
    errors: Floats
    objective: Floats
    relative_gap: Floats
    residual: Floats
    iterations: NDArray[np.int64]
    status: tuple[Status, ...]


def solve_newton(
    problem: Problem,
    *,
    tolerance: float = 1e-4,
    max_iterations: int = 1000,
    threads: int = 0,
) -> Solution:
    """Solve every image to a relative duality gap <= tolerance by semismooth Newton
    steps.

    `threads` = 0 means all cores. For the EXACT loss the relative residual
    ||W - sum M_i B_i|| / ||W|| must fall below the tolerance too, and the gap is nan
    where it does not. An image with fewer than two visible landmarks is DEGENERATE. The
    method is written down in shapefit/core/convex/newton.hpp. Large shapes are solved
    in the span of the atoms, see `span`.
    """
    solve = partial(
        solve_directly,
        tolerance=tolerance,
        max_iterations=max_iterations,
        threads=threads,
    )
    span = find_span(problem)
    if span is None:
        return solve(problem)
    return solve_in_span(problem, span, solve, threads)


def solve_directly(
    problem: Problem, *, tolerance: float, max_iterations: int, threads: int
) -> Solution:
    """Solve every image with all of its landmarks."""
    n, _, p = problem.landmarks.shape
    k = len(problem.atoms)
    first, count, steps, codes = np.zeros((4, n), np.int64)
    atom, blocks = np.empty(n * k, np.int64), np.empty((n * k, 2, 3))
    translation, dual = np.zeros((n, 2)), np.zeros((n, 2, p))
    errors = np.zeros((n, 2, 0 if problem.loss is Loss.SQUARED else p))
    objective, gap, residual = np.zeros((3, n))
    core.solve_convex(
        **problem.arrays,
        delta=float(problem.loss.has_quadratic),
        bound=problem.bound,
        tolerance=tolerance,
        most_steps=max_iterations,
        threads=threads,
        first=first,
        count=count,
        atom=atom,
        blocks=blocks,
        used=np.zeros(1, np.int64),
        translation=translation,
        dual=dual,
        errors=errors,
        objective=objective,
        relative_gap=gap,
        residual=residual,
        steps=steps,
        status=codes,
    )
    if problem.loss is Loss.EXACT:  # P is no bound while the landmarks are not met
        gap[residual > tolerance] = np.nan
    if problem.loss is Loss.SQUARED:
        errors = np.broadcast_to(0.0, dual.shape)
    transforms = Transforms.gathered(first, count, atom, blocks, k)
    status = read_statuses(codes)
    return Solution(
        transforms, translation, dual, errors, objective, gap, residual, steps, status
    )


def solve_in_span(
    problem: Problem,
    span: Floats,
    solve: Callable[[Problem], Solution],
    threads: int,
) -> Solution:
    """Solve the images reduced to the span (p, r) of the atoms, and certify their
    solutions as those of the problem.

    The part of the landmarks that the atoms do not span joins the objective, never the
    gap's numerator: a reduction that is solved to the tolerance solves the problem to
    it.
    """
    n, _, p = problem.landmarks.shape
    dual, order, solved = np.zeros((n, 2, p)), [], []
    for part in reduce_images(problem, span):
        solution = solve(part.problem)
        dual[part.rows] = part.expand(solution.dual, problem)
        order.append(part.rows)
        solved.append(solution)
    back = np.argsort(np.concatenate(order))
    transforms = Transforms.joined([solution.transforms for solution in solved]).take(
        back
    )
    status = np.array([value for solution in solved for value in solution.status])[back]
    translation = np.zeros((n, 2))
    objective, gap, residual = np.full((3, n), np.nan)
    core.certify(
        **problem.arrays,
        **transforms.arrays,
        delta=1.0,
        bound=problem.bound,
        translation=translation,
        dual=dual,
        errors=np.zeros((n, 2, 0)),
        objective=objective,
        relative_gap=gap,
        residual=residual,
        threads=threads,
    )
    degenerate = status == Status.DEGENERATE
    objective[degenerate] = gap[degenerate] = residual[degenerate] = np.nan
    steps = np.concatenate([solution.iterations for solution in solved])[back]
    errors = np.broadcast_to(0.0, dual.shape)
    return Solution(
        transforms,
        translation,
        dual,
        errors,
        objective,
        gap,
        residual,
        steps,
        tuple(status),
    )


def find_outliers(problem: Problem, solution: Solution) -> NDArray[np.bool_] | None:
    """Landmarks (n, p) with a weighted residual beyond beta in a coordinate; None if
    not robust.

    For the sparse-error loss these are the ones with an error E that is not 0.
    """
    outliers: NDArray[np.bool_]
    if problem.loss is Loss.ABSOLUTE:
        outliers = np.any(
            np.abs(solution.errors) * problem.weights[:, None, :] > problem.beta, axis=1
        )
        return outliers
    if problem.loss is Loss.SPARSE_ERROR:
        outliers = np.any(solution.errors != 0, axis=1)
        return outliers
    return None
