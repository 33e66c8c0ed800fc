"""What the config and the landmark files say about the camera of each image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.config.fit_camera import ViewingConfig
from shapefit.errors import input_error
from shapefit.io import LandmarkSet
from shapefit.lifting.perspective import Camera, depth_sign

Floats = NDArray[np.float64]


def find_camera(images: LandmarkSet, config: ViewingConfig) -> Camera:
    """Return focal lengths and principal points of the images.

    The principal point of the config goes over that of the matrices. Raises InputError for a
    dataset that does not exist, has another shape, or holds what no camera has.
    """
    n = len(images)
    if config.intrinsics is None:
        focal, centre = np.full((n, 2), config.focal), np.zeros((n, 2))
    else:
        focal, centre = read_intrinsics(images, config.intrinsics)
    if config.principal_point is not None:
        centre = np.tile(np.array(config.principal_point), (n, 1))
    return Camera(focal, centre, depth_sign(images.y_axis))


def read_intrinsics(images: LandmarkSet, name: str) -> tuple[Floats, Floats]:
    """Return focal (n, 2) and principal point (n, 2) from a dataset of the landmark files."""
    values = images.extras.get(name)
    place = f"camera.intrinsics: {name}"
    if values is None:
        there = ", ".join(sorted(images.extras)) or "none"
        found = "the landmarks have no such dataset"
        raise input_error(place, found, f"name one that holds cameras; there are: {there}")
    n, shape = len(images), np.shape(values)
    if not np.issubdtype(np.asarray(values).dtype, np.number):
        raise input_error(place, "does not hold numbers", "name one with focal lengths or matrices")
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
        if not np.allclose(matrices, plain, atol=1e-6 * np.abs(numbers).max()):
            fix = "give matrices with rows fx 0 cx, 0 fy cy, 0 0 1 (no skew)"
            raise input_error(place, "is not a camera matrix", fix)
    else:
        found = f"has the shape {shape}"
        fix = f"give one number or 3x3 matrix, or {n} of them, one an image"
        raise input_error(place, found, fix)
    if not (np.isfinite(focal).all() and np.isfinite(centre).all() and (focal > 0).all()):
        found = "holds a focal length that is not a number > 0"
        raise input_error(place, found, "correct it, or leave out the images")
    return np.array(focal), np.array(centre)
