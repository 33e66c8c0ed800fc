"""What a fit settles by its first images, before it lifts any: the camera, and the skeleton."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from shapefit.config import FitConfig
from shapefit.dictionary.model import LEARNED_FROM, Dictionary
from shapefit.io import LandmarkSet, LandmarkSource
from shapefit.io.skeletons import THETA
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.camera import find_calibrated, straightened
from shapefit.pipelines.fit.chain import lift_images
from shapefit.pipelines.fit.default_camera import with_camera, without_camera
from shapefit.pipelines.fit.error_bars import with_calibration
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
    from shapefit.io.foreign.calibration import CalibratedCamera

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
    first = next(source.batches(FIRST))
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
) -> tuple[FitConfig, tuple[str, ...]]:
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
