"""What a fit settles by its first images, before it lifts any: camera, skeleton, and error bars."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.config import FitConfig
from shapefit.config.commands.fit_sections import CAMERA_MATRIX
from shapefit.dictionary.model import LEARNED_FROM, Dictionary
from shapefit.errors import input_error
from shapefit.io import LandmarkSet, LandmarkSource
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.skeletons import THETA
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.camera import find_calibrated, read_intrinsics, straightened
from shapefit.pipelines.fit.chain import lift_images
from shapefit.pipelines.fit.plan import check_needs, choose_chain
from shapefit.pipelines.items import spread
from shapefit.pipelines.joints import (
    MEANS,
    Joints,
    Mapped,
    find_joints,
    named_as_joints,
    of_files,
)

if TYPE_CHECKING:
    from shapefit.io.motion.calibration import CalibratedCamera

Theta = Mapping[str, float]

STEPS = (-0.2, -0.1, 0.0, 0.1, 0.2)
"""Of the logarithm of a parameter, tried about its mean, and half of them about the best."""

IMAGES = 20
"""Images that are asked, spread over those that are looked at."""

FEWEST_SEEN = 8
"""Landmarks of an image that is asked."""


class Found(NamedTuple):
    """A theta, and the standard deviations of the logarithms of its parameters."""

    theta: dict[str, float]
    spread: dict[str, float]


def find_theta(evidence: Callable[[Theta], float], names: Sequence[str], fixed: Theta) -> Found:
    """Maximise the posterior of the named parameters, one after the other, twice.

    evidence is log p(w | theta); `fixed` parameters stay. Each is taken to the top of the parabola
    through the best value tried and its neighbours, whose curvature gives its spread.
    """
    theta = {name: parameter.mean for name, parameter in THETA.items()} | dict(fixed)
    spread: dict[str, float] = {}
    for factor in (1.0, 0.5):
        for name in names:
            if name in fixed:
                continue
            mean, wide = THETA[name].mean, THETA[name].spread
            tried = np.log(theta[name]) + factor * np.array(STEPS)
            values = np.array(
                [
                    evidence(theta | {name: float(np.exp(x))})
                    - 0.5 * ((x - np.log(mean)) / wide) ** 2
                    for x in tried
                ]
            )
            best = min(max(int(np.argmax(values)), 1), len(tried) - 2)
            below, at, above = values[best - 1 : best + 2]
            step = tried[1] - tried[0]
            curvature = (2 * at - below - above) / step**2
            top = tried[int(np.argmax(values))]
            if curvature > 0:
                top = tried[best] + np.clip((above - below) / (2 * step * curvature), -step, step)
                spread[name] = float(curvature**-0.5)
            theta[name] = float(np.exp(top))
    return Found(theta, spread)


FIRST = 1024
"""Images that are looked at: the same whatever the chunks and parts."""


Settled = tuple[FitConfig, tuple[str, ...]]
"""A config with nothing left open, and lines about what was found."""


def plan_settling(config: FitConfig, dictionary: Dictionary) -> Callable[[LandmarkSource], Settled]:
    """Return what settles a config by its images; only methods with a prior look at them.

    Raises InputError where the dictionary lacks what the method needs, and as `find_calibrated`.
    """
    check_needs(config, dictionary)
    calibrated = find_calibrated(config.camera)
    if METHODS[config.method].has_prior:
        return partial(settle, config, dictionary, calibrated)
    settled = without_camera(config)
    return lambda _: (settled, ())


def settle(
    config: FitConfig,
    dictionary: Dictionary,
    calibrated: CalibratedCamera | None,
    source: LandmarkSource,
) -> Settled:
    """Settle the camera, then the skeleton in the view of it.

    Shapes that were learned of landmarks under weak perspective are seen so unless a camera is
    given.
    """
    first = next(source.chunks(FIRST))
    config, of_bars = with_calibration(config)
    if LEARNED_FROM in dictionary.provenance and config.camera.calibration is None:
        config = without_camera(config)
    images = straightened(first, calibrated)
    config, of_camera = with_camera(config, images)
    dictionary = of_files(dictionary, source.head.landmark_names)
    joints = find_joints(source.head.landmark_names, dictionary.landmark_names)
    config, of_skeleton = with_theta(config, images, dictionary, joints)
    return config, of_camera + of_skeleton + of_bars


def with_theta(
    config: FitConfig, images: LandmarkSet, dictionary: Dictionary, joints: Joints
) -> Settled:
    """Return the config with the parameters of the skeleton: as given, else found, else usual.

    They are found where the method has a prior over shapes.
    """
    given: Theta = config.theta or {}
    names = [name for name in joints.parameters if name not in given]
    seen = np.flatnonzero(images.seen().sum(axis=1) >= FEWEST_SEEN)
    if not METHODS[config.method].has_prior or not joints.stand_ins:
        return config, ()
    if not names or not len(seen):
        return config.model_copy(update={"theta": {**MEANS, **given}}), ()
    some = images.take(seen[list(spread(IMAGES, len(seen)))])
    asked = named_as_joints(some, joints, "landmarks").arrange(
        dictionary.landmark_names, "landmarks", leave_out=True
    )
    single = config.model_copy(update={"method": "posterior"})
    chain = choose_chain(single, dictionary)

    def evidence(theta: Theta) -> float:
        lifting = lift_images(asked, Mapped(joints, theta, True).see(dictionary), chain)
        return float(np.nansum(lifting.estimate.further["log_evidence"]))

    found = find_theta(evidence, names, given)
    told = ", ".join(
        f"{name} {found.theta[name]:.2f}"
        + (f" +- {found.theta[name] * found.spread[name]:.2f}" if name in found.spread else "")
        for name in names
    )
    return config.model_copy(update={"theta": found.theta}), (f"skeleton: {told}",)


def with_calibration(config: FitConfig) -> Settled:
    """Return the config with covariances as much wider as `posterior.calibration` says, and a line.

    By the factors of its method, or of the only one of the report. Raises InputError for a file
    that has none.
    """
    path = config.posterior.calibration
    if path is None:
        return config, ()
    try:
        factors = json.loads(path.read_text(encoding="utf-8"))
        name = config.method if config.method in factors else next(iter(factors))
        half, most = (factors[name][level] for level in ("50%", "90%"))
        known = None in (half, most) or (half > 0 and most > 0)
    except (OSError, ValueError, KeyError, TypeError, StopIteration):
        known = False
    if not known:
        found = "holds no factors of error bars"
        raise input_error(path, found, "give error_bars.json of a report of eval")
    if name != config.method and len(factors) > 1:
        found = f"has factors of {', '.join(factors)}, not of {config.method}"
        raise input_error(path, found, f"judge one result alone, or call it {config.method}")
    if None in (half, most):
        found = "has no factor: too few landmarks, or error bars that are far too narrow"
        raise input_error(path, found, "judge more images, or with a larger `posterior.widening`")
    widening = config.posterior.widening * most**2
    posterior = config.posterior.model_copy(update={"widening": widening, "calibration": None})
    line = (
        f"error bars {most:.2f} times as wide, by {path.name}: 90% of that truth is in the 90% "
        f"ellipsoids, 50% in {half / most:.2f} times the 50% ellipsoids"
    )
    return config.model_copy(update={"posterior": posterior}), (line,)


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

    That is a perspective one with a focal length that cameras of people have, for methods that look
    through the camera themselves; for the others weak perspective stays.

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
    if CAMERA_MATRIX in images.extras:
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
    matrix = np.asarray(images.extras[CAMERA_MATRIX])
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
    size = stated if stated is not None else images.extras.get("image_size")
    if size is not None and np.shape(size) == (2,):
        known = np.asarray(size, dtype=np.float64)
        return Covered(known, True, extent) if (known > 0).all() else None
    return Covered(most, False, extent) if least.min() >= 0 else None


def _with(config: FitConfig, **changes: object) -> FitConfig:
    camera = config.camera.model_copy(update=changes)
    return config.model_copy(update={"camera": camera})
