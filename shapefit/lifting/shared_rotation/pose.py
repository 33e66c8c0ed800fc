"""Local fits with one rotation shared by all atoms.

The pose of a known shape, such as the mean shape of a dictionary; alternating minimisation over
rotation and coefficients; and the nearest transforms that share one rotation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.convex.solver import Status, read_statuses
from shapefit.convex.transforms import Transforms
from shapefit.geometry.rotations import rotation_about
from shapefit.lifting.methods import AlternationOptions

VIEWS = 6
"""Views, spread evenly, from which the pose of the mean shape is sought."""

GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True)
class Pose:
    """W ~ size Rbar S + T 1^T for n images: rotation (n, 3, 3), size (n,) >= 0.

    The rotation is nan where no size > 0 fits better than 0, as without visible landmarks.
    """

    rotation: Floats
    size: Floats


def even_views(count: int) -> Floats:
    """Rotations (count, 3, 3) whose optical axes are spread evenly; the first is the identity.

    The axes lie on a golden spiral about the first, each reached by the shortest turn.
    """
    height = 1 - 2 * np.arange(count) / count
    angle = GOLDEN_ANGLE * np.arange(count)
    axes = np.stack([-np.sin(angle), np.cos(angle), np.zeros(count)], axis=1)
    turns = np.arccos(height)
    return np.concatenate(
        [rotation_about(axis, turn) for axis, turn in zip(axes, turns[:, None], strict=True)]
    )


def turn_in_plane(views: Floats, landmarks_by_shape: Floats) -> Floats:
    """Turn each view about its optical axis so that <D, Rbar> is largest: (n, v, 3, 3).

    views (v, 3, 3); landmarks_by_shape D = w S^T (n, 2, 3). What it finds is the best rotation
    for that optical axis, at any scale.
    """
    D, R = landmarks_by_shape[:, None], views  # rows of D beside those of every R
    sine = (D[:, :, 1] * R[:, 0]).sum(axis=-1) - (D[:, :, 0] * R[:, 1]).sum(axis=-1)
    cosine = (D[:, :, :2] * R[:, :2]).sum(axis=-1).sum(axis=-1)
    length = np.hypot(sine, cosine)
    known = length > 0
    s = np.divide(sine, length, out=np.zeros_like(length), where=known)[..., None]
    c = np.divide(cosine, length, out=np.ones_like(length), where=known)[..., None]
    third = np.broadcast_to(R[:, 2], (len(D), *R[:, 2].shape))
    return np.stack([c * R[:, 0] - s * R[:, 1], s * R[:, 0] + c * R[:, 1], third], axis=2)


def find_moments(problem: Problem, shape: Floats) -> tuple[Floats, Floats]:
    """S Omega^2 S^T (n, 3, 3) and W Omega^2 S^T (n, 2, 3) about the weighted means.

    They are all that a pose depends on; shape S (3, p). Zero for an image without landmarks.
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
    problem: Problem, shape: Floats, views: Floats | None = None, *, threads: int = 0
) -> Pose:
    """argmin ||Omega o (W - s Rbar S - T 1^T)||_F^2 over rotations, s >= 0 and T.

    shape S (3, p); views (v, 3, 3), None for VIEWS of them. Each is turned in the plane as far as
    it can be, and a trust region starts from there; the best local minimum counts.
    """
    P, D = find_moments(problem, shape)
    rotation, size = np.full((len(P), 3, 3), np.nan), np.zeros(len(P))
    starts = turn_in_plane(even_views(VIEWS) if views is None else views, D)
    core.find_pose(
        shape_moments=P,
        landmarks_by_shape=D,
        starts=starts,
        rotation=rotation,
        size=size,
        threads=threads,
    )
    rotation[size == 0] = np.nan
    return Pose(rotation, size)


@dataclass(frozen=True)
class Alternation:
    """Local minima for n images: S = R sum_i c_i B_i.

    coefficients c (n, k); rotation R (n, 3, 3), nan where c = 0, for it is unknown then; rounds
    (n,), over all starts of an image; status, a Status per image.
    """

    coefficients: Floats
    rotation: Floats
    rounds: NDArray[np.int64]
    status: tuple[Status, ...]


def alternate(
    problem: Problem,
    starts: Floats,
    *,
    signed: bool = AlternationOptions.signed,
    tolerance: float = AlternationOptions.tolerance,
    max_rounds: int = AlternationOptions.max_rounds,
    threads: int = 0,
) -> Alternation:
    """min 1/2 ||Omega o (W - Rbar sum_i c_i B_i - T 1^T)||_F^2 + lambda ||c||_1, Rbar Rbar^T = I.

    (Paper, eq. originalnoisy, with weights and translation.) Each round minimises over c >= 0
    (any c where `signed`), exactly, and over T with it; then takes Rbar to a local minimum by
    trust region steps. Neither raises the objective. It stops when a round lowers it by at most
    `tolerance` of itself. starts (n, s, 3, 3) are the rotations to begin at: the best result of
    an image counts. Fewer than two visible landmarks are DEGENERATE.
    """
    problem.require_squared("alternation")
    n, k = len(problem.landmarks), len(problem.atoms)
    if starts.shape[1] == 0:
        raise ValueError("alternation needs starts")
    coefficients, rotation = np.zeros((n, k)), np.full((n, 3, 3), np.nan)
    rounds, codes = np.zeros(n, np.int64), np.zeros(n, np.int64)
    core.alternate(
        **problem.arrays,
        starts=np.ascontiguousarray(starts, dtype=np.float64),
        is_signed=signed,
        tolerance=tolerance,
        most_rounds=max_rounds,
        coefficients=coefficients,
        rotation=rotation,
        rounds=rounds,
        status=codes,
        threads=threads,
    )
    rotation[~coefficients.any(axis=1)] = np.nan
    status = read_statuses(codes)
    return Alternation(coefficients, rotation, rounds, status)


def synchronise(M: Transforms, *, threads: int = 0) -> Floats:
    """argmin_Rbar min_{c >= 0} sum_i ||M_i - c_i Rbar||_F^2 over Rbar Rbar^T = I_2, for n images.

    The rotations (n, 3, 3), nan where all M_i are 0: the projection on the deformable Stiefel
    manifold. For a given Rbar c_i = max(0, <M_i, Rbar>) / 2, which leaves the maximum of
    sum_i max(0, <M_i, Rbar>)^2: a monotone iteration climbs from the polar factors of sum_i M_i
    and of the largest M_i, and the best of them counts. That need not be the global maximum, but
    is where the M_i share a rotation already.
    """
    rotation = np.full((len(M.count), 3, 3), np.nan)
    core.synchronise(**M.arrays, rotation=rotation, threads=threads)
    return rotation
