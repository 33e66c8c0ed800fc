"""The methods whose atoms share one rotation, and the pose of the mean shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.convex.problem import Loss, Problem
from shapefit.convex.solver import Status, find_outliers
from shapefit.convex.transforms import Transforms
from shapefit.lifting.degeneracy import find_degenerate
from shapefit.lifting.estimate import ConvexProof, Estimate, fit_translation, join_images
from shapefit.lifting.methods import Settings
from shapefit.lifting.reconstruction import combine, is_active
from shapefit.lifting.shared_rotation.pose import alternate, find_pose, synchronise


def refine_convex(problem: Problem, settings: Settings) -> Estimate:
    """Synchronise the convex solution to one rotation and alternate from there.

    Over c >= 0, or, where `signed`, over all c (paper, Experiments, "Alternate+"). The convex
    optimum bounds the objective from below, for c_i Rbar is a transform of spectral norm |c_i|, and
    the gap is that to its dual. With a robust loss the robust program finds the outliers, and the
    squared residuals of the other landmarks are refined, which it does not bound; the landmarks
    stay normalised by all that are seen.
    """
    solution = settings.solve(problem)
    starts = synchronise(solution.transforms, threads=settings.threads)[:, None]
    outliers = find_outliers(problem, solution)
    if outliers is None:
        found = _alternate_or_restart(problem, settings, starts)
        objective = found.objective
        bound, gap = solution.objective * (1 - solution.relative_gap), np.zeros_like(objective)
        np.divide(objective - bound, objective, out=gap, where=objective != 0)
        found = replace(found, relative_gap=gap)
    else:
        outliers = believable(problem, outliers)
        weights = np.where(outliers, 0.0, problem.weights)
        inliers = replace(problem, weights=weights, loss=Loss.SQUARED)
        found = replace(_alternate_or_restart(inliers, settings, starts), outliers=outliers)
    failed, status = (Status.DEGENERATE, Status.NUMERICAL_FAILURE), found.status
    if any(each in solution.status for each in failed):  # rare, and slow to ask of each image
        both = zip(solution.status, status, strict=True)
        status = tuple(first if first in failed else second for first, second in both)
    return replace(
        found,
        status=status,
        iterations=solution.iterations + found.iterations,
        convex_proof=ConvexProof.of(solution),
    )


def alternate_from_mean(problem: Problem, settings: Settings) -> Estimate:
    """Alternate from the pose of the mean shape (paper, Experiments, "Alternate")."""
    pose = find_pose(problem, settings.mean_shape, threads=settings.threads)
    return _alternate(problem, settings, pose.rotation[:, None])


def pose_mean_shape(problem: Problem, settings: Settings) -> Estimate:
    """Pose the mean shape: rotation, scale and translation and nothing else."""
    pose = find_pose(problem, settings.mean_shape, threads=settings.threads)
    posed = pose.size > 0
    R = np.where(posed[:, None, None], pose.rotation, 0.0)
    shapes = pose.size[:, None, None] * (R @ settings.mean_shape)
    placed = fit_translation(problem, shapes)
    return Estimate(
        shapes=shapes,
        translation=placed.translation,
        rotation=pose.rotation,
        objective=placed.half_squared_residual,
        residual=placed.residual,
        iterations=np.zeros(len(shapes), np.int64),
        status=tuple(Status.CONVERGED if fine else Status.DEGENERATE for fine in posed.tolist()),
    )


def _alternate_or_restart(problem: Problem, settings: Settings, starts: Floats) -> Estimate:
    """Alternate; where no atom fits at the synchronised rotation, from the mean shape's pose too.

    Without coefficients there is no rotation to go on from, though another one may fit.
    """
    found = _alternate(problem, settings, starts)
    assert found.coefficients is not None
    empty = np.flatnonzero(~found.coefficients.any(axis=1))
    if not len(empty):
        return found
    part = problem.take(empty)
    pose = find_pose(part, settings.mean_shape, threads=settings.threads)
    posed = pose.size > 0  # degenerate images have none
    again = _alternate(part.take(posed), settings, pose.rotation[posed, None])
    rows, order = empty[posed], np.arange(len(problem.lam))
    again = replace(again, iterations=found.iterations[rows] + again.iterations)
    order[rows] = len(order) + np.arange(len(rows))
    joined: Estimate = join_images([found, again], order)
    return joined


def _alternate(problem: Problem, settings: Settings, starts: Floats) -> Estimate:
    """Alternate from starts (n, s, 3, 3) and lay out what it finds."""
    options = settings.options
    found = alternate(
        problem,
        starts,
        signed=options.signed,
        tolerance=options.tolerance,
        max_rounds=options.max_rounds,
        threads=settings.threads,
    )
    return describe(problem, found.coefficients, found.rotation, found.rounds, found.status)


def describe(
    problem: Problem,
    coefficients: Floats,
    rotation: Floats,
    iterations: Integers,
    status: tuple[Status, ...],
) -> Estimate:
    """Lay out shapes S = R sum_i c_i B_i for c (n, k) and R (n, 3, 3), nan where it is unknown."""
    R = np.where(np.isfinite(rotation), rotation, 0.0)
    shapes = combine(coefficients, problem.atoms, R)
    placed = fit_translation(problem, shapes)
    return Estimate(
        shapes=shapes,
        translation=placed.translation,
        rotation=rotation,
        objective=placed.half_squared_residual + problem.lam * np.abs(coefficients).sum(axis=1),
        residual=placed.residual,
        iterations=iterations,
        status=status,
        coefficients=coefficients,
        active_atoms=is_active(coefficients).sum(axis=1),
        transforms=Transforms.with_one_rotation(coefficients, R),
    )


def believable(problem: Problem, outliers: NDArray[np.bool_]) -> Flags:
    """Outliers (n, p), but none in an image where the others could not be lifted without them."""
    left = np.where(outliers, 0.0, problem.weights)
    lost = list(find_degenerate(problem.landmarks, left))
    remaining = outliers.copy()
    remaining[lost] = False
    return remaining
