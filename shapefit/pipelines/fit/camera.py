"""The camera of the images: the measured one, else an assumed one; and the lens, which
is undone.

Only methods that look through the camera themselves take an assumed one; for the others
weak perspective stays, as in the paper's program.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from shapefit.arrays import Floats, median
from shapefit.errors import input_error, listed
from shapefit.geometry import pinhole
from shapefit.geometry.pinhole import ASSUMED_FOCAL, CAMERA_MATRIX, Camera
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.lifting.methods import METHODS
from shapefit.records import Landmarks
from shapefit.records.columns import Array

if TYPE_CHECKING:
    from shapefit.config import FitConfig
    from shapefit.config.commands.fit import CameraConfig
    from shapefit.io.readers.calibration import CalibratedCamera

LEAST_ANGLE = 0.1
"""Median extent of the landmarks, in focal lengths, below which perspective does not
show: depths within a body then differ by less than that share.
"""

OUTSIDE = 0.3
"""Share of the size of the image by which landmarks may lie outside it: a body that the
image cuts off, whose rest is drawn by a tracker or by hand.
"""

MIN_OUTSIDE_SHARE = 0.05
"""Share of landmarks farther outside from which the stated size is doubted."""

PIXELS = ("px", "pixel", "pixels", UNKNOWN_UNIT)

IMAGE_SIZE, DISTORTION, REMOVED = "image_size", "distortion", "removed_distortion"
"""Datasets of landmarks, for all or for each: (2,), width and height in pixels, and
(m,), coefficients of OpenCV's model, m = 4, 5 or 8; of a result, those that it no
longer has.
"""

OF_CAMERAS = (CAMERA_MATRIX, DISTORTION, IMAGE_SIZE)

SHORTEST, FARTHEST = 1e-6, 1e12
"""Pixels, or what the landmarks are in, within which focal lengths are those of a
camera, and principal points near an image: squares of others overflow.
"""

WEAK = {"focal": "none"}


def choose_camera(
    config: FitConfig, images: Landmarks, *, from_landmarks: bool
) -> tuple[dict[str, Any], str]:
    """Return the keys of `camera` that the config leaves open, and a line about the
    camera.

    A measured camera is taken as it is. Otherwise the optical axis meets the centre of
    the image, and the focal length is `ASSUMED_FOCAL` times its longer side. It is weak
    perspective where the size of the image is not known, perspective does not show, or
    a class was learned `from_landmarks` under it. Raises InputError for a focal length
    without a size.
    """
    given, method = config.camera, METHODS[config.method]
    calibrated = given.calibration is not None and method.perspective != "none"
    if given.focal == "none" or (
        given.focal == "auto" and not method.has_prior and not calibrated
    ):
        return WEAK, "weak perspective"
    if calibrated:
        return {"focal": "files"}, "perspective, of the calibration"
    in_files = images.column(CAMERA_MATRIX) is not None and not from_landmarks
    if given.focal == "files" or (given.focal == "auto" and in_files):
        read_intrinsics(images)
        return {"focal": "files"}, f"perspective, `{CAMERA_MATRIX}` of the files"
    width, height = find_size(config, images)
    centre = given.principal_point or (width / 2, height / 2)
    if not isinstance(given.focal, str):
        if np.isnan(centre).any():
            fix = (
                "give the size of the images, --image-size WxH, or"
                " `camera.principal_point`"
            )
            raise input_error("camera.focal", "the principal point is not known", fix)
        check_intrinsics("camera.focal", np.array(given.focal), np.array(centre))
        at = ", ".join(f"{x:g}" for x in centre)
        line = f"focal length {given.focal:.5g} px, principal point {at}"
        return {"principal_point": centre}, line
    if from_landmarks:
        return WEAK, "weak perspective, by which the class was learned"
    if images.unit not in PIXELS:
        return WEAK, f"weak perspective: landmarks are in {images.unit}, not in pixels"
    if np.isnan(width):
        why = (
            "the size of the images is not known; exact positions in metres need"
            " --image-size"
        )
        return WEAK, f"weak perspective, as {why}"
    focal = ASSUMED_FOCAL * max(width, height)
    if find_extent(images) < LEAST_ANGLE * focal:
        return WEAK, "weak perspective: the landmarks cover little of the image"
    line = (
        f"focal length {focal:.0f} px (assumed: set --focal), image {width:.0f} x"
        f" {height:.0f}; "
    )
    keys = {
        "focal": focal,
        "principal_point": centre,
        "focal_sd": pinhole.ASSUMED_FOCAL_SD,
    }
    return keys, line + "`camera.focal=none` does without"


def find_size(config: FitConfig, images: Landmarks) -> tuple[float, float]:
    """Return width and height of the images; nan where they are unknown or several."""
    if config.image_size is not None:
        return config.image_size
    if images.column(IMAGE_SIZE) is not None:
        sizes = np.unique(read_dataset(images, IMAGE_SIZE, (2,)), axis=0)
        if len(sizes) == 1 and (sizes > 0).all():
            return sizes[0, 0], sizes[0, 1]
    return np.nan, np.nan


def say_outside(config: FitConfig, images: Landmarks) -> str:
    """Return a warning where many landmarks lie outside the stated image, else ""."""
    size = np.array(find_size(config, images))
    if images.unit not in PIXELS or not np.isfinite(size).all():
        return ""
    points = images.landmarks[images.visible()]
    beyond = (points < -OUTSIDE * size) | (points > (1 + OUTSIDE) * size)
    if not len(points) or beyond.any(axis=1).mean() < MIN_OUTSIDE_SHARE:
        return ""
    share = beyond.any(axis=1).mean()
    reach = points.max(axis=0)
    return (
        f"{share:.0%} of the landmarks lie outside the stated image of {size[0]:.0f} x"
        f" {size[1]:.0f}: they reach to {reach[0]:.0f}, {reach[1]:.0f}; is the size"
        " right? Give it by --image-size WxH"
    )


def find_extent(images: Landmarks) -> float:
    """Return the median diagonal of the landmarks of an image; inf where none has
    several.
    """
    w = np.where(images.visible()[..., None], images.landmarks, np.nan)
    w = w[np.isfinite(w).all(axis=2).sum(axis=1) > 1]
    highest = np.nanmax(w, axis=1, initial=-np.inf)
    extent = highest - np.nanmin(w, axis=1, initial=np.inf)
    return median(np.hypot(*extent.T)) if len(w) else np.inf


def read_lens(config: FitConfig) -> CalibratedCamera | None:
    """Return the camera of the calibration that a config names, None without one."""
    if config.camera.calibration is None:
        return None
    from shapefit.io.readers.calibration import read_camera

    return read_camera(config.camera.calibration, config.camera.name)


def camera_factory(config: CameraConfig) -> Callable[[Landmarks], Camera] | None:
    """Return what gives the cameras of images by a config, None for weak
    perspective.
    """
    assumed = config.focal in ("auto", "none")
    return None if assumed else partial(find_camera, config=config)


def find_camera(images: Landmarks, config: CameraConfig | None = None) -> Camera:
    """Return the cameras of n images: as the config states them, else by their
    matrices.
    """
    n, sign = len(images), pinhole.depth_sign(images.y_axis)
    if config is None or isinstance(config.focal, str):
        focals, centres = read_intrinsics(images)
    else:
        focals, centres = np.full((n, 2), config.focal), np.zeros((n, 2))
    if config is None:
        return Camera(focals, centres, sign, 0.0)
    if config.principal_point is not None:
        centres = np.tile(np.array(config.principal_point), (n, 1))
    return Camera(focals, centres, sign, config.focal_sd)


def read_intrinsics(images: Landmarks) -> tuple[Floats, Floats]:
    """Return focal (n, 2) and principal point (n, 2) by the camera matrices, without
    their skew.
    """
    if images.column(CAMERA_MATRIX) is None:
        fix = (
            "give `camera.focal`, or landmarks in HDF5 that have it: CSV holds no"
            " datasets"
        )
        raise input_error(CAMERA_MATRIX, "the landmarks have no such dataset", fix)
    K = read_dataset(images, CAMERA_MATRIX, (3, 3))
    focal = np.stack([K[:, 0, 0], K[:, 1, 1]], axis=1)
    rest = abs(K - np.eye(3))[:, [1, 2, 2, 2], [0, 0, 1, 2]]
    if (rest > 1e-6 * abs(K).max(initial=0)).any() or (focal <= 0).any():
        fix = "give matrices with rows fx 0 cx, 0 fy cy, 0 0 1, where fx and fy are > 0"
        raise input_error(CAMERA_MATRIX, "holds an impossible camera matrix", fix)
    centre = K[:, :2, 2].copy()
    check_intrinsics(CAMERA_MATRIX, focal, centre)
    return focal, centre


def check_intrinsics(place: str, focal: Floats, centre: Floats) -> None:
    """Raise InputError for focal lengths and principal points of no camera."""
    possible = (focal >= SHORTEST) & (focal <= FARTHEST)
    if not (possible.all() and (np.abs(centre) <= FARTHEST).all()):
        values = [*np.ravel(focal).tolist(), *np.ravel(centre).tolist()]
        worst = max(values, key=abs) if possible.all() else float(focal.flat[0])
        fault = f"holds {worst:g}, which no camera has"
        fix = f"give pixels: a focal length from {SHORTEST:g} to {FARTHEST:g}"
        raise input_error(place, fault, f"{fix}, a principal point up to {FARTHEST:g}")


def read_dataset(images: Landmarks, name: str, *shapes: tuple[int, ...]) -> Floats:
    """Return a dataset (n, *shape) that is there and holds an array of one of these
    shapes, or one per image.
    """
    n = len(images)
    values = np.asarray(images.column(name))
    if values.dtype.kind in "iuf" and np.isfinite(values).all():
        for shape in shapes:
            if values.shape in (shape, (n, *shape)):
                return np.broadcast_to(values.astype(np.float64), (n, *shape))
    fix = (
        f"give {listed(map(str, shapes))} finite numbers, for the file or for each"
        " image"
    )
    raise input_error(name, f"has the shape {values.shape}, or is not finite", fix)


def undistorted(images: Landmarks, calibrated: CalibratedCamera | None) -> Landmarks:
    """Return the images as the calibrated camera, or that of the files, sees them
    without a lens.

    A landmark that no point of the scene can have in this lens is unseen.
    """
    if calibrated is not None:
        stated = {
            CAMERA_MATRIX: calibrated.matrix,
            DISTORTION: calibrated.distortion,
            IMAGE_SIZE: calibrated.size,
            "extrinsic_rotation": calibrated.rotation,
            "extrinsic_translation": calibrated.translation,
        }
        known = {name: v for name, v in stated.items() if v is not None}
        images = images.with_file_extras(known)
    if images.column(DISTORTION) is None or images.column(CAMERA_MATRIX) is None:
        return images
    coefficients = pinhole.complete_coefficients(
        read_dataset(images, DISTORTION, (4,), (5,), (8,))
    )
    if not coefficients.any():
        return images
    if images.y_axis == "up":
        coefficients = coefficients * np.where(np.arange(8) == 2, -1.0, 1.0)
    focal, centre = (values[..., None] for values in read_intrinsics(images))
    straight = centre + focal * pinhole.undistort(
        (images.as_columns() - centre) / focal, coefficients
    )
    straightened = replace(
        images,
        landmarks=straight.swapaxes(1, 2),
        extras=_rename_distortion(images.extras),
        file_extras=_rename_distortion(images.file_extras),
    )
    return straightened.with_whole_points()


def _rename_distortion(extras: Mapping[str, Array]) -> dict[str, Array]:
    """Return datasets with the distortion, if it is among them, as removed."""
    renamed = {name: v for name, v in extras.items() if name != DISTORTION}
    if DISTORTION in extras:
        renamed[REMOVED] = extras[DISTORTION]
    return renamed
