"""Refine what was lifted by weak perspective under the projection of a known camera.

The refinement starts from where another method left the shape, placed in depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.convex.solver import Status, decode_statuses
from shapefit.convex.transforms import Transforms
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.pinhole import Camera, project_pinhole
from shapefit.lifting.estimate import AtomEstimate, fit_translation
from shapefit.lifting.lift import Lifting, PerspectiveView
from shapefit.lifting.reconstruction import combine, is_active
from shapefit.lifting.shared_rotation import find_pose

REFINEMENT_FAILURES = {
    Status.DEGENERATE: (
        "landmarks start behind the camera: with so short a focal length it would be"
        " inside the object; give `camera.focal` and `camera.principal_point` in"
        " the unit of the landmarks"
    ),
    Status.NUMERICAL_FAILURE: "numerical failure in the refinement under perspective",
}
"""Endings of a refinement without a result, and why."""

PRIOR_RIDGE = 0.3
"""Weight of the distance from the prior's coefficients, in normalised units."""

RESIDUAL_SOFTNESS = 0.1
"""Residual beyond which landmarks count ever less, in normalised units."""

MAX_REFINEMENT_ROUNDS = 1000
"""Of an image."""


@dataclass(frozen=True, eq=False)
class RefinedViews:
    """What refinement under perspective finds of n images: stationary points.

    X = R sum_i c_i B_i + t. rotation R (n, 3, 3); translation t (n, 3); coefficients c
    (n, k) >= 0; objective (n,); rounds (n,); status, a Status per image. nan where it
    is DEGENERATE, which means that a landmark begins behind the camera, or
    NUMERICAL_FAILURE.
    """

    rotation: Floats
    translation: Floats
    coefficients: Floats
    objective: Floats
    rounds: NDArray[np.int64]
    status: tuple[Status, ...]


def refine_view(
    lifting: Lifting[AtomEstimate],
    landmarks: Floats,
    camera: Camera,
    dictionary: Dictionary,
    threads: int = 0,
) -> Lifting[AtomEstimate]:
    """Refine rotation, translation and coefficients of a lifting in perspective.

    landmarks (n, 2, p) and camera in the unit of the images. Landmarks of weight 0 in
    the problem stay left out; what a robust loss labelled is seen, for labels are at
    their worst where the pose is off, and the softness forgives them. Images without a
    shape stay without. It starts from the rotation of the estimate, or where that has
    none from the mean shape, posed. Shapes keep the unit of the landmarks, at the size
    that the object's origin has in the image: scale = focal / depth there, the
    geometric mean of both axes.
    """
    rows = np.flatnonzero(np.isfinite(lifting.scale))
    old = lifting.estimate
    whole = lifting.problem
    norm = normalise(landmarks[rows], whole.weights[rows] > 0)
    part = Problem(norm.points, whole.weights[rows], dictionary.atoms, whole.lam[rows])
    in_unit = camera.take(rows)
    nearby = in_unit.normalised_as(norm)
    starts = fill_in_rotations(old.rotation[rows], part, dictionary.mean_shape, threads)
    prior = mean_coefficients(dictionary.atoms, dictionary.mean_shape)
    refined = refine_perspective(
        part.landmarks, part.weights, part.atoms, nearby, starts, prior, threads=threads
    )
    t = refined.translation
    S = combine(refined.coefficients, dictionary.atoms, refined.rotation)
    projected = project_pinhole(nearby, S + t[..., None])
    # what is hidden may lie behind the camera, and counts for nothing
    shown = np.where(part.weights[:, None] > 0, projected, 0.0)
    residual = fit_translation(part, shown, np.zeros((len(rows), 2))).residual
    depth = camera.sign * t[:, 2]
    scale = np.sqrt(in_unit.focal.prod(axis=1)) / depth
    origin = in_unit.centre + in_unit.focal * t[:, :2] / depth[:, None]
    shapes = scale[:, None, None] * S
    shapes[:, :2] += origin[..., None]
    fitted = norm.scale[:, None, None] * projected + norm.centroid[..., None]

    def at_all_images(values: Floats, rest: float = np.nan) -> Floats:
        """Return the values (r, ...) at the r refined images, `rest` at the others."""
        every = np.full((len(landmarks), *values.shape[1:]), rest)
        every[rows] = values
        return every

    iterations = old.iterations.copy()
    iterations[rows] += refined.rounds
    status = list(old.status)
    failures = dict(lifting.failures)
    for row, ending in zip(rows.tolist(), refined.status, strict=True):
        status[row] = ending
        if ending in REFINEMENT_FAILURES:
            failures[row] = REFINEMENT_FAILURES[ending]
    coefficients = at_all_images(refined.coefficients, 0.0)
    rotation = at_all_images(refined.rotation)
    estimate = replace(
        old,
        shapes=at_all_images(S),
        translation=at_all_images((origin - norm.centroid) / norm.scale[:, None]),
        rotation=rotation,
        objective=at_all_images(refined.objective),
        residual=at_all_images(residual),
        iterations=iterations,
        status=tuple(status),
        coefficients=coefficients,
        active_atoms=is_active(coefficients).sum(axis=1),
        transforms=Transforms.with_one_rotation(coefficients, rotation),
        relative_gap=None,
        tight=None,
    )
    return Lifting(
        shapes=at_all_images(shapes),
        landmarks_fitted=at_all_images(fitted),
        translation=at_all_images(origin),
        scale=at_all_images(scale),
        problem=whole,
        estimate=estimate,
        failures=failures,
        perspective=PerspectiveView(at_all_images(t), camera),
    )


