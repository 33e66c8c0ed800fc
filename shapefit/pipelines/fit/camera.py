"""The camera of the images: the measured one, else an assumed one; and the lens, which
is undone.

Only methods that look through the camera themselves take an assumed one; for the others
weak perspective stays, as in the paper's program.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from shapefit.arrays import Floats, median
from shapefit.errors import input_error, listed
from shapefit.geometry import pinhole
from shapefit.geometry.pinhole import ASSUMED_FOCAL, CAMERA_MATRIX, Camera
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.family import CameraKey
from shapefit.records import Landmarks
from shapefit.records.columns import Array

if TYPE_CHECKING:
    from shapefit.config import FitConfig
    from shapefit.config.commands.fit import CameraConfig
    from shapefit.io.readers.calibration import CalibratedCamera

MIN_EXTENT_IN_FOCALS = 0.1
"""Median extent of the landmarks, in focal lengths, below which perspective does not
show: depths within a body then differ by less than that share.
"""

MAX_OUTSIDE_SHARE = 0.3
"""Share of the size of the image by which landmarks may lie outside it: a body that the
image cuts off, whose rest is drawn by a tracker or by hand.
"""

MIN_OUTSIDE_SHARE = 0.05
"""Share of landmarks farther outside from which the stated size is doubted."""

PIXEL_UNITS = ("px", "pixel", "pixels", UNKNOWN_UNIT)
"""Units of landmarks that may be pixels."""

IMAGE_SIZE = "image_size"
"""Dataset of landmarks, for all or for each: width and height in pixels (2,)."""

DISTORTION = "distortion"
"""Dataset of landmarks, for all or for each: coefficients of OpenCV's model (m,), with
m = 4, 5 or 8.
"""

REMOVED = "removed_distortion"
"""Dataset of a result: the distortion that its landmarks no longer have."""

CAMERA_DATASETS = (CAMERA_MATRIX, DISTORTION, IMAGE_SIZE)
"""What landmarks may say of their camera."""

MIN_FOCAL_PIXELS = 1e-6
"""Least focal length of a camera, in what the landmarks are in."""

MAX_CAMERA_PIXELS = 1e12
"""Largest focal length, and distance of a principal point: squares of others overflow.
"""


class CameraChoice(NamedTuple):
    """Values chosen for the open keys of `camera`, and a line about them."""

    keys: Mapping[str, CameraKey]
    line: str


def choose_camera(
    config: FitConfig, images: Landmarks, *, from_landmarks: bool
) -> CameraChoice:
    """Choose the camera of the images where the config leaves it open.

    A measured camera is taken as it is. Otherwise the optical axis meets the centre of
    the image, and the focal length is `ASSUMED_FOCAL` times its longer side. It is weak
    perspective where the size of the image is not known, perspective does not show, or
    a class was learned `from_landmarks` under it. Raises InputError for a focal length
    without a size.
    """
    given = config.camera
    method = METHODS[config.method]
    is_calibrated = given.calibration is not None and method.perspective != "none"
    is_open = given.focal == "auto"
    looks_through = method.needs_prior or is_calibrated
    if given.focal == "none" or (is_open and not looks_through):
        return weak_perspective("")
    if is_calibrated:
        return CameraChoice({"focal": "files"}, "perspective, of the calibration")
    in_files = images.column(CAMERA_MATRIX) is not None and not from_landmarks
    if given.focal == "files" or (is_open and in_files):
        intrinsics_of(images)
        line = f"perspective, `{CAMERA_MATRIX}` of the files"
        return CameraChoice({"focal": "files"}, line)
    size = find_size(config, images)
    if not isinstance(given.focal, str):
        return stated_camera(given, size)
    if from_landmarks:
        return weak_perspective(", by which the class was learned")
    return assume_camera(given, size, images)


def weak_perspective(suffix: str) -> CameraChoice:
    """Return the choice of weak perspective; the suffix of its line says why."""
    return CameraChoice({"focal": "none"}, f"weak perspective{suffix}")


def stated_camera(camera: CameraConfig, size: Size) -> CameraChoice:
    """Return the camera of a focal length that the config states.

    Raises InputError where the principal point is not known, and for impossible values.
    """
    centre = camera.principal_point or (size.width / 2, size.height / 2)
    if np.isnan(centre).any():
        fix = (
            "give the size of the images, --image-size WxH, or `camera.principal_point`"
        )
        raise input_error("camera.focal", "the principal point is not known", fix)
    check_intrinsics("camera.focal", np.array(camera.focal), np.array(centre))
    at = ", ".join(f"{x:g}" for x in centre)
    line = f"focal length {camera.focal:.5g} px, principal point {at}"
    return CameraChoice({"principal_point": centre}, line)


def assume_camera(camera: CameraConfig, size: Size, images: Landmarks) -> CameraChoice:
    """Return a camera with the usual focal length, or weak perspective and why."""
    if images.unit not in PIXEL_UNITS:
        return weak_perspective(f": landmarks are in {images.unit}, not in pixels")
    if np.isnan(size.width):
        return weak_perspective(
            ", as the size of the images is not known; exact positions in metres need"
            " --image-size"
        )
    focal = ASSUMED_FOCAL * max(size)
    if find_extent(images) < MIN_EXTENT_IN_FOCALS * focal:
        return weak_perspective(": the landmarks cover little of the image")
    keys: dict[str, CameraKey] = {
        "focal": focal,
        "principal_point": camera.principal_point or (size.width / 2, size.height / 2),
        "focal_sd": pinhole.ASSUMED_FOCAL_SD,
    }
    line = (
        f"focal length {focal:.0f} px (assumed: set --focal), image {size.width:.0f} x"
        f" {size.height:.0f}; `camera.focal=none` does without"
    )
    return CameraChoice(keys, line)


class Size(NamedTuple):
    """Width and height of images in pixels; nan where they are unknown."""

    width: float
    height: float


def find_size(config: FitConfig, images: Landmarks) -> Size:
    """Return width and height of the images; nan where they are unknown or several."""
    if config.image_size is not None:
        return Size(*config.image_size)
    if images.column(IMAGE_SIZE) is not None:
        sizes = np.unique(checked_dataset(images, IMAGE_SIZE, (2,)), axis=0)
        if len(sizes) == 1 and (sizes > 0).all():
            return Size(*sizes[0])
    return Size(np.nan, np.nan)


def warn_of_landmarks_outside(config: FitConfig, images: Landmarks) -> str:
    """Return a warning where many landmarks lie outside the stated image, else ""."""
    size = np.array(find_size(config, images))
    if images.unit not in PIXEL_UNITS or not np.isfinite(size).all():
        return ""
    points = images.landmarks[images.visible()]
    margin = MAX_OUTSIDE_SHARE * size
    is_beyond = ((points < -margin) | (points > size + margin)).any(axis=1)
    if not len(points) or is_beyond.mean() < MIN_OUTSIDE_SHARE:
        return ""
    share = is_beyond.mean()
    reach = points.max(axis=0)
    return (
        f"{share:.0%} of the landmarks lie outside the stated image of {size[0]:.0f} x"
        f" {size[1]:.0f}: they reach to {reach[0]:.0f}, {reach[1]:.0f}; is the size"
        " right? Give it by --image-size WxH"
    )


def find_extent(images: Landmarks) -> float:
    """Return the median diagonal of the landmarks of an image; inf if none has two."""
    w = np.where(images.visible()[..., None], images.landmarks, np.nan)
    w = w[np.isfinite(w).all(axis=2).sum(axis=1) > 1]
    highest = np.nanmax(w, axis=1, initial=-np.inf)
    extent = highest - np.nanmin(w, axis=1, initial=np.inf)
    return median(np.hypot(*extent.T)) if len(w) else np.inf


def read_calibrated_camera(config: FitConfig) -> CalibratedCamera | None:
    """Read the camera, with its lens, from the calibration file of a config, if any."""
    if config.camera.calibration is None:
        return None
    from shapefit.io.readers.calibration import read_camera

    return read_camera(config.camera.calibration, config.camera.name)


def camera_factory(config: CameraConfig) -> Callable[[Landmarks], Camera] | None:
    """Return the function from images to their cameras, None for weak perspective."""
    assumed = config.focal in ("auto", "none")
    return None if assumed else partial(find_camera, config=config)


def find_camera(images: Landmarks, config: CameraConfig | None = None) -> Camera:
    """Return the cameras of n images: by the config, else by their matrices."""
    n = len(images)
    sign = pinhole.depth_sign(images.y_axis)
    if config is None:
        focals, centres = intrinsics_of(images)
        return Camera(focals, centres, sign, 0.0)
    if isinstance(config.focal, str):
        focals, centres = intrinsics_of(images)
    else:
        focals = np.full((n, 2), config.focal)
        centres = np.zeros((n, 2))
    if config.principal_point is not None:
        centres = np.tile(np.array(config.principal_point), (n, 1))
    return Camera(focals, centres, sign, config.focal_sd)


def intrinsics_of(images: Landmarks) -> tuple[Floats, Floats]:
    """Return focal lengths (n, 2) and principal points (n, 2) of n camera matrices.

    They are the dataset `camera_matrix` of the images. Raises InputError where they
    lack it, and for a matrix that is impossible or has skew.
    """
    if images.column(CAMERA_MATRIX) is None:
        fix = (
            "give `camera.focal`, or landmarks in HDF5 that have it: CSV holds no"
            " datasets"
        )
        raise input_error(CAMERA_MATRIX, "the landmarks have no such dataset", fix)
    K = checked_dataset(images, CAMERA_MATRIX, (3, 3))
    focal = np.stack([K[:, 0, 0], K[:, 1, 1]], axis=1)
    rest = abs(K - np.eye(3))[:, [1, 2, 2, 2], [0, 0, 1, 2]]
    if (rest > 1e-6 * abs(K).max(initial=0)).any() or (focal <= 0).any():
        fix = "give matrices with rows fx 0 cx, 0 fy cy, 0 0 1, where fx and fy are > 0"
        raise input_error(CAMERA_MATRIX, "holds an impossible camera matrix", fix)
    centre = K[:, :2, 2].copy()
    check_intrinsics(CAMERA_MATRIX, focal, centre)
    return focal, centre


def check_intrinsics(place: str, focal: Floats, centre: Floats) -> None:
    """Raise InputError at `place` for a focal length or centre that no camera has."""
    is_focal = (focal >= MIN_FOCAL_PIXELS) & (focal <= MAX_CAMERA_PIXELS)
    is_centre = np.abs(centre) <= MAX_CAMERA_PIXELS
    if is_focal.all() and is_centre.all():
        return
    worst = float(focal.flat[0])
    if is_focal.all():
        worst = float(centre.flat[np.abs(centre).argmax()])
    fix = (
        f"give pixels: a focal length from {MIN_FOCAL_PIXELS:g} to"
        f" {MAX_CAMERA_PIXELS:g}, a principal point up to {MAX_CAMERA_PIXELS:g}"
    )
    raise input_error(place, f"holds {worst:g}, which no camera has", fix)


def checked_dataset(images: Landmarks, name: str, *shapes: tuple[int, ...]) -> Floats:
    """Return a dataset of n images as an array (n, *shape), one of `shapes`.

    The file may state one array for all images, which is repeated, or one of each; the
    images must have the dataset. Raises InputError for other shapes, for what is not
    finite, and for what is no number.
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


def remove_distortion(
    images: Landmarks, calibrated: CalibratedCamera | None
) -> Landmarks:
    """Return the images with the distortion of the lens removed from their landmarks.

    The lens is that of `calibrated`, whose matrix and so on they then have as datasets;
    where that is None it is the one of their own datasets, and without these they stay
    as they are. A landmark that no point of the scene can have in this lens is unseen.
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
        checked_dataset(images, DISTORTION, (4,), (5,), (8,))
    )
    if not coefficients.any():
        return images
    if images.y_axis == "up":
        coefficients = coefficients * np.where(np.arange(8) == 2, -1.0, 1.0)
    focal, centre = (values[..., None] for values in intrinsics_of(images))
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
    """Return datasets with `distortion`, if there, renamed to `removed_distortion`."""
    renamed = {name: v for name, v in extras.items() if name != DISTORTION}
    if DISTORTION in extras:
        renamed[REMOVED] = extras[DISTORTION]
    return renamed
