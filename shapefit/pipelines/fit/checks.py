"""Checks on a sample of the images, before any is lifted: does what is stated agree with them?

A sample is lifted in other ways, too, and the log evidence log p(w) of each image is compared:
through other focal lengths than the measured one, under other names of the landmarks, and with left
and right exchanged. Each check returns a sentence, or nothing.

Left and right: a body seen with its sides exchanged looks like that body turned to face the other
way, near and far exchanged. Seen from afar, and with a prior as symmetric as bodies are, both are
exactly as likely, whatever knees and elbows do. What tells them apart is perspective (feet
are seen from above, what is nearer is larger), and that people walk forwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.config import FitConfig
from shapefit.dictionary.from_2d.model import evenly
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.pinhole import depth_sign
from shapefit.io import LandmarkSet
from shapefit.io.skeletons import Skeleton, installed_skeletons
from shapefit.lifting.lift import Lifting
from shapefit.lifting.verdict import MIN_P_VALUE
from shapefit.pipelines.fit.camera import find_camera
from shapefit.pipelines.fit.lift import judge, lift_images
from shapefit.pipelines.joints import MEANS, LandmarkMap, find_joints, named_as_joints, of_files

FACTORS = (0.25, 0.5, 2.0, 4.0)
"""Of the focal length, that are tried beside the measured one."""

LEAST_GAIN = 2.0
"""Log evidence an image, beyond two standard errors, that speaks against a measured camera. Half
the focal length gained 0.8 on a man with a camera that was measured rightly."""

FEWEST, MOST = 10, 48
"""Images that are lifted under other names; fewer say nothing."""

FEWEST_NAMES = 4
"""Landmarks of the dictionary that names must give; with fewer there is nothing to lift."""

STEP, RATE = 0.5, 24.0
"""Seconds over which a body is seen to come nearer; frames per second where no file says it."""

GROWTH = 0.02
"""Growth of a body in the image over a step that counts as one nat against names under which it
walks backwards."""

SIDES_GAIN = 1.0
"""Nats an image by which exchanged sides must be likelier, and by two standard errors. Over 55
clips of five bodies (seen as in benchmarks/footage.py, not those scored) the right names were
never less likely by more than 0.43 on average over a clip; exchanged names of three bodies are
noticed."""

MOSTLY = 0.5
"""Belief below which a landmark is gross; share of the images in which it is so to be named, and
share of implausible images from which the cause is looked for."""

IMPLAUSIBLE = 0.25
"""Share of implausible images from which other skeletons are tried; one that has less than half of
that share is named. Where names are right a few images in a hundred are implausible."""


class Sample(NamedTuple):
    """Sampled images, and pairs (q, 2) of them that follow one another in a sequence."""

    images: LandmarkSet
    pairs: NDArray[np.intp]


class Lifted(NamedTuple):
    """Images that were lifted by the posterior, with the dictionary and the config for it."""

    lifting: Lifting
    dictionary: Dictionary
    config: FitConfig

    @property
    def log_evidence(self) -> Floats:
        """log p(w) (n,)."""
        found: Floats = self.lifting.estimate.further["log_evidence"]
        return found

    @property
    def implausible_share(self) -> float:
        """The share of the images that are implausible, of those that can be judged."""
        p_value = judge(*self).estimate.further["p_value"]
        judged = p_value[np.isfinite(p_value)]
        limit = MIN_P_VALUE
        return float((judged < limit).mean()) if len(judged) else float("nan")


def lift_sample(
    images: LandmarkSet,
    config: FitConfig,
    dictionary: Dictionary,
    *,
    dependent: bool = False,
    exchanged: bool = False,
) -> Lifted:
    """Lift images one by one by the posterior, by the names that their landmarks have.

    dependent: those of feet count, too, which say where a body faces; exchanged: the names of left
    and right change places.
    """
    known = of_files(dictionary, images.landmark_names)
    joints = find_joints(images.landmark_names, known.landmark_names)
    named = named_as_joints(images, joints, "landmarks")
    arranged = named.arrange(known.landmark_names, "landmarks", leave_out=True)
    if exchanged:
        names, partner = known.landmark_names, known.mirror_index
        assert partner is not None, "check_sides"
        other = arranged.replaced(landmark_names=tuple(names[j] for j in partner))
        arranged = other.arrange(names, "landmarks")
    theta = {**MEANS, **(config.skeleton or {})}
    seen = LandmarkMap(joints, theta, bool(joints.markers)).apply(known)
    single = config.changed(method="posterior")
    return Lifted(lift_images(arranged, seen, single, dependent=dependent), seen, single)


def log_evidence(images: LandmarkSet, config: FitConfig, dictionary: Dictionary) -> Floats:
    """Return log p(w) (n,) of images, by what the config says of camera and skeleton."""
    return lift_sample(images, config, dictionary).log_evidence


def mean_gain(before: Floats, after: Floats) -> tuple[float, float, int]:
    """Return the mean of after - before where it is finite, its standard error, and of how many."""
    gain = (after - before)[np.isfinite(after - before)]
    if len(gain) < 2:
        return 0.0, np.inf, len(gain)
    return float(gain.mean()), float(gain.std() / np.sqrt(len(gain))), len(gain)


def check_camera(images: LandmarkSet, config: FitConfig, dictionary: Dictionary) -> tuple[str, ...]:
    """Warn where images speak for another focal length than the measured one, which is obeyed."""
    if len(images) < 2:
        return ()
    stated = find_camera(images, config.camera)
    focal = float(np.median(stated.focal))
    centre = tuple(map(float, np.median(stated.centre, axis=0)))
    before = log_evidence(images, config, dictionary)

    def gain_of(factor: float) -> tuple[float, float, int]:
        camera = {"focal": factor * focal, "principal_point": centre}
        measured = {"calibration": None}
        changed = config.changed(camera=measured | camera)
        return mean_gain(before, log_evidence(images, changed, dictionary))

    tried = {factor: gain_of(factor) for factor in FACTORS}
    factor = max(tried, key=lambda each: tried[each][0])
    mean, error, _ = tried[factor]
    if not mean > LEAST_GAIN + 2 * error:
        return ()
    x, y = centre
    return (
        f"the landmarks speak against the measured camera, which is obeyed: with a focal length of "
        f"{factor * focal:.0f} px in place of {focal:.0f} px their log evidence is {mean:.1f} an "
        "image higher; if the camera is wrong, set `camera: {model: perspective, "
        f"focal: {factor * focal:.0f}, principal_point: [{x:.0f}, {y:.0f}]}}`",
    )


def check_labels(config: FitConfig, images: LandmarkSet, dictionary: Dictionary) -> tuple[str, ...]:
    """Return warnings about the names of the landmarks, tried on a sample of the first images.

    The config has its camera and skeleton, and a method with a prior; the images no distortion.
    """
    sample = choose_sample(images)
    if len(sample.images) < FEWEST or not enough_names(images.landmark_names, dictionary):
        return ()
    names = images.landmark_names
    taken = next(
        (each for each in installed_skeletons().values() if each.landmark_names == names), None
    )
    found = lift_sample(sample.images, config, dictionary, dependent=True)
    other = check_skeleton(sample.images, taken, found, config, dictionary)
    return other or check_sides(sample, found, config, dictionary)


def enough_names(names: Sequence[str], dictionary: Dictionary) -> bool:
    """Whether names of landmarks are those of enough landmarks of the dictionary."""
    known = of_files(dictionary, names).landmark_names
    return len({*find_joints(names, known).rename(names)} & {*known}) >= FEWEST_NAMES


def choose_sample(images: LandmarkSet) -> Sample:
    """Take images that are spread over all, and where there are sequences those a step later."""
    n, half = len(images), MOST // 2
    if images.sequences is None:
        return Sample(images.take(evenly(n, MOST)), np.empty((0, 2), np.intp))
    first = evenly(n, half)
    later = first + max(1, round(STEP * (images.frame_rate or RATE)))
    names = np.array(images.sequences, dtype=object)
    follows = later < n
    follows[follows] = names[later[follows]] == names[first[follows]]
    rows = np.union1d(first, later[follows])
    pairs = np.stack([first[follows], later[follows]], axis=1)
    return Sample(images.take(rows), np.searchsorted(rows, pairs))


def check_skeleton(
    images: LandmarkSet,
    taken: Skeleton | None,
    found: Lifted,
    config: FitConfig,
    dictionary: Dictionary,
) -> tuple[str, ...]:
    """Warn where many images are implausible, but not if their landmarks are of another skeleton.

    Others are those with as many landmarks, which `keypoints` might have meant.
    """
    if taken is None:
        return ()
    own = found.implausible_share
    if not own > IMPLAUSIBLE:
        return ()
    shares: dict[str, float] = {}
    for other in installed_skeletons().values():
        as_many = len(other.landmark_names) == len(taken.landmark_names)
        if as_many and other is not taken and enough_names(other.landmark_names, dictionary):
            renamed = images.replaced(landmark_names=other.landmark_names)
            as_other = lift_sample(renamed, config, dictionary, dependent=True)
            shares[other.name] = as_other.implausible_share
    best = min(shares, key=lambda name: shares[name], default=None)
    if best is None or not shares[best] < own / 2:
        return ()
    return (
        f"{own:.0%} of a sample of {len(images)} images are implausible as {taken.name}, and "
        f"{shares[best]:.0%} as {best}: is it {best}? Say so by `keypoints: {best}`",
    )


def find_cause(images: LandmarkSet, dictionary: Dictionary, config: FitConfig) -> str:
    """Say why most images are implausible, by trying what would make that share half as large.

    images have the landmarks of the dictionary, `config` what was estimated. Other names of
    landmarks were tried before the fit, where the files have names of a known skeleton.
    """
    single, most = config.changed(method="posterior"), "most images are implausible"
    images = images.take(evenly(len(images), MOST))

    def share(images: LandmarkSet, config: FitConfig = single) -> float:
        return Lifted(lift_images(images, dictionary, config), dictionary, config).implausible_share

    limit, partner = share(images) / 2, dictionary.mirror_index
    if partner is not None:
        sides = images.replaced(
            landmarks=images.landmarks[..., partner],
            confidence=None if images.confidence is None else images.confidence[:, partner],
        )
        if share(sides) < limit:
            return f"{most}, but not with left and right exchanged: exchange the names by `rename`"
    if config.camera.model == "perspective":
        parallel = {"focal": "none"}
        weak = {**parallel, "calibration": None, "name": None, "principal_point": None}
        if share(images, single.changed(camera=weak)) < limit:
            return (
                f"{most}, but not by weak perspective: is the camera right? "
                "`camera.model=weak-perspective` does without"
            )
    return (
        f"{most}, with left and right exchanged and without the camera, too: the dictionary may be "
        "of another class, or its training shapes lack these poses; look at some results"
    )


def check_sides(
    sample: Sample, found: Lifted, config: FitConfig, dictionary: Dictionary
) -> tuple[str, ...]:
    """Warn where images are clearly likelier with left and right exchanged."""
    known = of_files(dictionary, sample.images.landmark_names)
    if known.mirror_index is None:
        return ()
    other = lift_sample(sample.images, config, dictionary, dependent=True, exchanged=True)
    gain, error, count = mean_gain(found.log_evidence, other.log_evidence)
    total = gain + walks_backwards(found.lifting, known.landmark_names, sample) / GROWTH
    if count < FEWEST or not total > max(SIDES_GAIN, 2 * error):
        return ()
    return (
        f"left and right may be exchanged: with the names of the sides exchanged, a sample of "
        f"{count} images is likelier by {total:.1f} nats an image (perspective "
        f"{gain:+.1f}, walking forwards {total - gain:+.1f}); look at some results, "
        "and exchange the names by `rename` if they face the wrong way",
    )


def walks_backwards(found: Lifting, names: tuple[str, ...], sample: Sample) -> float:
    """mean over pairs of (log s' - log s) (f_z + f_z') / 2: how much bodies walk backwards.

    s is the size of a body in the image, s' a step later; f the direction in which it faces, away
    from the camera where f_z > 0. 0 without hips, shoulders and sequences.
    """
    place = {name: j for j, name in enumerate(names)}
    sides = ("lhip", "rhip", "lshoulder", "rshoulder")
    if not len(sample.pairs) or not set(sides) <= set(place):
        return 0.0
    lhip, rhip, lshoulder, rshoulder = (found.shapes[:, :, place[name]] for name in sides)
    across, up = lhip - rhip + lshoulder - rshoulder, lshoulder + rshoulder - lhip - rhip
    forward = np.cross(across, up)
    away = depth_sign(sample.images.y_axis) * forward[:, 2] / np.linalg.norm(forward, axis=1)
    size = np.log(
        np.linalg.norm(found.shapes - found.shapes.mean(axis=2, keepdims=True), axis=(1, 2))
    )
    before, after = sample.pairs.T
    moved = (size[after] - size[before]) * (away[before] + away[after]) / 2
    return float(np.nanmean(moved)) if np.isfinite(moved).any() else 0.0
