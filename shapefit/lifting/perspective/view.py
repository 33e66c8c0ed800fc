"""Refine what was lifted by weak perspective under the full projection of a known camera.

The refinement starts from where another method left the shape, placed in depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.convex.solver import Status, read_statuses
from shapefit.convex.transforms import Transforms
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.pinhole import Camera, project
from shapefit.lifting.estimate import Estimate, fit_translation
from shapefit.lifting.lift import Lifting, PerspectiveView
from shapefit.lifting.methods import DEFAULT_VIEWS
from shapefit.lifting.reconstruction import combine, is_active
from shapefit.lifting.shared_rotation.pose import find_pose, spread_views

Rows = NDArray[np.intp]

REASONS = {
    Status.DEGENERATE: "landmarks start behind the camera: with so short a focal length it would "
    "be inside the object; give `camera.focal` or `camera.intrinsics` in the unit of the "
    "landmarks",
    Status.NUMERICAL_FAILURE: "numerical failure in the refinement under perspective",
}
"""Why a refinement has no result."""


@dataclass(frozen=True, kw_only=True)
class PerspectiveOptions:
    """The options of `refine_perspective`; softness and ridge are in normalised units."""

    ridge: float = 0.3
    softness: float = 0.1
    max_rounds: int = 1000
    threads: int = 0


def refine_view(
    lifting: Lifting,
    landmarks: Floats,
    camera: Camera,
    dictionary: Dictionary,
    options: PerspectiveOptions,
    *,
    views: int = DEFAULT_VIEWS,
) -> Lifting:
    """Refine rotation, translation and coefficients of n images under the full projection.

    landmarks (n, 2, p) and camera in the unit of the images. Landmarks of weight 0 in the problem
    stay left out; what a robust loss labelled is seen, for labels are at their worst where the
    pose is off, and the softness forgives them. Images without a shape stay without. It starts
    from the rotation of the estimate, or where that has none from the mean shape, posed from so
    many views. Shapes keep the unit of the landmarks, at the size that the object's origin has in
    the image: scale = focal / depth there, the geometric mean of both axes.
    """
    rows = np.flatnonzero(np.isfinite(lifting.scale))
    old, whole = lifting.estimate, lifting.problem
    norm = normalise(landmarks[rows], whole.weights[rows] > 0)
    part = Problem(norm.points, whole.weights[rows], dictionary.atoms, whole.lam[rows])
    visible = camera.take(rows)
    nearby = visible.normalised_as(norm)
    found = refine_perspective(
        part.landmarks,
        part.weights,
        part.atoms,
        nearby,
        find_rotations(old.rotation[rows], part, dictionary.mean_shape, views, options.threads),
        mean_coefficients(dictionary.atoms, dictionary.mean_shape),
        options,
    )
    n = len(landmarks)
    c, R, t = found.coefficients, found.rotation, found.translation
    S = combine(c, dictionary.atoms, R)
    depth = camera.sign * t[:, 2]
    scale = np.sqrt(visible.focal.prod(axis=1)) / depth
    origin = visible.centre + visible.focal * t[:, :2] / depth[:, None]
    shapes = scale[:, None, None] * S
    shapes[:, :2] += origin[..., None]
    projected = project(nearby, S + t[..., None])
    pixels = norm.scale[:, None, None] * projected + norm.centroid[..., None]
    # what is hidden may lie behind the camera, and counts for nothing
    shown = np.where(part.weights[:, None] > 0, projected, 0.0)
    residual = fit_translation(part, shown, np.zeros((len(rows), 2))).residual

    def spread(values: Floats, rest: float = np.nan) -> Floats:
        """Put values of the refined images in their rows."""
        every = np.full((n, *values.shape[1:]), rest)
        every[rows] = values
        return every

    iterations = old.iterations.copy()
    iterations[rows] += found.rounds
    estimate = replace(
        old,
        shapes=spread(S),
        translation=spread((origin - norm.centroid) / norm.scale[:, None]),
        rotation=spread(R),
        objective=spread(found.objective),
        residual=spread(residual),
        iterations=iterations,
        status=merge_status(old, found.status, rows),
        coefficients=spread(c, 0.0),
        active_atoms=is_active(spread(c, 0.0)).sum(axis=1),
        transforms=Transforms.with_one_rotation(spread(c, 0.0), spread(R)),
        relative_gap=None,
        tight=None,
    )
    reasons = {
        row: REASONS[status]
        for row, status in zip(rows.tolist(), found.status, strict=True)
        if status in REASONS
    }
    return Lifting(
        shapes=spread(shapes),
        landmarks_fitted=spread(pixels),
        translation=spread(origin),
        scale=spread(scale),
        problem=whole,
        estimate=estimate,
        failures={**lifting.failures, **reasons},
        perspective=PerspectiveView(spread(t), camera),
    )


def find_rotations(
    known: Floats, problem: Problem, mean_shape: Floats, views: int, threads: int
) -> Floats:
    """Rotations (m, 3, 3) as known; where they are nan, those of the posed mean shape (3, p)."""
    unknown = np.flatnonzero(~np.isfinite(known).all(axis=(1, 2)))
    if not len(unknown):
        return known
    pose = find_pose(problem.take(unknown), mean_shape, spread_views(views), threads=threads)
    posed = pose.size > 0
    R = known.copy()
    R[unknown] = np.where(posed[:, None, None], pose.rotation, np.eye(3))
    return R


def merge_status(old: Estimate, refined: Sequence[Status], rows: Rows) -> tuple[Status, ...]:
    """Status of each image: that of its refinement, or, where there was none, its old one."""
    status = list(old.status)
    for row, new in zip(rows.tolist(), refined, strict=True):
        status[row] = new
    return tuple(status)


FAILED = (Status.DEGENERATE, Status.NUMERICAL_FAILURE)
"""How a refinement without a result ends."""


@dataclass(frozen=True)
class Refined:
    """Stationary points for n images: X = R sum_i c_i B_i + t.

    rotation R (n, 3, 3); translation t (n, 3); coefficients c (n, k) >= 0; objective (n,);
    rounds (n,); status, a Status per image. nan where it is DEGENERATE, which means that a landmark
    begins behind the camera, or NUMERICAL_FAILURE.
    """

    rotation: Floats
    translation: Floats
    coefficients: Floats
    objective: Floats
    rounds: NDArray[np.int64]
    status: tuple[Status, ...]


def refine_perspective(
    landmarks: Floats,
    weights: Floats,
    atoms: Floats,
    camera: Camera,
    rotation: Floats,
    prior: Floats,
    options: PerspectiveOptions,
) -> Refined:
    """min over R, t, c >= 0 of sum_j s^2/2 log(1 + |r_j|^2 / s^2) + ridge/2 |c - prior|^2.

    s is the softness of the options, with ridge and the maximum rounds per image.
    r_j = Omega_j (w_j - projection of column j of R sum_i c_i B_i + t), in normalised units:
    landmarks w (n, 2, p), weights Omega (n, p), atoms B (k, 3, p), camera in the unit of w. It
    starts from the rotations R (n, 3, 3), c = prior (k,), and t where weak perspective puts it.
    A shape twice as large at twice the depth looks the same, so the size is fixed:
    prior^T c = prior^T prior. The result is a local minimum; no certificate bounds it.
    """
    n = len(landmarks)
    R = np.array(rotation, np.float64)
    c = np.tile(np.asarray(prior, np.float64), (n, 1))
    t = place_in_depth(landmarks, weights, np.tensordot(prior, atoms, axes=1), camera, R)
    objective, rounds, codes = np.full(n, np.nan), np.zeros(n, np.int64), np.zeros(n, np.int64)
    core.refine_perspective(
        landmarks=np.ascontiguousarray(landmarks, np.float64),
        weights=np.ascontiguousarray(weights, np.float64),
        atoms=np.ascontiguousarray(atoms, np.float64),
        prior=np.ascontiguousarray(prior, np.float64),
        focal=np.ascontiguousarray(camera.focal, np.float64),
        centre=np.ascontiguousarray(camera.centre, np.float64),
        sign=camera.sign,
        ridge=options.ridge,
        softness=options.softness,
        max_rounds=options.max_rounds,
        rotation=R,
        translation=t,
        coefficients=c,
        objective=objective,
        rounds=rounds,
        status=codes,
        threads=options.threads,
    )
    failed = np.isin(codes, [list(Status).index(status) for status in FAILED])
    R[failed], t[failed], c[failed] = np.nan, np.nan, np.nan
    return Refined(R, t, c, objective, rounds, read_statuses(codes))


def place_in_depth(
    landmarks: Floats, weights: Floats, shape: Floats, camera: Camera, rotation: Floats
) -> Floats:
    """t (n, 3) at which R S, seen by weak perspective, has the size and place of the landmarks.

    The depth is that of the visible landmarks' middle; S (3, p), the rest as above.
    """
    omega = np.where(weights > 0, weights, 0.0) ** 2
    share = omega / omega.sum(axis=1, keepdims=True)
    X = rotation @ shape
    W = np.where(weights[:, None] > 0, landmarks, 0.0)
    middle, visible = np.einsum("nap,np->na", X, share), np.einsum("nap,np->na", W, share)
    rays = (W - camera.centre[..., None]) / camera.focal[..., None]
    ray = (visible - camera.centre) / camera.focal
    flat = X[:, :2] - middle[:, :2, None]
    spread = np.einsum("nap,nap,np->n", flat, flat, share)
    overlap = np.einsum("nap,nap,np->n", flat, rays - ray[..., None], share)
    # a rotation that fits not at all must not put the shape at infinity
    least = 0.1 * np.sqrt(
        spread * np.einsum("nap,nap,np->n", *(2 * (rays - ray[..., None],)), share)
    )
    with np.errstate(divide="ignore", invalid="ignore"):  # landmarks that are all in one place
        depth = spread / np.maximum(overlap, least)
    t = np.empty((len(W), 3))
    t[:, :2] = ray * depth[:, None] - middle[:, :2]
    t[:, 2] = camera.sign * depth - middle[:, 2]
    return t


def mean_coefficients(atoms: Floats, mean_shape: Floats) -> Floats:
    """argmin_{c >= 0} |sum_i c_i B_i - mean_shape|^2 + a little |c|^2: (k,).

    For exemplars all are alike, 1/k over the spread of their mean.
    """
    k = len(atoms)
    A = atoms.reshape(k, -1).T
    little = 1e-3 * np.linalg.norm(A, axis=0).max()
    c = np.zeros((1, k))
    core.code(
        gram=A.T @ A + little**2 * np.eye(k),
        pulls=np.reshape(mean_shape.ravel() @ A, (1, k)),
        smallest_moves=np.array([1e-12 * np.linalg.norm(mean_shape)]),
        coefficients=c,
        unsettled=np.zeros(1, dtype=bool),
        threads=1,
    )
    return c[0]
