"""Checks on a sample of images, before any is lifted: does what is stated agree with them?

A check takes the sample, lifts it in other ways, and compares the log evidence log p(w) of each
image. It returns a sentence, or nothing; `check_sample` calls them all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSet
from shapefit.pipelines.fit.camera import find_camera
from shapefit.pipelines.fit.chain import lift_images
from shapefit.pipelines.fit.plan import choose_chain
from shapefit.pipelines.joints import MEANS, Joints, Mapped, named_as_joints

FACTORS = (0.25, 0.5, 2.0, 4.0)
"""Of the focal length, that are tried beside the measured one."""

LEAST_GAIN = 2.0
"""Log evidence an image, beyond two standard errors, that speaks against what is stated. Half the
focal length gained 0.8 on a man with a camera that was measured rightly."""


@dataclass(frozen=True)
class Sample:
    """Images as their files have them, without distortion, and what they are lifted with."""

    images: LandmarkSet
    config: FitConfig
    dictionary: Dictionary
    joints: Joints

    def log_evidence(
        self,
        images: LandmarkSet | None = None,
        *,
        theta: dict[str, float] | None = None,
        **camera: Any,
    ) -> Floats:
        """Return log p(w) (n,) of the images, or of others, with changed keys of the camera."""
        own = self.images if images is None else images
        known = self.dictionary.landmark_names
        arranged = named_as_joints(own, self.joints, "landmarks").arrange(
            known, "landmarks", leave_out=True
        )
        looks = self.config.camera.model_copy(update=camera)
        config = self.config.model_copy(update={"method": "posterior", "camera": looks})
        used = theta or {**MEANS, **(self.config.theta or {})}
        seen = Mapped(self.joints, used, bool(self.joints.stand_ins)).see(self.dictionary)
        lifting = lift_images(arranged, seen, choose_chain(config, self.dictionary))
        found: Floats = lifting.estimate.further["log_evidence"]
        return found


def check_sample(sample: Sample, *, camera: bool) -> tuple[str, ...]:
    """Return a warning for each thing that the images speak against; `camera` was measured."""
    if len(sample.images) < 2:
        return ()
    return check_camera(sample) if camera else ()


def check_camera(sample: Sample) -> tuple[str, ...]:
    """Warn where images speak for another focal length than the measured one, which is obeyed."""
    stated = find_camera(sample.images, sample.config.camera)
    focal = float(np.median(stated.focal))
    centre = tuple(map(float, np.median(stated.centre, axis=0)))
    before = sample.log_evidence()
    tried = {
        factor: gain_of(
            sample.log_evidence(
                focal=factor * focal, intrinsics=None, calibration=None, principal_point=centre
            ),
            before,
        )
        for factor in FACTORS
    }
    factor = max(tried, key=lambda each: tried[each][0])
    mean, error = tried[factor]
    if not mean > LEAST_GAIN + 2 * error:
        return ()
    x, y = centre
    return (
        f"the landmarks speak against the measured camera, which is obeyed: with a focal length of "
        f"{factor * focal:.0f} px in place of {focal:.0f} px their log evidence is {mean:.1f} an "
        "image higher; if the camera is wrong, set `camera: {model: perspective, "
        f"focal: {factor * focal:.0f}, principal_point: [{x:.0f}, {y:.0f}]}}`",
    )


def gain_of(other: Floats, before: Floats) -> tuple[float, float]:
    """Return the mean gain of log evidence (n,) and its standard error."""
    gain = (other - before)[np.isfinite(other - before)]
    if len(gain) < 2:
        return 0.0, np.inf
    return float(gain.mean()), float(gain.std() / np.sqrt(len(gain)))
