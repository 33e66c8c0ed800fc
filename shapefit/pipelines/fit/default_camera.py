"""The camera where none is given: perspective, with a focal length that cameras of people have.

Only methods that look through the camera themselves take it; for the others weak perspective stays,
as in the paper's program.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.config import FitConfig
from shapefit.config.commands.fit_sections import CAMERA_MATRIX
from shapefit.io import LandmarkSet
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.pipelines.fit.camera import read_intrinsics

FOCAL = 1.1
"""Focal length in longer sides of the image: an angle of view of 49 degrees across it. With it the
posterior does as well as with the true cameras of the man on the beam."""

LEAST_ANGLE = 0.1
"""Median extent of the landmarks, in focal lengths, below which perspective does not show: depths
within a body then differ by less than that share."""

CROPPED = 0.75
"""Median extent of the landmarks, as a share of what they ever cover, from which on an image of
unknown size may be a crop, whose centre says nothing."""

FEWEST_PIXELS = 100.0
"""Landmarks of no unit that are all positive and reach this far are taken for pixels."""

PIXELS = ("px", "pixel", "pixels")


class Covered(NamedTuple):
    """Size of the image (2,) and whether it is known, else what landmarks cover of it; extent."""

    size: Floats
    known: bool
    extent: float


def with_camera(config: FitConfig, images: LandmarkSet) -> tuple[FitConfig, tuple[str, ...]]:
    """Return the config with the camera that `auto` means for these images, and a line about it.

    A calibration is taken as it is, and the `camera_matrix` of the images nearly so. Else the focal
    length is `FOCAL` times the longer side of the image and the axis meets its centre, unless
    landmarks are no pixels, too small for perspective to show (`LEAST_ANGLE`), or may be crops
    (`CROPPED`).
    """
    camera = config.camera
    if camera.model != "auto":
        return config, ()
    if camera.calibration is not None:
        return _with(config, model="perspective"), ("perspective camera: of the calibration",)
    if CAMERA_MATRIX in images.columns:
        return _stated(config, images)
    covered = find_covered(images, camera.image_size)
    weak = _with(config, model="weak-perspective")
    if covered is None:
        return weak, ()
    focal = FOCAL * float(covered.size.max())
    if covered.extent < LEAST_ANGLE * focal:
        return weak, ("weak perspective: the landmarks cover little of the image",)
    if not covered.known and covered.extent > CROPPED * float(np.hypot(*covered.size)):
        return weak, ("weak perspective: images may be crops; set `camera.image_size`",)
    centre = (float(covered.size[0]) / 2, float(covered.size[1]) / 2)
    whose = "the image" if covered.known else "what the landmarks cover"
    line = (
        f"perspective camera: focal length {focal:.0f} px, {FOCAL} times the longer side of {whose}"
        f" ({covered.size[0]:.0f} x {covered.size[1]:.0f}); `camera.model=weak-perspective` "
        "does without"
    )
    return _with(config, model="perspective", focal=focal, principal_point=centre), (line,)


def _stated(config: FitConfig, images: LandmarkSet) -> tuple[FitConfig, tuple[str, ...]]:
    """Take the camera matrix of the images, without a skew, and with `FOCAL` where it is shorter.

    A wide lens close to a body would show its depths, if landmarks were exact; detected ones
    mislead more than that helps. Matrices of single images are taken as they are.
    """
    line = f"perspective camera: `{CAMERA_MATRIX}` of the files"
    matrix = np.asarray(images.columns[CAMERA_MATRIX])
    if matrix.shape != (3, 3) or matrix.dtype.kind not in "iuf" or not np.isfinite(matrix).all():
        read_intrinsics(images, CAMERA_MATRIX)
        return _with(config, model="perspective", intrinsics=CAMERA_MATRIX), (line,)
    covered = find_covered(images, config.camera.image_size)
    own = np.diag(matrix)[:2]
    least = 0.0 if covered is None or not covered.known else FOCAL * float(covered.size.max())
    if (own <= 0).any() or (own.min() >= least and matrix[0, 1] == 0):
        read_intrinsics(images, CAMERA_MATRIX)
        return _with(config, model="perspective", intrinsics=CAMERA_MATRIX), (line,)
    focal = max(float(np.sqrt(own.prod())), least)
    centre = (float(matrix[0, 2]), float(matrix[1, 2]))
    changed = _with(config, model="perspective", focal=focal, principal_point=centre)
    return changed, (f"{line}, with the focal length {focal:.0f} px",)


def without_camera(config: FitConfig) -> FitConfig:
    """Return the config with weak perspective where the model of the camera is open."""
    return _with(config, model="weak-perspective") if config.camera.model == "auto" else config


def find_covered(images: LandmarkSet, stated: tuple[float, float] | None) -> Covered | None:
    """Return the size of the images and the extent of their landmarks; None where not in pixels."""
    w = np.where(images.seen()[:, None], images.landmarks, np.nan)
    there = np.isfinite(w).all(axis=1)
    if not there.any():
        return None
    seen = np.moveaxis(w, 1, 0)[:, there]
    least, most = seen.min(axis=1), seen.max(axis=1)
    in_pixels = images.unit in PIXELS or (
        images.unit == UNKNOWN_UNIT and least.min() >= 0 and most.max() >= FEWEST_PIXELS
    )
    if not in_pixels:
        return None
    several = there.sum(axis=1) > 1
    if not several.any():
        return None
    each = np.nanmax(w[several], axis=2) - np.nanmin(w[several], axis=2)
    extent = float(np.median(np.hypot(*each.T)))
    size = stated if stated is not None else images.columns.get("image_size")
    if size is not None and np.shape(size) == (2,):
        known = np.asarray(size, dtype=np.float64)
        return Covered(known, True, extent) if (known > 0).all() else None
    return Covered(most, False, extent) if least.min() >= 0 else None


def _with(config: FitConfig, **changes: object) -> FitConfig:
    camera = config.camera.model_copy(update=changes)
    return config.model_copy(update={"camera": camera})
