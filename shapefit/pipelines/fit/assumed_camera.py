"""Which camera a fit looks through: the measured one, else an assumed one, else none.

Only methods that look through the camera themselves take one; for the others weak perspective
stays, as in the paper's program.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.config import FitConfig
from shapefit.config.commands.fit_sections import CAMERA_MATRIX
from shapefit.io import LandmarkSet
from shapefit.io.image_size import IMAGE_SUFFIXES, read_image_size
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.pipelines.fit.camera import read_intrinsics
from shapefit.stores import UrlPath

FOCAL = 1.1
"""Focal length in longer sides of the image: an angle of view of 49 degrees across it. With it the
posterior does as well as with the true cameras of the man on the beam."""

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

ASK = "set `image_size` if you know it"


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
) -> tuple[FitConfig, tuple[str, ...]]:
    """Return the config with the camera that `camera.model: auto` means, and a line about it.

    A measured camera, of a calibration or the `camera_matrix` of the files, is taken as it is.
    Else the focal length is `FOCAL` times the longer side of the image and the axis meets its
    centre, unless landmarks are no pixels or too small for perspective to show (`LEAST_ANGLE`). Of
    an image whose size nobody states: that of the images at the `paths` of the landmarks; else, for
    people who are not cropped (`CROPPED`), the smallest common one that holds all landmarks.
    """
    camera = config.camera
    if camera.model != "auto":
        return config, ()
    if camera.calibration is not None:
        return _with(config, model="perspective"), ("perspective camera: of the calibration",)
    if CAMERA_MATRIX in images.columns:
        return _measured(config, images)
    weak = without_camera(config)
    extent = find_extent(images)
    if extent is None:
        return weak, ()
    known = find_size(config, images, paths)
    if isinstance(known, str):
        return weak, (f"weak perspective: {known}; {ASK}",)
    if known is None and not of_people:
        return weak, (f"weak perspective: the size of the images is not known; {ASK}",)
    if known is None and extent.diagonal > CROPPED * float(np.hypot(*extent.most)):
        return weak, (f"weak perspective: images may be crops; {ASK}",)
    chosen = known or assume_size(extent)
    if chosen is None:
        return weak, (f"weak perspective: landmarks lie beyond the usual sizes of images; {ASK}",)
    (width, height), source = chosen
    focal = FOCAL * float(max(width, height))
    if extent.diagonal < LEAST_ANGLE * focal:
        return weak, ("weak perspective: the landmarks cover little of the image",)
    line = (
        f"perspective camera: focal length {focal:.0f} px assumed, {FOCAL} times the longer side of"
        f" the image, {width:.0f} x {height:.0f} ({source}); depths in metres rest on it; "
        "`camera.model=weak-perspective` does without"
    )
    centre = (float(width) / 2, float(height) / 2)
    return _with(config, model="perspective", focal=focal, principal_point=centre), (line,)


def without_camera(config: FitConfig) -> FitConfig:
    """Return the config with weak perspective where the model of the camera is open."""
    return _with(config, model="weak-perspective") if config.camera.model == "auto" else config


def find_extent(images: LandmarkSet) -> Extent | None:
    """Return how far landmarks reach; None where they are not in pixels, or single points."""
    w = np.where(images.seen()[:, None], images.landmarks, np.nan)
    seen = np.isfinite(w).all(axis=1)
    several = seen.sum(axis=1) > 1
    if not several.any():
        return None
    points = np.moveaxis(w, 1, 0)[:, seen]
    least, most = points.min(axis=1), points.max(axis=1)
    in_pixels = images.unit in PIXELS or (
        images.unit == UNKNOWN_UNIT and least.min() >= 0 and most.max() >= FEWEST_PIXELS
    )
    if not in_pixels:
        return None
    each = np.nanmax(w[several], axis=2) - np.nanmin(w[several], axis=2)
    return Extent(least, most, float(np.median(np.hypot(*each.T))))


def find_size(
    config: FitConfig, images: LandmarkSet, paths: Sequence[Path]
) -> ImageSize | str | None:
    """Return the size that config, landmarks or the images beside them state.

    None where nobody does, a text where it is no single one.
    """
    stated = config.input.image_size
    if stated is not None:
        return ImageSize(np.array(stated), "as given")
    if IMAGE_SIZE in images.columns:
        sizes = np.asarray(images.columns[IMAGE_SIZE])
        of_numbers = sizes.dtype.kind in "iuf" and sizes.shape in ((2,), (len(images), 2))
        if not of_numbers or not (np.isfinite(sizes) & (sizes > 0)).all():
            return "the files state an impossible `image_size`"
        sizes = np.unique(sizes.reshape(-1, 2).astype(np.float64), axis=0)
        return ImageSize(sizes[0], "of the files") if len(sizes) == 1 else "images of several sizes"
    beside = {read_image_size(path) for path in images_beside(paths, images.items)} - {None}
    if len(beside) > 1:
        return "images of several sizes"
    return next((ImageSize(np.array(size, float), "of the images beside") for size in beside), None)


def assume_size(extent: Extent) -> ImageSize | None:
    """Return the smallest common size that holds all landmarks; None where none does."""
    if extent.least.min() < 0:
        return None
    fitting = (size for size in COMMON_SIZES if (extent.most <= size).all())
    size = next(fitting, None)
    if size is None:
        return None
    text = f"the smallest usual size that holds all landmarks: {ASK}"
    return ImageSize(np.array(size, dtype=np.float64), text)


def images_beside(paths: Sequence[Path], items: Sequence[str]) -> list[Path]:
    """Return the first images that are called like files of landmarks, or items, beside them."""
    folders = {path if path.is_dir() else path.parent for path in paths if _is_here(path)}
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


def _is_here(path: Path) -> bool:
    return not isinstance(path, UrlPath) and path.exists()


def _measured(config: FitConfig, images: LandmarkSet) -> tuple[FitConfig, tuple[str, ...]]:
    """Take the camera matrix of the images; of one with a skew, what is left without it."""
    line = f"perspective camera: `{CAMERA_MATRIX}` of the files"
    matrix = np.asarray(images.columns[CAMERA_MATRIX])
    if matrix.shape == (3, 3) and matrix.dtype.kind in "iuf" and matrix[0, 1] != 0:
        own = np.diag(matrix)[:2]
        if np.isfinite(matrix).all() and (own > 0).all():
            focal = float(np.sqrt(own.prod()))
            centre = (float(matrix[0, 2]), float(matrix[1, 2]))
            line += f" without its skew: focal length {focal:.0f} px"
            return _with(config, model="perspective", focal=focal, principal_point=centre), (line,)
    read_intrinsics(images, CAMERA_MATRIX)
    return _with(config, model="perspective", intrinsics=CAMERA_MATRIX), (line,)


def _with(config: FitConfig, **changes: object) -> FitConfig:
    camera = config.camera.model_copy(update=changes)
    return config.model_copy(update={"camera": camera})
