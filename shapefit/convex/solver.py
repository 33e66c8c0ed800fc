"""Solve the convex program for many images, each with its status and certificate."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit import core, log
from shapefit.arrays import Floats
from shapefit.convex.problem import Loss, Problem
from shapefit.convex.span import find_span, reduce_images
from shapefit.convex.transforms import Transforms

LOGGER = "convex.solver"
"""What is logged of the solver, below `shapefit`."""


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


def decode_statuses(codes: NDArray[np.int64]) -> tuple[Status, ...]:
    """Return the `Status` of each code (n,) of a C++ kernel, its index in `Status`."""
    return tuple(map(tuple(Status).__getitem__, codes.tolist()))


class Solution(NamedTuple):
    """Optimum of the convex program for n images.

    transforms M; translation T (n, 2); dual Y (n, 2, p), feasible up to scaling; errors
    E (n, 2, p), the sparse errors of a robust loss in the units of the landmarks, else
    zero; objective and relative_gap (n,), computed from scratch at the end; iterations
    (n,); status, a Status per image. The residual (n,) is ||Omega o (W - sum M_i B_i -
    T 1^T)||_F / ||Omega o (W - mean)||_F.
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
    """Solve every image to a relative duality gap <= tolerance by Newton's method.

    `threads` = 0 means all cores. For the EXACT loss the relative residual ||W - sum
    M_i B_i|| / ||W|| must fall below the tolerance too, and the gap is nan where it
    does not. An image with fewer than two visible landmarks is DEGENERATE. The method,
    of semismooth Newton steps, is written down in shapefit/core/convex/newton.hpp.
    Large shapes are solved in the span of the atoms, see `span`.
    """
    solve = partial(
        solve_directly,
        tolerance=tolerance,
        max_iterations=max_iterations,
        threads=threads,
    )
    span = find_span(problem)
    if span is None:
        solution = solve(problem)
    else:
        solution = solve_in_span(problem, span, solve, threads)
    log_solution(solution)
    if log.is_heard(LOGGER, log.TRACE):
        log_trace(problem, tolerance, int(solution.iterations.max(initial=0)))
    return solution


def log_solution(solution: Solution) -> None:
    """Log how many iterations the images took, and their largest relative gap."""
    if not log.is_heard(LOGGER) or not len(solution.iterations):
        return
    log.debug(
        LOGGER,
        "%d images, %.1f iterations each, at most %d; largest relative gap %.1e",
        len(solution.iterations),
        solution.iterations.mean(),
        solution.iterations.max(),
        np.nanmax(solution.relative_gap, initial=0.0),
    )


def log_trace(problem: Problem, tolerance: float, iterations: int) -> None:
    """Log objective and relative gap after each iteration of each image.

    The program is solved again with one iteration, with two, and so on: the solver is
    deterministic, and pays nothing for a trace that nobody asks for.
    """
    for limit in range(1, iterations + 1):
        stopped = solve_directly(
            problem, tolerance=tolerance, max_iterations=limit, threads=1
        )
        both = zip(stopped.objective, stopped.relative_gap, strict=True)
        for image, (objective, gap) in enumerate(both):
            log.trace(
                LOGGER,
                "image %d, iteration %d: objective %.9g, relative gap %.1e",
                image,
                limit,
                objective,
                gap,
            )


def solve_directly(
    problem: Problem, *, tolerance: float, max_iterations: int, threads: int
) -> Solution:
    """Solve every image by Newton's method with all landmarks, not in the atoms' span.

    As `solve_newton`, whose parameters these are.
    """
    n, _, p = problem.landmarks.shape
    k = len(problem.atoms)
    first, count, steps, codes = np.zeros((4, n), np.int64)
    atom = np.empty(n * k, np.int64)
    blocks = np.empty((n * k, 2, 3))
    translation = np.zeros((n, 2))
    dual = np.zeros((n, 2, p))
    errors = np.zeros((n, 2, 0 if problem.loss is Loss.SQUARED else p))
    objective, gap, residual = np.zeros((3, n))
    core.solve_convex(
        **problem.arrays,
        delta=float(problem.loss.has_quadratic),
        bound=problem.max_dual_entry,
        begins=problem.begins,
        tolerance=tolerance,
        max_steps=max_iterations,
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
    transforms = Transforms.gather(first, count, atom, blocks, k)
    status = decode_statuses(codes)
    return Solution(
        transforms, translation, dual, errors, objective, gap, residual, steps, status
    )


def solve_in_span(
    problem: Problem,
    span: Floats,
    solve: Callable[[Problem], Solution],
    threads: int,
) -> Solution:
    """Solve images reduced to the span (p, r) of the atoms, and certify the solutions.

    The part of the landmarks that the atoms do not span joins the objective, never the
    gap's numerator: a reduction that is solved to the tolerance solves the problem to
    it.
    """
    n, _, p = problem.landmarks.shape
    dual = np.zeros((n, 2, p))
    rows, transforms_of_parts, steps_of_parts = [], [], []
    statuses: list[Status] = []
    for part in reduce_images(problem, span):
        solution = solve(part.problem)
        dual[part.rows] = part.expand(solution.dual, problem)
        rows.append(part.rows)
        transforms_of_parts.append(solution.transforms)
        statuses.extend(solution.status)
        steps_of_parts.append(solution.iterations)
    in_order = np.argsort(np.concatenate(rows))
    transforms = Transforms.concatenate(transforms_of_parts).take(in_order)
    status = np.array(statuses)[in_order]
    steps = np.concatenate(steps_of_parts)[in_order]
    translation = np.zeros((n, 2))
    objective, gap, residual = np.full((3, n), np.nan)
    core.certify(
        **problem.arrays,
        **transforms.arrays,
        delta=1.0,
        bound=problem.max_dual_entry,
        translation=translation,
        dual=dual,
        errors=np.zeros((n, 2, 0)),
        objective=objective,
        relative_gap=gap,
        residual=residual,
        threads=threads,
    )
    for measure in (objective, gap, residual):
        measure[status == Status.DEGENERATE] = np.nan
    return Solution(
        transforms,
        translation,
        dual,
        np.broadcast_to(0.0, dual.shape),
        objective,
        gap,
        residual,
        steps,
        tuple(status),
    )


def find_outliers(problem: Problem, solution: Solution) -> NDArray[np.bool_] | None:
    """Return which landmarks (n, p) a robust loss found to be outliers, else None.

    Landmarks whose weighted residual is beyond beta in a coordinate; for the
    sparse-error loss, those with an error E that is not 0.
    """
    outliers: NDArray[np.bool_]
    if problem.loss is Loss.ABSOLUTE:
        residuals = np.abs(solution.errors) * problem.weights[:, None, :]
        beyond: NDArray[np.bool_] = np.any(residuals > problem.beta, axis=1)
        return beyond
    if problem.loss is Loss.SPARSE_ERROR:
        outliers = np.any(solution.errors != 0, axis=1)
        return outliers
    return None
