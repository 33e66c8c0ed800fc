"""The camera of the images: the measured one, else an assumed one; and the lens, which is undone.

Intrinsics and distortion come from the config, a calibration or the files of the landmarks. Only
methods that look through the camera themselves take an assumed one; for the others weak perspective
stays, as in the paper's program.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.geometry.pinhole import ASSUMED_FOCAL, CAMERA_MATRIX, Camera, depth_sign
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

PIXELS = ("px", "pixel", "pixels")

IMAGE_SIZE = "image_size"
"""Dataset (2,) or (n, 2) of the landmarks: width and height of the images in pixels."""

WEAK = {"focal": "none"}
"""Keys of `camera` where perspective cannot be known."""

DISTORTION = "distortion"
"""Dataset (m,) or (n, m) of landmarks: coefficients of OpenCV's model, m = 4, 5 or 8."""

REMOVED = "removed_distortion"
"""Dataset of a result: the coefficients of the distortion that its landmarks no longer have."""

SMALLEST = 3e-4
"""Of the diagonal of the image by which a lens moves its corners that is worth a coefficient."""

LARGEST = 0.5
"""Of the diagonal that a lens of this model can move the corners by."""

NO_DATASETS = "give `camera.focal`, or landmarks in HDF5: CSV holds no datasets"


class Intrinsics(NamedTuple):
    """Where cameras are known from: a focal length of all images, or a dataset of the landmarks.

    centre (2,), the principal point, overrides that of the dataset.
    """

    focal: float = 0.0
    centre: tuple[float, float] | None = None
    dataset: str | None = None

    @staticmethod
    def of(config: CameraConfig) -> Intrinsics | None:
        """Return those that a config states, None for weak perspective."""
        if config.model != "perspective":
            return None
        if isinstance(config.focal, float | int):
            return Intrinsics(config.focal, config.principal_point)
        return Intrinsics(centre=config.principal_point, dataset=CAMERA_MATRIX)


def choose_camera(
    config: FitConfig, first: Callable[[], LandmarkSet], *, from_landmarks: bool
) -> tuple[dict[str, Any], str]:
    """Return the keys of `camera` that the config leaves open, and a line about the camera.

    A measured camera, of a calibration or the `camera_matrix` of the files, is taken as it is. The
    optical axis meets the centre of the image, and the focal length is `ASSUMED_FOCAL` times its
    longer side, unless landmarks are not in pixels or too small for perspective to show
    (`LEAST_ANGLE`). Without the size of the image the camera is weak perspective. A class that was
    learned `from_landmarks` under weak perspective is seen so, but through a calibration: it has
    the sizes that weak perspective gave it, and a matrix of the files has told near from far
    already. `first` reads the first images. Raises InputError for a focal length without a size.
    """
    given, method = config.camera, METHODS[config.method]
    calibrated = given.calibration is not None and method.perspective != "none"
    is_open = given.focal == "auto" and not method.has_prior and not calibrated
    if given.focal == "none" or is_open:
        return WEAK, "weak perspective"
    if calibrated:
        return {"focal": "files"}, "perspective, of the calibration"
    if given.focal == "files":
        return take_measured(config, first())
    if isinstance(given.focal, float | int):
        centre = given.principal_point or find_centre(config, first())
        line = f"focal length {given.focal:.5g} px, principal point {centre[0]:g}, {centre[1]:g}"
        return {"principal_point": centre}, line
    if from_landmarks:
        return WEAK, "weak perspective, by which the class was learned"
    images = first()
    if CAMERA_MATRIX in images.columns:
        return take_measured(config, images)
    if images.unit not in (*PIXELS, UNKNOWN_UNIT):
        return WEAK, f"weak perspective: landmarks are in {images.unit}, not in pixels"
    size = find_size(config, images)
    if isinstance(size, str):
        return WEAK, f"weak perspective, as {size}; exact positions in metres need --image-size"
    width, height = size
    focal = ASSUMED_FOCAL * max(size)
    if find_extent(images) < LEAST_ANGLE * focal:
        return WEAK, "weak perspective: the landmarks cover little of the image"
    line = (
        f"focal length {focal:.0f} px (assumed: set --focal), image {width:.0f} x {height:.0f}; "
        "`camera.focal=none` does without"
    )
    return {"focal": focal, "principal_point": (width / 2, height / 2)}, line


def take_measured(config: FitConfig, images: LandmarkSet) -> tuple[dict[str, Any], str]:
    """Take the camera matrix of the images; of one with a skew, what is left without it.

    Where it holds focal lengths alone, the principal point is the centre of the image.
    """
    line = f"perspective, `{CAMERA_MATRIX}` of the files"
    K = np.asarray(images.columns.get(CAMERA_MATRIX, np.nan))
    finite = K.shape == (3, 3) and K.dtype.kind in "iuf" and bool(np.isfinite(K).all())
    if finite and K[0, 1] != 0 and (np.diag(K)[:2] > 0).all():
        focal, centre = float(np.sqrt(K[0, 0] * K[1, 1])), (float(K[0, 2]), float(K[1, 2]))
        skewless = {"focal": focal, "principal_point": centre}
        return skewless, f"{line} without its skew: focal length {focal:.0f} px"
    read_intrinsics(images, CAMERA_MATRIX)
    camera: dict[str, Any] = {"focal": "files"}
    if K.ndim < 2 and config.camera.principal_point is None:
        camera["principal_point"] = find_centre(config, images)
    return camera, line


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
    if len(sizes) != 1:
        return "the images have several sizes"
    return float(sizes[0, 0]), float(sizes[0, 1])


