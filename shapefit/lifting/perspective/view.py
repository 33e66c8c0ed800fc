"""Refine what was lifted by weak perspective under the full projection of a known camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.convex.solution import Status
from shapefit.convex.transforms import Transforms
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.pinhole import Camera, project
from shapefit.lifting.estimate import Estimate, fit_translation
from shapefit.lifting.lift import Lifting, PerspectiveView
from shapefit.lifting.options import PerspectiveOptions
from shapefit.lifting.perspective.refinement import refine_perspective
from shapefit.lifting.perspective.start import mean_coefficients
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


def refine_view(
    lifting: Lifting,
    landmarks: Floats,
    camera: Camera,
    dictionary: Dictionary,
    options: PerspectiveOptions,
    *,
    views: int,
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
    seen = camera.take(rows)
    nearby = seen.normalised_as(norm)
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
    scale = np.sqrt(seen.focal.prod(axis=1)) / depth
    origin = seen.centre + seen.focal * t[:, :2] / depth[:, None]
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
