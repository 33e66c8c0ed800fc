"""Refine what was lifted by weak perspective under the full projection of a known camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.problem import Problem
from shapefit.convex.solution import Status
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise
from shapefit.lifting.estimate import Estimate
from shapefit.lifting.lift import Lifting, PerspectiveView
from shapefit.lifting.perspective import (
    Camera,
    mean_coefficients,
    project,
    refine_perspective,
)
from shapefit.lifting.pose import find_pose, spread_views
from shapefit.lifting.reconstruction import is_active

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

VIEWS = 24
"""Views from which the mean shape is posed where the first estimate has no rotation."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """What `refine_perspective` can be told."""

    ridge: float
    softness: float
    max_rounds: int
    threads: int = 0


def refine_view(
    lifting: Lifting, landmarks: Floats, camera: Camera, dictionary: Dictionary, options: Options
) -> Lifting:
    """Refine rotation, translation and coefficients of n images under the full projection.

    landmarks (n, 2, p) and camera in the unit of the images; landmarks of weight 0 in the problem
    stay left out, images without a shape stay without. It starts from the rotation of the
    estimate. Shapes keep the unit of the landmarks, at the size that the object's origin has in
    the image: scale = focal / depth there, the geometric mean of both axes.
    """
    rows = np.flatnonzero(np.isfinite(lifting.scale))
    weights = lifting.problem.weights[rows]
    norm = normalise(landmarks[rows], weights > 0)
    size = norm.scale[:, None]
    seen = Camera(
        camera.focal[rows] / size, (camera.centre[rows] - norm.centroid) / size, camera.sign
    )
    found = refine_perspective(
        norm.points,
        weights,
        dictionary.atoms,
        seen,
        find_rotations(lifting, dictionary.mean_shape, rows, options.threads),
        mean_coefficients(dictionary.atoms, dictionary.mean_shape),
        ridge=options.ridge,
        softness=options.softness,
        max_rounds=options.max_rounds,
        threads=options.threads,
    )
    n = len(landmarks)
    c, R, t = found.coefficients, found.rotation, found.translation
    S = R @ np.tensordot(c, dictionary.atoms, axes=1)
    depth = camera.sign * t[:, 2]
    scale = np.sqrt(camera.focal[rows].prod(axis=1)) / depth
    origin = camera.centre[rows] + camera.focal[rows] * t[:, :2] / depth[:, None]
    shapes = scale[:, None, None] * S
    shapes[:, :2] += origin[..., None]
    projected = project(seen, S + t[..., None])
    pixels = size[..., None] * projected + norm.centroid[..., None]

    def spread(values: Floats, rest: float = np.nan) -> Floats:
        """Put values of the refined images in their rows."""
        whole = np.full((n, *values.shape[1:]), rest)
        whole[rows] = values
        return whole

    old = lifting.estimate
    iterations = old.iterations.copy()
    iterations[rows] += found.rounds
    estimate = replace(
        old,
        shapes=spread(S),
        translation=spread((origin - norm.centroid) / size),
        rotation=spread(R),
        objective=spread(found.objective),
        residual=spread(relative_residual(norm.points, weights, projected)),
        iterations=iterations,
        status=merge_status(old, found.status, rows),
        coefficients=spread(c, 0.0),
        active_atoms=is_active(spread(c, 0.0)).sum(axis=1),
        transforms=spread(c[:, :, None, None] * R[:, None, :2], 0.0),
        relative_gap=None,
        tight=None,
    )
    failures = dict(lifting.failures)
    for row, status in zip(rows.tolist(), found.status, strict=True):
        if status is Status.NUMERICAL_FAILURE:
            failures[row] = "numerical failure in the refinement under perspective"
    return Lifting(
        shapes=spread(shapes),
        landmarks_fitted=spread(pixels),
        translation=spread(origin),
        scale=spread(scale),
        problem=lifting.problem,
        estimate=estimate,
        failures=failures,
        perspective=PerspectiveView(spread(t), camera.focal, camera.centre),
    )


def find_rotations(lifting: Lifting, mean_shape: Floats, rows: Rows, threads: int) -> Floats:
    """Rotation (r, 3, 3) of the estimate; where it has none, that of the posed mean shape."""
    R = lifting.estimate.rotation[rows]
    unknown = np.flatnonzero(~np.isfinite(R).all(axis=(1, 2)))
    if len(unknown):
        images = rows[unknown]
        problem = lifting.problem
        part = Problem(
            problem.landmarks[images], problem.weights[images], problem.atoms, problem.lam[images]
        )
        pose = find_pose(part, mean_shape, spread_views(VIEWS), threads=threads)
        known = np.all(np.isfinite(pose.rotation), axis=(1, 2), keepdims=True)
        R[unknown] = np.where(known, pose.rotation, np.eye(3))
    return R


def relative_residual(landmarks: Floats, weights: Floats, projected: Floats) -> Floats:
    """||Omega o (W - projected)||_F / ||Omega o W||_F for centred landmarks W (n, 2, p) -> (n,)."""
    left = np.linalg.norm(weights[:, None] * (landmarks - projected), axis=(1, 2))
    return left / np.linalg.norm(weights[:, None] * landmarks, axis=(1, 2))


def merge_status(old: Estimate, refined: Sequence[Status], rows: Rows) -> tuple[Status, ...]:
    """Status of each image: that of its refinement, or, where there was none, its old one."""
    status = list(old.status)
    for row, new in zip(rows.tolist(), refined, strict=True):
        status[row] = new
    return tuple(status)
