"""The camera of the images: the measured one, else an assumed one; and the lens, which is undone.

Intrinsics and distortion come from the config, a calibration or the files of the landmarks. Only
methods that look through the camera themselves take an assumed one; for the others weak perspective
stays, as in the paper's program.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.geometry.pinhole import (
    ASSUMED_FOCAL,
    ASSUMED_FOCAL_SD,
    CAMERA_MATRIX,
    Camera,
    depth_sign,
)
from shapefit.io import LandmarkSet
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.lifting.methods import METHODS

if TYPE_CHECKING:
    from shapefit.config import FitConfig
    from shapefit.config.commands.fit import CameraConfig
    from shapefit.io.readers.calibration import CalibratedCamera

LEAST_ANGLE = 0.1
"""Median extent of the landmarks, in focal lengths, below which perspective does not show: depths
within a body then differ by less than that share."""

PIXELS = ("px", "pixel", "pixels", UNKNOWN_UNIT)

IMAGE_SIZE = "image_size"
"""Dataset (2,) or (n, 2) of the landmarks: width and height of the images in pixels."""

DISTORTION, REMOVED = "distortion", "removed_distortion"
"""Dataset (m,) or (n, m) of landmarks: coefficients of OpenCV's model, m = 4, 5 or 8; and of a
result, those of the distortion that its landmarks no longer have."""

OF_CAMERAS = (CAMERA_MATRIX, DISTORTION, IMAGE_SIZE)
"""Datasets of landmarks that describe the camera."""

WEAK = {"focal": "none"}
"""Keys of `camera` where perspective cannot be known."""


class Intrinsics(NamedTuple):
    """One focal length of all images, or a dataset of the landmarks, with their intrinsics.

    centre (2,), the principal point, overrides that of the dataset; focal_sd, see `Camera`.
    """

    focal: float = 0.0
    centre: tuple[float, float] | None = None
    dataset: str | None = None
    focal_sd: float = 0.0

    @staticmethod
    def of(config: CameraConfig) -> Intrinsics | None:
        """Return those that a config states, None for weak perspective."""
        if config.model != "perspective":
            return None
        if isinstance(config.focal, float | int):
            return Intrinsics(config.focal, config.principal_point, focal_sd=config.focal_sd)
        return Intrinsics(centre=config.principal_point, dataset=CAMERA_MATRIX)


def choose_camera(
    config: FitConfig, images: LandmarkSet, *, from_landmarks: bool
) -> tuple[dict[str, Any], str]:
    """Return the keys of `camera` that the config leaves open, and a line about the camera.

    A measured camera, of a calibration or the `camera_matrix` of the files, is taken as it is. The
    optical axis meets the centre of the image, and the focal length is `ASSUMED_FOCAL` times its
    longer side, unless landmarks are not in pixels or too small for perspective to show
    (`LEAST_ANGLE`). Without the size of the image the camera is weak perspective, and so is that of
    a class that was learned `from_landmarks` under weak perspective, but through a calibration.
    Raises InputError for a focal length without a size.
    """
    given, method = config.camera, METHODS[config.method]
    calibrated = given.calibration is not None and method.perspective != "none"
    if given.focal == "none" or (given.focal == "auto" and not method.has_prior and not calibrated):
        return WEAK, "weak perspective"
    if calibrated:
        return {"focal": "files"}, "perspective, of the calibration"
    in_files = CAMERA_MATRIX in images.columns and not from_landmarks
    if given.focal == "files" or (given.focal == "auto" and in_files):
        read_intrinsics(images, CAMERA_MATRIX)  # or say what is wrong with it
        has_centre = np.ndim(images.columns[CAMERA_MATRIX]) > 1 or given.principal_point
        point = {} if has_centre else {"principal_point": find_centre(config, images)}
        return {"focal": "files", **point}, f"perspective, `{CAMERA_MATRIX}` of the files"
    if isinstance(given.focal, float | int):
        at = given.principal_point or find_centre(config, images)
        line = f"focal length {given.focal:.5g} px, principal point {at[0]:g}, {at[1]:g}"
        return {"principal_point": at}, line
    if from_landmarks:
        return WEAK, "weak perspective, by which the class was learned"
    if images.unit not in PIXELS:
        return WEAK, f"weak perspective: landmarks are in {images.unit}, not in pixels"
    size = find_size(config, images)
    if isinstance(size, str):
        return WEAK, f"weak perspective, as {size}; exact positions in metres need --image-size"
    (width, height), assumed = size, ASSUMED_FOCAL * max(size)
    if find_extent(images) < LEAST_ANGLE * assumed:
        return WEAK, "weak perspective: the landmarks cover little of the image"
    line = (
        f"focal length {assumed:.0f} px (assumed: set --focal), image {width:.0f} x {height:.0f}; "
        "`camera.focal=none` does without"
    )
    centre = width / 2, height / 2
    return {"focal": assumed, "principal_point": centre, "focal_sd": ASSUMED_FOCAL_SD}, line


def find_centre(config: FitConfig, images: LandmarkSet) -> tuple[float, float]:
    """Return the centre of the images. Raises InputError where their size is not known."""
    size = find_size(config, images)
    if isinstance(size, str):
        fix = "give the size of the images, --image-size WxH, or `camera.principal_point`"
        raise input_error("camera.focal", f"the principal point is not known, as {size}", fix)
    return size[0] / 2, size[1] / 2


def find_size(config: FitConfig, images: LandmarkSet) -> tuple[float, float] | str:
    """Return width and height of the images, of the config or the files, or why not."""
    if config.image_size is not None:
        return config.image_size
    if IMAGE_SIZE not in images.columns:
        return "the size of the images is not known"
    sizes = np.asarray(images.columns[IMAGE_SIZE])
    of_numbers = sizes.dtype.kind in "iuf" and sizes.shape in ((2,), (len(images), 2))
    if not of_numbers or not (np.isfinite(sizes) & (sizes > 0)).all():
        return "the files state an impossible `image_size`"
    sizes = np.unique(sizes.reshape(-1, 2).astype(np.float64), axis=0)
    return "the images have several sizes" if len(sizes) != 1 else (sizes[0, 0], sizes[0, 1])


def find_extent(images: LandmarkSet) -> float:
    """Return the median diagonal of the landmarks of an image; inf where none has several."""
    w = np.where(images.visible()[:, None], images.landmarks, np.nan)
    w = w[np.isfinite(w).all(axis=1).sum(axis=1) > 1]
    extent = np.nanmax(w, axis=2, initial=-np.inf) - np.nanmin(w, axis=2, initial=np.inf)
    return float(np.median(np.hypot(*extent.T))) if len(w) else np.inf


def find_camera(images: LandmarkSet, intrinsics: Intrinsics) -> Camera:
    """Return focal lengths and principal points of the images.

    Raises InputError for a dataset that does not exist, has another shape, or holds what no camera
    has.
    """
    n = len(images)
    focal, centre = np.full((n, 2), intrinsics.focal), np.zeros((n, 2))
    if intrinsics.dataset is not None:
        focal, centre = read_intrinsics(images, intrinsics.dataset)
    if intrinsics.centre is not None:
        centre = np.tile(np.array(intrinsics.centre), (n, 1))
    return Camera(focal, centre, depth_sign(images.y_axis or "down"), intrinsics.focal_sd)


def read_intrinsics(images: LandmarkSet, name: str) -> tuple[Floats, Floats]:
    """Return focal (n, 2) and principal point (n, 2) from a dataset of the landmark files.

    Of a matrix with a skew, what is left without it. Raises InputError.
    """
    values, place, n = images.columns.get(name), f"camera.focal: {name}", len(images)
    if values is None:
        fix = "give `camera.focal`, or landmarks in HDF5 that have it: CSV holds no datasets"
        raise input_error(place, "the landmarks have no such dataset", fix)
    shape, fix = np.shape(values), f"give one number or 3x3 matrix, or {n} of them, one per image"
    matrices = shape in ((3, 3), (1, 3, 3), (n, 3, 3))
    if np.asarray(values).dtype.kind not in "iuf" or not (matrices or shape in ((), (1,), (n,))):
        raise input_error(place, f"has the shape {shape}, or holds no numbers", fix)
    numbers = np.asarray(values, dtype=np.float64)
    if not matrices:
        focal, centre = np.broadcast_to(numbers.reshape(-1, 1), (n, 2)), np.zeros((n, 2))
    else:
        K = np.broadcast_to(numbers, (n, 3, 3))
        focal, centre = np.stack([K[:, 0, 0], K[:, 1, 1]], axis=1), K[:, :2, 2]
        off = abs(K - np.eye(3))[:, [1, 2, 2, 2], [0, 0, 1, 2]].max(axis=1)
        wrong = ~(off <= 1e-6 * np.abs(numbers).max())
        if wrong.any():
            rows = ", ".join(" ".join(f"{x:g}" for x in row) for row in K[wrong.argmax()])
            fix = "give matrices with rows fx 0 cx, 0 fy cy, 0 0 1"
            raise input_error(place, f"holds an impossible camera matrix, {rows}", fix)
    if not (np.isfinite(centre).all() and np.isfinite(focal).all() and (focal > 0).all()):
        found = f"holds a focal length <= 0, {focal.min():g}, or what is not finite"
        raise input_error(place, found, "give numbers > 0, or leave out the images")
    return np.array(focal), np.array(centre)


def find_calibrated(config: CameraConfig) -> CalibratedCamera | None:
    """Return the camera that the config names in a calibration. Raises InputError."""
    if config.calibration is None:
        return None
    from shapefit.io.readers.calibration import read_camera

    return read_camera(config.calibration, config.name)


def undistorted(images: LandmarkSet, calibrated: CalibratedCamera | None) -> LandmarkSet:
    """Return the images as a camera without distortion sees them, with what is known of it.

    The camera is the calibrated one or, without, the `camera_matrix` and `distortion` of the
    landmarks. A landmark that no point of the scene can have in this lens is unseen. Raises
    InputError for datasets that hold no cameras.
    """
    if calibrated is None and DISTORTION not in images.columns:
        return images
    if calibrated is not None:
        images = images.with_columns(whole=datasets_of(calibrated))
    distortion, images = images.columns.get(DISTORTION), images.with_whole_points()
    if distortion is None or CAMERA_MATRIX not in images.columns or not np.any(distortion):
        return images
    from shapefit.geometry.pinhole import undistort

    focal, centre = read_intrinsics(images, CAMERA_MATRIX)
    coefficients = find_coefficients(distortion)
    if images.y_axis == "up":
        coefficients = coefficients * np.where(np.arange(coefficients.shape[-1]) == 2, -1.0, 1.0)
    points = (images.landmarks - centre[..., None]) / focal[..., None]
    coefficients = np.broadcast_to(coefficients, (len(images), coefficients.shape[-1]))
    straight = centre[..., None] + focal[..., None] * undistort(points, coefficients)
    kind = "whole" if DISTORTION in images.whole else "columns"
    images = images.without([DISTORTION]).with_columns(**{kind: {REMOVED: distortion}})
    return images.replaced(landmarks=straight).with_whole_points()


def find_coefficients(values: Any) -> Floats:
    """Return coefficients of distortion (8,) or (n, 8). Raises InputError for other datasets."""
    from shapefit.geometry.pinhole import complete

    try:
        coefficients = complete(np.asarray(values, dtype=np.float64))
    except (ValueError, TypeError, IndexError):
        coefficients = np.full((1, 1, 1), np.nan)
    if coefficients.ndim > 2 or not np.isfinite(coefficients).all():
        fix = "give 4, 5 or 8 coefficients of OpenCV's model, for the file or for each image"
        raise input_error(DISTORTION, f"has the shape {np.shape(values)}, or is not finite", fix)
    return coefficients


def datasets_of(camera: CalibratedCamera) -> dict[str, Floats]:
    """Return what a calibration states of a camera, under the names of datasets of landmarks."""
    stated: Mapping[str, Floats | None] = {
        CAMERA_MATRIX: camera.matrix,
        DISTORTION: camera.distortion,
        IMAGE_SIZE: camera.size,
        "extrinsic_rotation": camera.rotation,
        "extrinsic_translation": camera.translation,
    }
    return {name: values for name, values in stated.items() if values is not None}


def warn_of_lens(head: Mapping[str, Any], calibrated: CalibratedCamera | None) -> tuple[str, ...]:
    """Warn of a distortion that cannot be removed, from what a file states."""
    stated = dict(head) | ({} if calibrated is None else datasets_of(calibrated))
    if not np.size(stated.get(DISTORTION, ())) or CAMERA_MATRIX in stated:
        return ()
    return (f"without `{CAMERA_MATRIX}` the `{DISTORTION}` of the landmarks stays in them",)
