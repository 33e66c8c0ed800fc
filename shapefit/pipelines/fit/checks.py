"""Checks of the sample: error bars, and the names of the landmarks.

Each may give a reason not to trust the file. Left and right exchanged in all frames cannot be
decided: a body seen so looks like that body turned to face the other way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from shapefit.arrays import evenly
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.io.skeletons import installed_skeletons
from shapefit.lifting.lift import Lifting
from shapefit.lifting.trust import (
    LIMITS,
    P_VALUE,
    START_DISTANCE,
    contradicts,
    median_distance,
)
from shapefit.pipelines.fit.lift import Lifter, lift_images, settings_of, with_p_values
from shapefit.pipelines.fit.sample import FEWEST, Sample
from shapefit.pipelines.joints import LandmarkMap, match_names

CALIBRATED = 60
"""Images of the sample whose landmarks are hidden in turn."""

DOUBTFUL = 0.25
"""Share of doubtful images from which other skeletons are tried; one that has less than half of
that share is named. Where names are right a few images in a hundred are doubtful."""

FEWEST_NAMES = 4
"""Landmarks of the dictionary that names must give; with fewer there is nothing to lift."""


class Bars(NamedTuple):
    """Error bars of a file, by a sample.

    growth     (p,) factors on the covariances of its landmarks, empty for none
    numbers    what is stored with the result, by name
    line       that says so
    warning    where the sample contradicts the dictionary, else ""
    """

    growth: tuple[float, ...] = ()
    numbers: Mapping[str, float] = {}
    line: str = ""
    warning: str = ""


def calibrate_bars(sample: Sample, lifting: Lifting, lifter: Lifter, bar_scale: float) -> Bars:
    """Calibrate the error bars on the sample; question it where it contradicts the dictionary.

    lifting, of the sample by the lifter; bar_scale, of all covariances without the factors of
    a report, which come on top.
    """
    if len(sample) < LIMITS.fewest_images:
        return Bars()
    from shapefit.lifting.posterior.calibration import calibrate

    rows, estimate = evenly(len(sample), CALIBRATED), lifting.estimate
    inliers = estimate.further["inlier_probability"]
    calibration = calibrate(
        lifting.problem.take(rows), estimate.rotation[rows], inliers[rows], settings_of(lifter)
    )
    visible = np.isfinite(inliers).sum(axis=1)
    distance = median_distance(estimate.further[START_DISTANCE], visible)
    numbers = {
        "calibration_kappa": calibration.kappa,
        "hidden_landmarks_inside": calibration.inside,
        "median_start_distance": distance,
    }
    line = f"of landmarks hidden in turn, {calibration.inside:.0%} lie in their 90% regions"
    if np.isfinite(distance):
        line += f"; median distance from the convex shape {distance:.2f}"
    warning = ""
    if contradicts(calibration.kappa, distance):
        fix = "are the names of the landmarks right, and does the dictionary have such shapes?"
        warning = no_trust(f"{line}; {fix}")
    return Bars(tuple(calibration.growth(bar_scale).tolist()), numbers, line, warning)


def no_trust(why: str) -> str:
    """Return the warning of a file that contradicts the dictionary."""
    return f"no shape of this file is to be trusted: {why}"


def check_skeleton(
    sample: Sample,
    lifting: Lifting,
    lifter: Lifter,
    dictionary: Dictionary,
    theta: Mapping[str, float],
) -> str:
    """Return a warning where many images are doubtful, but not by the names of another skeleton.

    dictionary and theta: that of all files, and the usual skeleton.
    """
    share = doubtful_share(lifting)
    if len(sample) < FEWEST or not share > DOUBTFUL:
        return ""
    shares = try_skeletons(sample, lifter, dictionary, theta)
    best = min(shares, key=lambda name: shares[name], default="")
    if not best or not shares[best] < share / 2:
        return ""
    return no_trust(
        f"{share:.0%} of a sample of {len(sample)} images contradict the names of their landmarks, "
        f"{shares[best]:.0%} those of {best}: is it {best}? Set `keypoints: {best}`"
    )


def doubtful_share(lifting: Lifting) -> float:
    """Return the share of images with a low p-value or far from their convex shape."""
    further = lifting.estimate.further
    visible = np.isfinite(further["inlier_probability"]).sum(axis=1)
    far = (further[START_DISTANCE] > LIMITS.max_distance) & (visible >= LIMITS.fewest_visible)
    doubtful = (further[P_VALUE] < LIMITS.min_p_value) | far
    return float(doubtful.mean()) if len(doubtful) else float("nan")


def try_skeletons(
    sample: Sample, lifter: Lifter, dictionary: Dictionary, theta: Mapping[str, float]
) -> dict[str, float]:
    """Return the share of doubtful images under the names of each other skeleton of that size."""
    names, shares = sample.in_file.landmark_names, dict[str, float]()
    for other in installed_skeletons().values():
        if len(other.landmark_names) != len(names) or other.landmark_names == names:
            continue
        try:
            matched = match_names(other.landmark_names, dictionary, other.name)
        except InputError:
            continue
        renamed = sample.in_file.replaced(landmark_names=other.landmark_names)
        images = matched.arrange(renamed, other.name)
        if images.visible().any(axis=0).sum() >= FEWEST_NAMES:
            mapped = LandmarkMap(matched.joints, theta, active=True)
            as_other = replace(lifter, dictionary=mapped.apply(matched.dictionary))
            lifting = with_p_values(lift_images(images, as_other), as_other)
            shares[other.name] = doubtful_share(lifting)
    return shares
