"""The camera of each image, from the config and the landmark files, and shapes refined for it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.config.fit.camera import ViewingConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.geometry.pinhole import Camera, depth_sign
from shapefit.io import LandmarkSet
from shapefit.lifting.lift import Lifting
from shapefit.lifting.options import PerspectiveOptions
from shapefit.lifting.perspective.view import refine_view

Floats = NDArray[np.float64]

NO_DATASETS = "give `camera.focal`, or landmarks in HDF5: CSV holds no datasets"

FAR_ASIDE = np.tan(np.radians(15.0))
"""Distance from the optical axis, in focal lengths, where few cameras see all that they see."""


def find_camera(images: LandmarkSet, config: ViewingConfig) -> Camera:
    """Return focal lengths and principal points of the images.

    The principal point of the config goes over that of the matrices. Raises InputError for a
    dataset that does not exist, has another shape, or holds what no camera has.
    """
    n = len(images)
    if config.matrices is None:
        focal, centre = np.full((n, 2), config.focal), np.zeros((n, 2))
    else:
        focal, centre = read_intrinsics(images, config.matrices)
    if config.principal_point is not None:
        centre = np.tile(np.array(config.principal_point), (n, 1))
    return Camera(focal, centre, depth_sign(images.y_axis))


def refine_through_camera(
    lifting: Lifting,
    images: LandmarkSet,
    dictionary: Dictionary,
    *,
    config: ViewingConfig,
    options: PerspectiveOptions,
    views: int,
) -> Lifting:
    """Refine what was lifted under the full projection of the cameras of the images."""
    camera = find_camera(images, config)
    return refine_view(lifting, images.landmarks, camera, dictionary, options, views=views)


def all_aside(landmarks: Floats, camera: Camera) -> bool:
    """Whether all landmarks (n, 2, p) lie to one side of the optical axis, in x and in y, and far.

    So they do where the principal point is wrong, as 0, 0 is for pixels counted from a corner.
    """
    seen = np.isfinite(landmarks).all(axis=1)
    if not seen.any():
        return False
    tangents = (landmarks - camera.centre[..., None]) / camera.focal[..., None]
    of_seen = np.moveaxis(tangents, 1, 0)[:, seen]  # (2, landmarks)
    one_sided = (of_seen > 0).all(axis=1) | (of_seen < 0).all(axis=1)
    far = np.hypot(*of_seen) > FAR_ASIDE
    return bool(one_sided.all() and far.all())


def read_intrinsics(images: LandmarkSet, name: str) -> tuple[Floats, Floats]:
    """Return focal (n, 2) and principal point (n, 2) from a dataset of the landmark files."""
    values = images.extras.get(name)
    place = f"camera.intrinsics: {name}"
    if values is None:
        there = ", ".join(sorted(images.extras))
        fix = f"name one that holds cameras; there are: {there}" if there else NO_DATASETS
        raise input_error(place, "the landmarks have no such dataset", fix)
    n, shape = len(images), np.shape(values)
    if not np.issubdtype(np.asarray(values).dtype, np.number):
        raise input_error(place, "does not hold numbers", "name one with focal lengths or matrices")
    if np.iscomplexobj(values) or not np.isfinite(values).all():
        fix = "correct it, or leave out the images"
        raise input_error(place, "holds numbers that are not real or not finite", fix)
    numbers = np.asarray(values, dtype=np.float64)
    if shape in ((), (1,), (n,)):
        focal = np.broadcast_to(numbers.reshape(-1, 1), (n, 2))
        centre = np.zeros((n, 2))
    elif shape in ((3, 3), (1, 3, 3), (n, 3, 3)):
        matrices = np.broadcast_to(numbers, (n, 3, 3))
        focal = np.stack([matrices[:, 0, 0], matrices[:, 1, 1]], axis=1)
        centre = matrices[:, :2, 2]
        plain = np.zeros((n, 3, 3))
        plain[:, [0, 1], [0, 1]], plain[:, :2, 2], plain[:, 2, 2] = focal, centre, 1.0
        wrong = ~np.isclose(matrices, plain, atol=1e-6 * np.abs(numbers).max()).all(axis=(1, 2))
        if wrong.any():
            rows = ", ".join(" ".join(f"{x:g}" for x in row) for row in matrices[wrong.argmax()])
            fix = "give matrices with rows fx 0 cx, 0 fy cy, 0 0 1 (no skew)"
            raise input_error(place, f"holds an impossible camera matrix, {rows}", fix)
    else:
        found = f"has the shape {shape}"
        fix = f"give one number or 3x3 matrix, or {n} of them, one per image"
        raise input_error(place, found, fix)
    if not (focal > 0).all():
        found = f"holds the focal length {focal.min():g}"
        raise input_error(place, found, "give numbers > 0, or leave out the images")
    return np.array(focal), np.array(centre)
