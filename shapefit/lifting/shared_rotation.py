"""The methods whose atoms share one rotation, and the pose of the mean shape."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats, Integers
from shapefit.convex.problem import Loss, Problem
from shapefit.convex.solver import Status, decode_statuses, find_outliers
from shapefit.convex.transforms import Transforms
from shapefit.geometry.rotations import rotation_about
from shapefit.lifting.degeneracy import find_degenerate
from shapefit.lifting.estimate import (
    AtomEstimate,
    ConvexProof,
    Solve,
    fit_translation,
    join_images,
)
from shapefit.lifting.methods import STARTS
from shapefit.lifting.reconstruction import combine, is_active

FAILURES = (Status.DEGENERATE, Status.NUMERICAL_FAILURE)
"""Ends of the convex program after which there is nothing to refine."""

GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
"""Radians between neighbours on a spiral that covers a sphere evenly."""


def refine_convex(
    problem: Problem,
    *,
    solve: Solve,
    mean_shape: Floats,
    signed: bool = False,
    threads: int = 0,
) -> AtomEstimate:
    """Refine the solution of the convex program to one rotation shared by all atoms.

    The rotation nearest to those of the solution (`synchronise`) is where alternation
    starts. Over c >= 0, or, where `signed`, over all c (paper, Experiments,
    "Alternate+"). The convex optimum bounds the objective from below, for c_i Rbar is a
    transform of spectral norm |c_i|, and the gap is that to its dual. With a robust
    loss the robust program finds the outliers, and the squared residuals of the other
    landmarks are refined, which it does not bound.
    """
    solution = solve(problem)
    starts = synchronise(solution.transforms, threads=threads)[:, None]
    alternate_from = partial(
        _alternate_or_restart,
        starts=starts,
        mean_shape=mean_shape,
        signed=signed,
        threads=threads,
    )
    outliers = find_outliers(problem, solution)
    if outliers is None:
        refined = alternate_from(problem)
        bound = solution.objective * (1 - solution.relative_gap)
        refined = replace(refined, relative_gap=_gap_to(bound, refined.objective))
    else:
        outliers = _removable_outliers(problem, outliers)
        inliers = _without_outliers(problem, outliers)
        refined = replace(alternate_from(inliers), outliers=outliers)
    return replace(
        refined,
        status=_join_statuses(solution.status, refined.status),
        iterations=solution.iterations + refined.iterations,
        convex_proof=ConvexProof.of(solution),
    )


def _gap_to(bound: Floats, objective: Floats) -> Floats:
    """Return (objective - bound) / objective (n,), 0 where the objective is 0."""
    gap = np.zeros_like(objective)
    np.divide(objective - bound, objective, out=gap, where=objective != 0)
    return gap


def _removable_outliers(
    problem: Problem, outliers: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return the outliers (n, p), none of images that would be degenerate without them.

    Such images are refined with all their landmarks.
    """
    weights = np.where(outliers, 0.0, problem.weights)
    removable = outliers.copy()
    removable[list(find_degenerate(problem.landmarks, weights))] = False
    return removable


def _without_outliers(problem: Problem, outliers: NDArray[np.bool_]) -> Problem:
    """Return the problem of the squared loss, in which outliers (n, p) weigh 0."""
    weights = np.where(outliers, 0.0, problem.weights)
    return replace(problem, weights=weights, loss=Loss.SQUARED)


def _join_statuses(
    solved: tuple[Status, ...], refined: tuple[Status, ...]
) -> tuple[Status, ...]:
    """Return each image's status: as refined, unless its solution failed before."""
    # rare, and slow to ask of every image
    if not any(failure in solved for failure in FAILURES):
        return refined
    both = zip(solved, refined, strict=True)
    return tuple(first if first in FAILURES else second for first, second in both)


def alternate_from_mean(
    problem: Problem,
    *,
    mean_shape: Floats,
    starts: int = STARTS,
    signed: bool = False,
    threads: int = 0,
) -> AtomEstimate:
    """Fit shape and rotation alternately, from the pose of the mean shape.

    Over c >= 0, or, where `signed`, over all c (paper, Experiments, "Alternate"). The
    paper has one start; with more, the pose that fits best is the one to begin at.
    """
    pose = find_pose(problem, mean_shape, starts, threads=threads)
    return _alternate(problem, pose.rotation[:, None], signed=signed, threads=threads)


def pose_mean_shape(
    problem: Problem, *, mean_shape: Floats, starts: int = STARTS, threads: int = 0
) -> AtomEstimate:
    """Pose the mean shape: rotation, scale and translation and nothing else."""
    pose = find_pose(problem, mean_shape, starts, threads=threads)
    is_posed = pose.size > 0
    R = np.where(is_posed[:, None, None], pose.rotation, 0.0)
    shapes = pose.size[:, None, None] * (R @ mean_shape)
    placement = fit_translation(problem, shapes)
    return AtomEstimate(
        shapes=shapes,
        translation=placement.translation,
        rotation=pose.rotation,
        objective=placement.half_squared_residual,
        residual=placement.residual,
        iterations=np.zeros(len(shapes), np.int64),
        status=tuple(
            Status.CONVERGED if fine else Status.DEGENERATE
            for fine in is_posed.tolist()
        ),
    )