def find_extent(images: LandmarkSet) -> float:
    """Return the median diagonal of the landmarks of an image; inf where none has several."""
    w = np.where(images.seen()[:, None], images.landmarks, np.nan)
    several = np.isfinite(w).all(axis=1).sum(axis=1) > 1
    if not several.any():
        return np.inf
    each = np.nanmax(w[several], axis=2) - np.nanmin(w[several], axis=2)
    return float(np.median(np.hypot(*each.T)))


def find_camera(images: LandmarkSet, known: Intrinsics) -> Camera:
    """Return focal lengths and principal points of the images.

    Raises InputError for a dataset that does not exist, has another shape, or holds what no camera
    has.
    """
    n = len(images)
    if known.dataset is None:
        focal, centre = np.full((n, 2), known.focal), np.zeros((n, 2))
    else:
        focal, centre = read_intrinsics(images, known.dataset)
    if known.centre is not None:
        centre = np.tile(np.array(known.centre), (n, 1))
    return Camera(focal, centre, depth_sign(images.y_axis))


def read_intrinsics(images: LandmarkSet, name: str) -> tuple[Floats, Floats]:
    """Return focal (n, 2) and principal point (n, 2) from a dataset of the landmark files."""
    values = images.columns.get(name)
    place = f"camera.focal: {name}"
    if values is None:
        there = ", ".join(sorted(images.further))
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


def find_calibrated(config: CameraConfig) -> CalibratedCamera | None:
    """Return the camera that the config names in a calibration. Raises InputError."""
    if config.calibration is None:
        return None
    from shapefit.io.readers.calibration import read_camera

    return read_camera(config.calibration, config.name)


def straightened(images: LandmarkSet, calibrated: CalibratedCamera | None) -> LandmarkSet:
    """Return the images as a camera without distortion sees them, with what is known of it.

    The camera is the calibrated one or, without, the `camera_matrix` and `distortion` of the
    landmarks. A landmark that no point of the scene can have in this lens is unseen. Raises
    InputError for datasets that hold no cameras.
    """
    if calibrated is None and DISTORTION not in images.columns:
        return images
    if calibrated is not None:
        stated = datasets_of(calibrated)
        images = images.with_columns(whole=stated)
    distortion = images.columns.get(DISTORTION)
    images = images.with_whole_points()
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
        finite = bool(np.isfinite(coefficients).all()) and coefficients.ndim <= 2
    except (ValueError, TypeError, IndexError):
        finite = False
    if not finite:
        found = f"has the shape {np.shape(values)}, or is not finite"
        fix = "give 4, 5 or 8 coefficients of OpenCV's model, for the file or for each image"
        raise input_error(DISTORTION, found, fix)
    return coefficients


def datasets_of(camera: CalibratedCamera) -> dict[str, Floats]:
    """Return what a calibration says of a camera, under the names of datasets of landmarks."""
    found: Mapping[str, Floats | None] = {
        CAMERA_MATRIX: camera.matrix,
        DISTORTION: camera.distortion,
        IMAGE_SIZE: camera.size,
        "extrinsic_rotation": camera.rotation,
        "extrinsic_translation": camera.translation,
    }
    return {name: values for name, values in found.items() if values is not None}


def doubts_of_lens(head: Mapping[str, Any], calibrated: CalibratedCamera | None) -> tuple[str, ...]:
    """Warn of a distortion that no lens has, or that cannot be removed, from what a file says.

    A lens neither bends back in the image nor moves its corners by next to nothing or by much.
    """
    said = dict(head) | ({} if calibrated is None else datasets_of(calibrated))
    matrix, values, size = (said.get(name) for name in (CAMERA_MATRIX, DISTORTION, IMAGE_SIZE))
    if values is None or not np.size(values):
        return ()
    if matrix is None:
        return (f"without `{CAMERA_MATRIX}` the `{DISTORTION}` of the landmarks stays in them",)
    if np.shape(matrix) != (3, 3) or np.ndim(values) != 1 or not np.any(values):
        return ()
    from shapefit.geometry.pinhole import undistort

    K = np.asarray(matrix)
    focal, centre = np.diag(K)[:2, None], K[:2, 2, None]
    width, height = (
        2 * centre[:, 0] if size is None or np.shape(size) != (2,) else np.asarray(size, float)
    )
    across, along = np.meshgrid(np.linspace(0, width, 9), np.linspace(0, height, 9))
    pixels = np.stack([across.ravel(), along.ravel()])
    straight = centre + focal * undistort((pixels - centre) / focal, find_coefficients(values))
    lost = np.isnan(straight).any(axis=0)
    if lost.any():
        nearest = np.hypot(*(pixels - centre))[lost].min()
        return (
            f"the lens bends back inside the image, {nearest:.0f} px from its centre, which no "
            "lens does; landmarks beyond are hidden: check the distortion",
        )
    moved, diagonal = float(np.hypot(*(straight - pixels)).max()), float(np.hypot(width, height))
    if moved < SMALLEST * diagonal:
        return (
            f"the lens moves no point of the image by more than {moved:.2g} px: Pose2Sim divides "
            "the distortion of a Qualisys file by 64 when it converts it; check the distortion",
        )
    if moved > LARGEST * diagonal:
        return (f"the lens moves corners of the image by {moved:.0f} px; check the distortion",)
    return ()
