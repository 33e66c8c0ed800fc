"""The camera of the images: the measured one, else an assumed one; and the lens, which is undone.

Intrinsics and distortion come from the config, a calibration or the files of the landmarks. Only
methods that look through the camera themselves take an assumed one; for the others weak perspective
stays, as in the paper's program.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.geometry.pinhole import ASSUMED_FOCAL, CAMERA_MATRIX, Camera, depth_sign
from shapefit.io import LandmarkSet
from shapefit.io.inputs import IMAGE_SUFFIXES, read_image_size
from shapefit.io.layout import UNKNOWN_UNIT

if TYPE_CHECKING:
    from shapefit.config import FitConfig
    from shapefit.config.commands.fit import CameraConfig
    from shapefit.io.readers.calibration import CalibratedCamera

COMMON_SIZES = ((1280, 720), (720, 1280), (1920, 1080), (1080, 1920), (3840, 2160), (2160, 3840))
"""Width and height in pixels of the videos that people take, the smallest first."""

LEAST_ANGLE = 0.1
"""Median extent of the landmarks, in focal lengths, below which perspective does not show: depths
within a body then differ by less than that share."""

CROPPED = 0.75
"""Median extent of the landmarks, as a share of what they ever cover, from which on an image of
unknown size may be a crop, whose centre says nothing."""

FEWEST_PIXELS = 100.0
"""Landmarks of no unit that are all positive and reach this far are taken for pixels."""

PIXELS = ("px", "pixel", "pixels")

BESIDE = 8
"""Images beside the landmarks whose sizes are compared."""

IMAGE_SIZE = "image_size"
"""Dataset (2,) or (n, 2) of the landmarks: width and height of the images in pixels."""

WEAK = {"focal": "none"}
"""Keys of `camera` where perspective cannot be known."""

ASK = "set `image_size` if you know it"

DISTORTION = "distortion"
"""Dataset (m,) or (n, m) of landmarks: coefficients of OpenCV's model, m = 4, 5 or 8."""

REMOVED = "removed_distortion"
"""Dataset of a result: the coefficients of the distortion that its landmarks no longer have."""

SMALLEST = 3e-4
"""Of the diagonal of the image by which a lens moves its corners that is worth a coefficient."""

LARGEST = 0.5
"""Of the diagonal that a lens of this model can move the corners by."""

NO_DATASETS = "give `camera.focal`, or landmarks in HDF5: CSV holds no datasets"


class ImageSize(NamedTuple):
    """Width and height (2,) of the images in pixels, and who says so."""

    size: Floats
    source: str


class Extent(NamedTuple):
    """Least and greatest coordinates (2,) of all landmarks; median diagonal of an image's."""

    least: Floats
    most: Floats
    diagonal: float


def choose_camera(
    config: FitConfig, images: LandmarkSet, *, of_people: bool, paths: Sequence[Path] = ()
) -> tuple[dict[str, Any], str]:
    """Return the keys of `camera` that `model: auto` means, and a line about them.

    A measured camera, of a calibration or the `camera_matrix` of the files, is taken as it is.
    Else the focal length is `ASSUMED_FOCAL` times the longer side of the image and the axis meets
    its centre, unless landmarks are no pixels or too small for perspective to show (`LEAST_ANGLE`).
    """
    if config.camera.model != "auto":
        return {}, ""
    if config.camera.calibration is not None:
        return {"focal": "files"}, "perspective camera: of the calibration"
    if CAMERA_MATRIX in images.columns:
        return take_measured(images)
    extent = find_extent(images)
    if extent is None:
        return WEAK, ""
    found = find_size(config, images, extent, paths, of_people=of_people)
    if isinstance(found, str):
        return WEAK, f"weak perspective: {found}; {ASK}"
    width, height = map(float, found.size)
    focal = ASSUMED_FOCAL * max(width, height)
    if extent.diagonal < LEAST_ANGLE * focal:
        return WEAK, "weak perspective: the landmarks cover little of the image"
    camera = {"focal": focal, "principal_point": (width / 2, height / 2)}
    return camera, (
        f"perspective camera: focal length {focal:.0f} px assumed, {ASSUMED_FOCAL} times the longer"
        f" side of the image, {width:.0f} x {height:.0f} ({found.source}); depths in metres rest"
        " on it; `camera.focal=none` does without"
    )