def _alternate_or_restart(
    problem: Problem,
    starts: Floats,
    mean_shape: Floats,
    *,
    signed: bool,
    threads: int,
) -> AtomEstimate:
    """Fit shape and rotation alternately from `starts`, else from the mean's pose.

    That is where no atom fits from `starts`: without coefficients there is no rotation
    to go on from, though another one may fit.
    """
    first = _alternate(problem, starts, signed=signed, threads=threads)
    assert first.coefficients is not None
    empty = np.flatnonzero(~first.coefficients.any(axis=1))
    if not len(empty):
        return first
    part = problem.take(empty)
    pose = find_pose(part, mean_shape, threads=threads)
    is_posed = pose.size > 0  # degenerate images have no pose
    rotation = pose.rotation[is_posed, None]
    again = _alternate(part.take(is_posed), rotation, signed=signed, threads=threads)
    rows = empty[is_posed]
    again = replace(again, iterations=first.iterations[rows] + again.iterations)
    order = np.arange(len(problem.lam))
    order[rows] = len(order) + np.arange(len(rows))
    joined: AtomEstimate = join_images([first, again], order)
    return joined


def _alternate(
    problem: Problem, starts: Floats, *, signed: bool, threads: int
) -> AtomEstimate:
    """Fit shape and rotation alternately from the rotations `starts` (n, s, 3, 3)."""
    end = alternate(problem, starts, signed=signed, threads=threads)
    return describe_shapes(
        problem,
        end.coefficients,
        end.rotation,
        iterations=end.rounds,
        status=end.status,
    )


def describe_shapes(
    problem: Problem,
    coefficients: Floats,
    rotation: Floats,
    *,
    iterations: Integers,
    status: tuple[Status, ...],
) -> AtomEstimate:
    """Return the estimate of shapes S = R sum_i c_i B_i, c (n, k) and R (n, 3, 3).

    nan rotations stand for no shape.
    """
    R = np.where(np.isfinite(rotation), rotation, 0.0)
    shapes = combine(coefficients, problem.atoms, R)
    placement = fit_translation(problem, shapes)
    penalty = problem.lam * np.abs(coefficients).sum(axis=1)
    return AtomEstimate(
        shapes=shapes,
        translation=placement.translation,
        rotation=rotation,
        objective=placement.half_squared_residual + penalty,
        residual=placement.residual,
        iterations=iterations,
        status=status,
        coefficients=coefficients,
        active_atoms=is_active(coefficients).sum(axis=1),
        transforms=Transforms.with_one_rotation(coefficients, R),
    )


class Pose(NamedTuple):
    """The best rotation (n, 3, 3) and size (n,) >= 0 of one shape in n images.

    W ~ size Rbar S + T 1^T. The rotation is nan where no size > 0 fits better than 0,
    as without visible landmarks.
    """

    rotation: Floats
    size: Floats


def even_views(count: int) -> Floats:
    """Return rotations (count, 3, 3) whose optical axes are spread evenly.

    The first is the identity. The axes lie on a golden spiral about the first, each
    reached by the shortest turn.
    """
    height = 1 - 2 * np.arange(count) / count
    angle = GOLDEN_ANGLE * np.arange(count)
    axes = np.stack([-np.sin(angle), np.cos(angle), np.zeros(count)], axis=1)
    turns = np.arccos(height)[:, None]
    views = [rotation_about(axis, turn) for axis, turn in zip(axes, turns, strict=True)]
    return np.concatenate(views)


def turn_in_plane(views: Floats, landmarks_by_shape: Floats) -> Floats:
    """Turn each view in the image plane to where a shape fits the landmarks best.

    Returns rotations (n, v, 3, 3) of largest <D, Rbar>. views (v, 3, 3);
    landmarks_by_shape D = w S^T (n, 2, 3).
    """
    D = landmarks_by_shape[:, None]  # its rows beside those of every view
    x = views[:, 0]
    y = views[:, 1]
    z = views[:, 2]
    sine = (D[:, :, 1] * x).sum(axis=-1) - (D[:, :, 0] * y).sum(axis=-1)
    cosine = (D[:, :, :2] * views[:, :2]).sum(axis=-1).sum(axis=-1)
    length = np.hypot(sine, cosine)
    is_defined = length > 0
    s = np.zeros_like(length)
    np.divide(sine, length, out=s, where=is_defined)
    c = np.ones_like(length)
    np.divide(cosine, length, out=c, where=is_defined)
    turned_x = c[..., None] * x - s[..., None] * y
    turned_y = s[..., None] * x + c[..., None] * y
    return np.stack([turned_x, turned_y, np.broadcast_to(z, turned_x.shape)], axis=2)