def fill_in_rotations(
    known: Floats, problem: Problem, mean_shape: Floats, threads: int
) -> Floats:
    """Replace unknown rotations (m, 3, 3), nan, by those of the mean shape's pose.

    The identity where it has no pose.
    """
    R = known.copy()
    unknown = np.flatnonzero(~np.isfinite(R).all(axis=(1, 2)))
    if len(unknown):
        pose = find_pose(problem.take(unknown), mean_shape, threads=threads)
        R[unknown] = np.where((pose.size > 0)[:, None, None], pose.rotation, np.eye(3))
    return R


def refine_perspective(
    landmarks: Floats,
    weights: Floats,
    atoms: Floats,
    camera: Camera,
    rotation: Floats,
    prior: Floats,
    *,
    ridge: float = PRIOR_RIDGE,
    softness: float = RESIDUAL_SOFTNESS,
    max_rounds: int = MAX_REFINEMENT_ROUNDS,
    threads: int = 0,
) -> RefinedViews:
    """Fit rotation, translation and coefficients of each image in perspective.

    min sum_j s^2/2 log(1 + |r_j|^2 / s^2) + ridge/2 |c - prior|^2 over R, t and c >= 0.
    s is the softness; max_rounds are those of an image. r_j = Omega_j (w_j - projection
    of column j of R sum_i c_i B_i + t), in normalised units: landmarks w (n, 2, p),
    weights Omega (n, p), atoms B (k, 3, p), camera in the unit of w. It starts from the
    rotations R (n, 3, 3), c = prior (k,), and t where weak perspective puts it. A shape
    twice as large at twice the depth looks the same, so the size is fixed: prior^T c =
    prior^T prior. The result is a local minimum; no certificate bounds it.
    """
    n = len(landmarks)
    R = np.array(rotation, np.float64)
    c = np.tile(np.asarray(prior, np.float64), (n, 1))
    usual_shape = np.tensordot(prior, atoms, axes=1)
    t = place_in_depth(landmarks, weights, usual_shape, camera, R)
    objective = np.full(n, np.nan)
    rounds, codes = np.zeros((2, n), np.int64)
    core.refine_perspective(
        landmarks=np.ascontiguousarray(landmarks, np.float64),
        weights=np.ascontiguousarray(weights, np.float64),
        atoms=np.ascontiguousarray(atoms, np.float64),
        prior=np.ascontiguousarray(prior, np.float64),
        focal=np.ascontiguousarray(camera.focal, np.float64),
        centre=np.ascontiguousarray(camera.centre, np.float64),
        sign=camera.sign,
        ridge=ridge,
        softness=softness,
        max_rounds=max_rounds,
        rotation=R,
        translation=t,
        coefficients=c,
        objective=objective,
        rounds=rounds,
        status=codes,
        threads=threads,
    )
    status = decode_statuses(codes)
    failed = [ending in REFINEMENT_FAILURES for ending in status]
    for result in (R, t, c):
        result[failed] = np.nan
    return RefinedViews(R, t, c, objective, rounds, status)


def place_in_depth(
    landmarks: Floats, weights: Floats, shape: Floats, camera: Camera, rotation: Floats
) -> Floats:
    """Return translations (n, 3) that place R S at the size and middle of landmarks.

    That is where weak perspective puts it. The depth is that of the visible landmarks'
    middle; S (3, p), the rest as in `refine_perspective`.
    """
    omega = np.where(weights > 0, weights, 0.0) ** 2
    share = omega / omega.sum(axis=1, keepdims=True)
    X = rotation @ shape
    W = np.where(weights[:, None] > 0, landmarks, 0.0)
    middle = np.einsum("nap,np->na", X, share)
    middle_of_landmarks = np.einsum("nap,np->na", W, share)
    rays = (W - camera.centre[..., None]) / camera.focal[..., None]
    ray = (middle_of_landmarks - camera.centre) / camera.focal
    flat = X[:, :2] - middle[:, :2, None]
    centred = rays - ray[..., None]
    size = np.einsum("nap,nap,np->n", flat, flat, share)
    overlap = np.einsum("nap,nap,np->n", flat, centred, share)
    extent = np.einsum("nap,nap,np->n", centred, centred, share)
    # a rotation that fits not at all must not put the shape at infinity
    least = 0.1 * np.sqrt(size * extent)
    # landmarks may all be in one place
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = size / np.maximum(overlap, least)
    t = np.empty((len(W), 3))
    t[:, :2] = ray * depth[:, None] - middle[:, :2]
    t[:, 2] = camera.sign * depth - middle[:, 2]
    return t


def mean_coefficients(atoms: Floats, mean_shape: Floats) -> Floats:
    """Return the coefficients (k,) >= 0 of atoms that come nearest to the mean shape.

    argmin_{c >= 0} |sum_i c_i B_i - mean_shape|^2 + 1e-6 max_i |B_i|^2 |c|^2. For
    exemplars all are alike, 1/k over the spread of their mean.
    """
    k = len(atoms)
    A = atoms.reshape(k, -1).T
    little = 1e-3 * np.linalg.norm(A, axis=0).max()
    c = np.zeros((1, k))
    core.code(
        gram=A.T @ A + little**2 * np.eye(k),
        linear_terms=np.reshape(mean_shape.ravel() @ A, (1, k)),
        smallest_moves=np.array([1e-12 * np.linalg.norm(mean_shape)]),
        coefficients=c,
        unsettled=np.zeros(1, dtype=bool),
        threads=1,
    )
    mean: Floats = c[0]
    return mean
