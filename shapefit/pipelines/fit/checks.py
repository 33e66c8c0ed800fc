"""Checks of the sample: error bars, the names of the landmarks, and their sides.

Each may give a reason not to trust the file. A body seen with its sides exchanged looks like that
body turned to face the other way, near and far exchanged. Seen from afar, and with a prior as
symmetric as bodies are, both are exactly as likely. What tells them apart is perspective (feet are
seen from above, what is nearer is larger), and that people walk forwards: sides are tried only
where legs are seen and feet step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.dictionary.from_2d.model import evenly
from shapefit.dictionary.model import Dictionary
from shapefit.errors import InputError
from shapefit.geometry.pinhole import depth_sign
from shapefit.io.skeletons import installed_skeletons
from shapefit.lifting.lift import Lifting
from shapefit.lifting.verdict import (
    LIMITS,
    NOT_OF_THE_CLASS,
    P_VALUE,
    START_DISTANCE,
    contradicts,
    median_distance,
)
from shapefit.pipelines.fit.lift import Lifter, lift_images, settings_of, with_p_values
from shapefit.pipelines.fit.sample import FEWEST, Sample, mean_gain
from shapefit.pipelines.joints import LandmarkMap, match_names

CALIBRATED = 60
"""Images of the sample whose landmarks are hidden in turn."""

DOUBTFUL = 0.25
"""Share of doubtful images from which other skeletons are tried; one that has less than half of
that share is named. Where names are right a few images in a hundred are doubtful."""

FEWEST_NAMES = 4
"""Landmarks of the dictionary that names must give; with fewer there is nothing to lift."""

LEGS = tuple(f"{side}{joint}" for joint in ("hip", "knee", "ankle") for side in "lr")
TRUNK = ("lhip", "rhip", "lshoulder", "rshoulder")

SEEN, STRIDE = 0.5, 0.15
"""Share of the images in which each joint of the legs must be seen. Standard deviation of how far
one ankle is ahead of the other, in lengths of a leg, from which feet step: 0.25 and more for people
who walk, below 0.1 for those who stand or sit."""

GROWTH, SIDES_GAIN = 0.02, 1.0
"""Growth of a body in the image over a step that counts as one nat against names under which it
walks backwards; nats an image by which exchanged sides must be likelier, and by two standard
errors. Over 55 clips of five bodies the right names were never less likely by more than 0.43 on
average over a clip; exchanged names of three bodies are noticed."""


class Reason(NamedTuple):
    """Why no image of a file is trusted, in a few words, and the warning about it."""

    reason: str
    warning: str


class Bars(NamedTuple):
    """Error bars of a file, by a sample.

    growth     (p,) factors on the covariances of its landmarks, empty for none
    numbers    what is stored with the result, by name
    line       that says so, and a reason where the sample contradicts the dictionary
    """

    growth: tuple[float, ...] = ()
    numbers: Mapping[str, float] = {}
    line: str = ""
    reason: Reason | None = None


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
    reason = None
    if contradicts(calibration.kappa, distance):
        fix = "are the names of the landmarks right, and does the dictionary have such shapes?"
        reason = no_trust(f"{line}; {fix}")
    return Bars(tuple(calibration.growth(bar_scale).tolist()), numbers, line, reason)


def no_trust(why: str) -> Reason:
    """Return why a file that contradicts the dictionary is not trusted."""
    return Reason(NOT_OF_THE_CLASS, f"no shape of this file is to be trusted: {why}")


def check_skeleton(
    sample: Sample,
    lifting: Lifting,
    lifter: Lifter,
    dictionary: Dictionary,
    theta: Mapping[str, float],
) -> Reason | None:
    """Question names where many images are doubtful, but not by the names of another skeleton.

    dictionary and theta: that of all files, and the usual skeleton.
    """
    share = doubtful_share(lifting)
    if len(sample) < FEWEST or not share > DOUBTFUL:
        return None
    shares = try_skeletons(sample, lifter, dictionary, theta)
    best = min(shares, key=lambda name: shares[name], default="")
    if not best or not shares[best] < share / 2:
        return None
    return no_trust(
        f"{share:.0%} of a sample of {len(sample)} images contradict the names of their landmarks, "
        f"{shares[best]:.0%} those of {best}: is it {best}? Set `keypoints: {best}`"
    )


def doubtful_share(lifting: Lifting) -> float:
    """Return the share of images with a low p-value or far from their convex shape."""
    further = lifting.estimate.further
    visible = np.isfinite(further["inlier_probability"]).sum(axis=1)
    far = (further[START_DISTANCE] > LIMITS.max_distance) & (visible >= LIMITS.fewest_seen)
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


def check_sides(sample: Sample, lifting: Lifting, lifter: Lifter) -> Reason | None:
    """Question sides where images are clearly likelier with left and right exchanged."""
    partner, images = lifter.dictionary.mirror_index, sample.images
    columns = {name: j for j, name in enumerate(lifter.dictionary.landmark_names)}
    if partner is None or not feet_step(sample, lifting.shapes, columns):
        return None
    from shapefit.pipelines.fit.sequences import exchange_sides

    exchanged = exchange_sides(images, partner, np.ones(len(images), dtype=bool))
    as_named, other = (lift_images(each, lifter, dependent=True) for each in (images, exchanged))
    evidence = (each.estimate.further["log_evidence"] for each in (as_named, other))
    gain, error, count = mean_gain(*evidence)
    walking = walks_backwards(sample, as_named.shapes, columns) / GROWTH
    if count < FEWEST or not gain + walking > max(SIDES_GAIN, 2 * error):
        return None
    return Reason(
        "left and right exchanged",
        f"left and right may be exchanged: with the names of the sides exchanged, a sample of "
        f"{count} images is likelier by {gain + walking:.1f} nats an image (perspective "
        f"{gain:+.1f}, walking forwards {walking:+.1f}); look at some results, "
        "and exchange the names by `rename` if they face the wrong way",
    )


def feet_step(sample: Sample, shapes: Floats, columns: Mapping[str, int]) -> bool:
    """Whether legs are seen in the sample, and one foot passes the other."""
    if not {*LEGS, *TRUNK} <= set(columns) or len(sample) < FEWEST:
        return False
    visible = sample.images.visible()[:, [columns[name] for name in LEGS]]
    lhip, rhip, _, _, lankle, rankle = (shapes[:, :, columns[name]] for name in LEGS)
    leg = np.linalg.norm(lankle - lhip, axis=1) + np.linalg.norm(rankle - rhip, axis=1)
    ahead = 2 * ((lankle - rankle) * facing(shapes, columns)).sum(axis=1) / leg
    return bool((visible.mean(axis=0) >= SEEN).all() and np.nanstd(ahead) > STRIDE)


def facing(shapes: Floats, columns: Mapping[str, int]) -> Floats:
    """Return unit vectors (n, 3) of where bodies face, from hips and shoulders."""
    lhip, rhip, lshoulder, rshoulder = (shapes[:, :, columns[name]] for name in TRUNK)
    forward = np.cross(lhip - rhip + lshoulder - rshoulder, lshoulder + rshoulder - lhip - rhip)
    unit: Floats = forward / np.linalg.norm(forward, axis=1, keepdims=True)
    return unit


def walks_backwards(sample: Sample, shapes: Floats, columns: Mapping[str, int]) -> float:
    """mean over pairs of (log s' - log s) (f_z + f_z') / 2: how much bodies walk backwards.

    s is the size of a body in the image, s' a step later; f the direction in which it faces, away
    from the camera where f_z > 0. 0 without pairs.
    """
    away = depth_sign(sample.images.y_axis or "down") * facing(shapes, columns)[:, 2]
    size = np.log(np.linalg.norm(shapes - shapes.mean(axis=2, keepdims=True), axis=(1, 2)))
    before, after = sample.pairs.T
    moved = (size[after] - size[before]) * (away[before] + away[after]) / 2
    return float(np.nanmean(moved)) if np.isfinite(moved).any() else 0.0