def take_measured(images: LandmarkSet) -> tuple[dict[str, Any], str]:
    """Take the camera matrix of the images; of one with a skew, what is left without it."""
    line = f"perspective camera: `{CAMERA_MATRIX}` of the files"
    K = np.asarray(images.columns[CAMERA_MATRIX])
    finite = K.shape == (3, 3) and K.dtype.kind in "iuf" and bool(np.isfinite(K).all())
    if finite and K[0, 1] != 0 and (np.diag(K)[:2] > 0).all():
        focal, centre = float(np.sqrt(K[0, 0] * K[1, 1])), (float(K[0, 2]), float(K[1, 2]))
        camera = {"focal": focal, "principal_point": centre}
        return camera, f"{line} without its skew: focal length {focal:.0f} px"
    read_intrinsics(images, CAMERA_MATRIX)
    return {"focal": "files"}, line


def find_extent(images: LandmarkSet) -> Extent | None:
    """Return how far landmarks reach; None where they are not in pixels, or single points."""
    w = np.where(images.seen()[:, None], images.landmarks, np.nan)
    seen = np.isfinite(w).all(axis=1)
    several = seen.sum(axis=1) > 1
    if not several.any():
        return None
    points = np.moveaxis(w, 1, 0)[:, seen]
    least, most = points.min(axis=1), points.max(axis=1)
    like_pixels = least.min() >= 0 and most.max() >= FEWEST_PIXELS
    if images.unit not in PIXELS and not (images.unit == UNKNOWN_UNIT and like_pixels):
        return None
    each = np.nanmax(w[several], axis=2) - np.nanmin(w[several], axis=2)
    return Extent(least, most, float(np.median(np.hypot(*each.T))))


def find_size(
    config: FitConfig,
    images: LandmarkSet,
    extent: Extent,
    paths: Sequence[Path],
    *,
    of_people: bool,
) -> ImageSize | str:
    """Return the size of the images, or why it is not known.

    That which the config states, or the landmarks, or the images at the `paths` of the landmarks;
    else, for people who are not cropped (`CROPPED`), the smallest common one that holds all.
    """
    if config.image_size is not None:
        return ImageSize(np.array(config.image_size), "as given")
    if IMAGE_SIZE in images.columns:
        sizes, source = np.asarray(images.columns[IMAGE_SIZE]), "of the files"
        of_numbers = sizes.dtype.kind in "iuf" and sizes.shape in ((2,), (len(images), 2))
        if not of_numbers or not (np.isfinite(sizes) & (sizes > 0)).all():
            return "the files state an impossible `image_size`"
    else:
        beside = {read_image_size(path) for path in images_beside(paths, images.items)} - {None}
        sizes, source = np.array(sorted(filter(None, beside))), "of the images beside"
    sizes = np.unique(sizes.reshape(-1, 2).astype(np.float64), axis=0)
    if len(sizes) > 1:
        return "images of several sizes"
    if len(sizes):
        return ImageSize(sizes[0], source)
    if not of_people:
        return "the size of the images is not known"
    if extent.diagonal > CROPPED * float(np.hypot(*extent.most)):
        return "images may be crops"
    holding = [size for size in COMMON_SIZES if (extent.most <= size).all()]
    if extent.least.min() < 0 or not holding:
        return "landmarks lie beyond the usual sizes of images"
    source = f"the smallest usual size that holds all landmarks: {ASK}"
    return ImageSize(np.array(holding[0], dtype=np.float64), source)


def images_beside(paths: Sequence[Path], items: Sequence[str]) -> list[Path]:
    """Return the first images that are called like files of landmarks, or items, beside them."""
    here = [path for path in paths if path.exists()]
    folders = {path if path.is_dir() else path.parent for path in here}
    there: dict[str, Path] = {}
    stems = {path.stem for path in paths}
    for folder in sorted(folders):
        for name in sorted(os.listdir(folder)):
            stem, suffix = os.path.splitext(name)
            if suffix.lower() in IMAGE_SUFFIXES:
                there.setdefault(stem, folder / name)
            else:
                stems.add(stem)
    if not there:
        return []
    stems |= {os.path.splitext(item.rpartition("/")[2])[0] for item in items}
    stems |= {stem.removesuffix("_keypoints") for stem in stems}
    return [path for stem, path in there.items() if stem in stems][:BESIDE]


def find_camera(images: LandmarkSet, config: CameraConfig) -> Camera:
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
