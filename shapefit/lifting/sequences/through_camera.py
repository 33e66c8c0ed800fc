"""Sequences in front of a pinhole camera: into the frame of weak perspective, and back.

Seen in the direction u, the landmark of a point at the depth f + z lies at

    w = f u (1 + z / f)

where weak perspective would have it, in the unit of the image of a body whose middle is
at the depth f. The depths z are those of the images.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from shapefit.arrays import Floats
from shapefit.geometry.pinhole import project_pinhole
from shapefit.lifting.lift import PerspectiveView, PosteriorLifting
from shapefit.lifting.posterior.method import find_rays

Refine = Callable[[PosteriorLifting, Floats], PosteriorLifting]


def refine_through_camera(
    lifting: PosteriorLifting, landmarks: Floats, refine: Refine
) -> PosteriorLifting:
    """Refine a lifting of landmarks (n, 2, p) by `refine`, with or without a camera.

    `refine` takes a lifting by weak perspective and its landmarks, and the memory of
    its modes. The scale of an image stays what it is: bodies are taken to stay about as
    far away, as they are without a camera. Raises ValueError where there is a view, but
    the method did not look through its camera itself.
    """
    view = lifting.perspective
    if view is None:
        return refine(lifting, landmarks)
    near = lifting.problem.camera
    if near is None:
        raise ValueError("the method did not look through the camera itself")
    rays = find_rays(landmarks, view.camera)
    size = rays.focal / find_rays(landmarks, near).focal
    size = np.where(np.isfinite(lifting.scale), size, np.nan)
    # from the unit of the shapes in front of the camera to that of the weak perspective
    to_weak = (lifting.scale / size)[:, None, None]
    flat = np.zeros((len(size), 2))
    estimate = lifting.estimate
    t = view.translation
    middle = rays.focal[:, None] * t[:, :2] / np.abs(t[:, 2:])
    points = lifting.scale[:, None, None] * estimate.shapes
    points[:, :2] += middle[..., None]
    weak = replace(
        lifting,
        shapes=points,
        translation=flat,
        scale=size,
        estimate=replace(estimate, translation=flat).scale_error_bars(to_weak),
    )
    depth = view.camera.sign * points[:, 2:] / rays.focal[:, None, None]
    refined = refine(weak, rays.landmarks * (1 + depth))
    return convert_refined_to_pinhole(lifting, view, refined, rays.focal, to_weak)


def convert_refined_to_pinhole(
    lifting: PosteriorLifting,
    view: PerspectiveView,
    refined: PosteriorLifting,
    focal: Floats,
    to_weak: Floats,
) -> PosteriorLifting:
    """Convert refined shapes (n, 3, p) from weak perspective to the pinhole camera.

    refined: by weak perspective, its error bars in a unit in which numbers are to_weak
    (n, 1, 1) times those of `lifting`.
    """
    camera = view.camera
    middle = refined.shapes[:, :2].mean(axis=2)
    shapes = refined.shapes.copy()
    shapes[:, :2] -= middle[..., None]
    place = np.concatenate([middle, camera.sign * focal[:, None]], axis=1)
    t = place / lifting.scale[:, None]
    in_space = shapes / lifting.scale[:, None, None] + t[..., None]
    fitted = project_pinhole(camera, in_space)
    translation = camera.centre + camera.focal * middle / focal[:, None]
    shapes[:, :2] += translation[..., None]
    return replace(
        lifting,
        shapes=shapes,
        landmarks_fitted=fitted,
        translation=translation,
        estimate=replace(
            refined.estimate.scale_error_bars(1 / to_weak),
            translation=lifting.estimate.translation,
            camera_translation=t,
        ),
        perspective=PerspectiveView(t, camera),
    )
