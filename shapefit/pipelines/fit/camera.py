"""The camera of each image: its intrinsics, and the distortion of its lens, which is removed.

They come from the config, a calibration or the landmark files. Shapes are refined for them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.config.commands.fit_sections import CAMERA_MATRIX, ViewingConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.geometry.pinhole import Camera, depth_sign
from shapefit.io import LandmarkSet
from shapefit.lifting.lift import Lifting
from shapefit.lifting.options import PerspectiveOptions

if TYPE_CHECKING:
    from shapefit.io.foreign.calibration import CalibratedCamera


DISTORTION = "distortion"
"""Dataset (m,) or (n, m) of landmarks: coefficients of OpenCV's model, m = 4, 5 or 8."""

REMOVED = "removed_distortion"
"""Dataset of a result: the coefficients of the distortion that its landmarks no longer have."""

SMALLEST = 3e-4
"""Of the diagonal of the image by which a lens moves its corners that is worth a coefficient."""

LARGEST = 0.5
"""Of the diagonal that a lens of this model can move the corners by."""

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
    from shapefit.lifting.perspective.view import refine_view

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
    values = images.columns.get(name)
    place = f"camera.intrinsics: {name}"
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


def find_calibrated(config: ViewingConfig) -> CalibratedCamera | None:
    """Return the camera that the config names in a calibration. Raises InputError."""
    if config.calibration is None:
        return None
    from shapefit.io.foreign.calibration import read_camera

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
        stated = datasets(calibrated)
        images = images.with_columns(stated, of_file=stated)
    distortion = images.columns.get(DISTORTION)
    known = CAMERA_MATRIX in images.columns
    if distortion is None or not known or not np.any(distortion):
        return _with(images, images.landmarks)
    from shapefit.geometry.lens import undistort

    images = _with(images, images.landmarks)
    focal, centre = read_intrinsics(images, CAMERA_MATRIX)
    coefficients = find_coefficients(distortion)
    if images.y_axis == "up":
        coefficients = coefficients * np.where(np.arange(coefficients.shape[-1]) == 2, -1.0, 1.0)
    points = (images.landmarks - centre[..., None]) / focal[..., None]
    coefficients = np.broadcast_to(coefficients, (len(images), coefficients.shape[-1]))
    straight = centre[..., None] + focal[..., None] * undistort(points, coefficients)
    of_file = {REMOVED} if DISTORTION in images.of_file else set()
    images = images.without([DISTORTION]).with_columns({REMOVED: distortion}, of_file)
    return _with(images, straight)


def find_coefficients(values: Any) -> Floats:
    """Return coefficients of distortion (8,) or (n, 8). Raises InputError for other datasets."""
    from shapefit.geometry.lens import complete

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


def datasets(camera: CalibratedCamera) -> dict[str, Floats]:
    """Return what a calibration says of a camera, under the names of datasets of landmarks."""
    found: Mapping[str, Floats | None] = {
        CAMERA_MATRIX: camera.matrix,
        DISTORTION: camera.distortion,
        "image_size": camera.size,
        "extrinsic_rotation": camera.rotation,
        "extrinsic_translation": camera.translation,
    }
    return {name: values for name, values in found.items() if values is not None}


def find_doubts(head: Mapping[str, Any], calibrated: CalibratedCamera | None) -> tuple[str, ...]:
    """Warn of a distortion that no lens has, or that cannot be removed, from what a file says."""
    said = dict(head) | ({} if calibrated is None else datasets(calibrated))
    matrix, values = said.get(CAMERA_MATRIX), said.get(DISTORTION)
    if values is None or not np.size(values):
        return ()
    if matrix is None:
        lacking = f"without `{CAMERA_MATRIX}` the `{DISTORTION}` of the landmarks stays in them"
        return (lacking,)
    if np.shape(matrix) != (3, 3) or np.ndim(values) != 1 or not np.any(values):
        return ()
    return doubts(np.asarray(matrix), find_coefficients(values), said.get("image_size"))


def doubts(matrix: Floats, coefficients: Floats, size: Any) -> tuple[str, ...]:
    """Say what is wrong with a lens: it bends back in the image, or moves its corners oddly."""
    from shapefit.geometry.lens import undistort

    focal, centre = np.diag(matrix)[:2, None], matrix[:2, 2, None]
    width, height = 2 * centre[:, 0] if np.shape(size) != (2,) else np.asarray(size, float)
    across, along = np.meshgrid(np.linspace(0, width, 9), np.linspace(0, height, 9))
    pixels = np.stack([across.ravel(), along.ravel()])
    straight = centre + focal * undistort((pixels - centre) / focal, coefficients)
    lost = np.isnan(straight).any(axis=0)
    if lost.any():
        nearest = np.hypot(*(pixels - centre))[lost].min()
        return (
            f"the lens bends back inside the image, {nearest:.0f} px from its centre, which no "
            "lens does; landmarks beyond are hidden: check the distortion",
        )
    diagonal = float(np.hypot(width, height))
    moved = float(np.hypot(*(straight - pixels)).max())
    if moved < SMALLEST * diagonal:
        return (
            f"the lens moves no point of the image by more than {moved:.2g} px: Pose2Sim divides "
            "the distortion of a Qualisys file by 64 when it converts it; check the distortion",
        )
    if moved > LARGEST * diagonal:
        return (f"the lens moves corners of the image by {moved:.0f} px; check the distortion",)
    return ()


def _with(images: LandmarkSet, landmarks: Floats) -> LandmarkSet:
    unseen = np.isnan(landmarks).any(axis=1, keepdims=True)
    return images.replaced(landmarks=np.where(unseen, np.nan, landmarks))