def find_moments(problem: Problem, shape: Floats) -> tuple[Floats, Floats]:
    """Return weighted moments S S^T (n, 3, 3) and W S^T (n, 2, 3) of shape, landmarks.

    S Omega^2 S^T and W Omega^2 S^T about the weighted means, all that a pose depends
    on; shape S (3, p). Zero for an image without landmarks.
    """
    squares = problem.weights[:, None] ** 2
    total = squares.sum(axis=-1)
    mean = (squares * shape).sum(axis=-1) / np.where(total > 0, total, 1.0)
    x = shape - mean[..., None]
    weighted = (squares * x)[:, None]
    P = (x[:, :, None] * weighted).sum(axis=-1)
    D = (problem.landmarks[:, :, None] * weighted).sum(axis=-1)
    return P, D


def find_pose(
    problem: Problem, shape: Floats, starts: int = STARTS, *, threads: int = 0
) -> Pose:
    """Return the pose in which a shape (3, p) fits the landmarks of each image best.

    argmin ||Omega o (W - s Rbar S - T 1^T)||_F^2 over rotations, s >= 0 and T; shape S
    (3, p). Trust regions start from so many even views, of which the first is the
    identity. Each is turned in the plane to where it correlates best, and the best
    local minimum counts.
    """
    P, D = find_moments(problem, shape)
    rotation = np.full((len(P), 3, 3), np.nan)
    size = np.zeros(len(P))
    views = turn_in_plane(even_views(starts), D)
    core.find_pose(
        shape_moments=P,
        landmarks_by_shape=D,
        starts=views,
        rotation=rotation,
        size=size,
        threads=threads,
    )
    rotation[size == 0] = np.nan
    return Pose(rotation, size)


class Alternation(NamedTuple):
    """What alternation finds of n images: local minima S = R sum_i c_i B_i.

    coefficients c (n, k); rotation R (n, 3, 3), nan where c = 0, for it is unknown
    then; rounds (n,), over all starts of an image; status, a Status per image.
    """

    coefficients: Floats
    rotation: Floats
    rounds: NDArray[np.int64]
    status: tuple[Status, ...]


def alternate(
    problem: Problem,
    starts: Floats,
    *,
    signed: bool = False,
    tolerance: float = 1e-6,
    max_rounds: int = 500,
    threads: int = 0,
) -> Alternation:
    """Fit coefficients and one rotation alternately from given rotations: local minima.

    min 1/2 ||Omega o (W - Rbar sum_i c_i B_i - T 1^T)||_F^2 + lambda ||c||_1 over Rbar
    Rbar^T = I (paper, eq. originalnoisy, with weights and translation). Each round
    minimises over c >= 0 (any c where `signed`), exactly, and over T with it; then
    takes Rbar to a local minimum by trust region steps. Neither raises the objective.
    It stops when a round lowers it by at most the tolerance. starts (n, s, 3, 3) are
    the rotations to begin at: the best result of an image counts. Fewer than two
    visible landmarks are DEGENERATE. Raises ValueError for a loss other than the
    squared one.
    """
    problem.require_squared("alternation")
    n = len(problem.landmarks)
    coefficients = np.zeros((n, len(problem.atoms)))
    rotation = np.full((n, 3, 3), np.nan)
    rounds, codes = np.zeros((2, n), np.int64)
    core.alternate(
        **problem.arrays,
        starts=np.ascontiguousarray(starts, dtype=np.float64),
        is_signed=signed,
        tolerance=tolerance,
        max_rounds=max_rounds,
        coefficients=coefficients,
        rotation=rotation,
        rounds=rounds,
        status=codes,
        threads=threads,
    )
    rotation[~coefficients.any(axis=1)] = np.nan
    return Alternation(coefficients, rotation, rounds, decode_statuses(codes))


def synchronise(M: Transforms, *, threads: int = 0) -> Floats:
    """Return the one rotation (n, 3, 3) nearest to all transforms M of each image.

    argmin_Rbar min_{c >= 0} sum_i ||M_i - c_i Rbar||_F^2 over Rbar Rbar^T = I_2, nan
    where all M_i are 0: the projection on the deformable Stiefel manifold. For a given
    Rbar c_i = max(0, <M_i, Rbar>) / 2, which leaves the maximum of sum_i max(0, <M_i,
    Rbar>)^2: a monotone iteration climbs from the polar factors of sum_i M_i and of the
    largest M_i, and the best local maximum counts.
    """
    rotation = np.full((len(M.count), 3, 3), np.nan)
    core.synchronise(**M.arrays, rotation=rotation, threads=threads)
    return rotation
