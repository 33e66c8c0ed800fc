"""Whether the names of the landmarks are right, tried on a sample of the images.

Files that only number their landmarks are named by `keypoints`, and detectors and people exchange
left and right. A fit of such images looks fine, or all images look implausible without a cause. So
a sample is lifted under other names, too, and a warning says which of them the images are likelier
with.

Left and right: a body seen with its sides exchanged looks like that body turned to face the other
way, near and far exchanged. Seen from afar, and with a prior as symmetric as bodies are, both are
exactly as likely, whatever knees and elbows do. What tells them apart is perspective (feet
are seen from above, what is nearer is larger), and that people walk forwards.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.pinhole import depth_sign
from shapefit.io import LandmarkSet
from shapefit.io.skeletons import SKELETONS
from shapefit.lifting.lift import Lifting
from shapefit.pipelines.fit.chain import lift_images
from shapefit.pipelines.fit.plan import choose_chain
from shapefit.pipelines.joints import MEANS, Mapped, find_joints, named_as_joints, of_files


@dataclass(frozen=True)
class LabelLimits:
    """When a sample of the images speaks for other names.

    fewest       of the sample; fewer say nothing
    landmarks    of the dictionary that the names must give; with fewer there is nothing to lift
    sample       images that are lifted under each naming
    step         seconds over which a body is seen to come nearer
    rate         frames per second where the files do not say
    growth       growth of a body in the image over a step that counts as one nat against names
                 under which it walks backwards
    gain         nats an image by which exchanged sides must be likelier. Over 55 clips of five
                 bodies (seen as in benchmarks/footage.py, not those scored) the right names were
                 never less likely by more than 0.43 on average over a clip; exchanged names of
                 three bodies are noticed
    errors       and its standard errors
    implausible  share of implausible images from which other skeletons are tried; one that has
                 less than half of that share is named
    """

    fewest: int = 10
    landmarks: int = 4
    sample: int = 48
    step: float = 0.5
    rate: float = 24.0
    growth: float = 0.02
    gain: float = 1.0
    errors: float = 2.0
    implausible: float = 0.5


LIMITS = LabelLimits()


def check_labels(config: FitConfig, images: LandmarkSet, dictionary: Dictionary) -> tuple[str, ...]:
    """Return warnings about the names of the landmarks, tried on a sample of the first images.

    The config has its camera and skeleton, and a method with a prior; the images no distortion.
    """
    sample = choose_sample(images)
    if len(sample.images) < LIMITS.fewest:
        return ()
    found = lift_named(sample.images, config, dictionary)
    if found is None:
        return ()
    other = check_skeleton(sample.images, found, config, dictionary)
    return other or check_sides(sample, found, config, dictionary)


@dataclass(frozen=True)
class Sample:
    """Images, and pairs (q, 2) of them, the second of which follows a step later."""

    images: LandmarkSet
    pairs: NDArray[np.intp]


def choose_sample(images: LandmarkSet) -> Sample:
    """Take images that are spread over all, and where there are sequences those a step later."""
    n, half = len(images), LIMITS.sample // 2
    if images.sequences is None:
        return Sample(images.take(spread(n, LIMITS.sample)), np.empty((0, 2), np.intp))
    first = spread(n, half)
    later = first + max(1, round(LIMITS.step * (images.frame_rate or LIMITS.rate)))
    names = np.array(images.sequences, dtype=object)
    follows = later < n
    follows[follows] = names[later[follows]] == names[first[follows]]
    rows = np.union1d(first, later[follows])
    pairs = np.stack([first[follows], later[follows]], axis=1)
    return Sample(images.take(rows), np.searchsorted(rows, pairs))


def spread(n: int, most: int) -> NDArray[np.intp]:
    """Return at most so many of n rows, evenly spread."""
    return np.unique(np.linspace(0, max(n - 1, 0), min(n, most)).astype(np.intp))


def lift_named(
    images: LandmarkSet, config: FitConfig, dictionary: Dictionary, *, exchanged: bool = False
) -> Lifting | None:
    """Lift images one by one by all their landmarks; None where too few have names.

    Dependent landmarks, as those of feet, count here: they say where a body faces.
    """
    known = of_files(dictionary, images.landmark_names)
    joints = find_joints(images.landmark_names, known.landmark_names)
    own = joints.rename(images.landmark_names)
    if len(set(own) & set(known.landmark_names)) < LIMITS.landmarks:
        return None
    single = config.model_copy(update={"method": "posterior"})
    chain = replace(choose_chain(single, known), aside=None, sequences=None)
    arranged = named_as_joints(images, joints, "landmarks").arrange(
        known.landmark_names, "landmarks", leave_out=True
    )
    if exchanged:
        names, partner = known.landmark_names, known.mirror_index
        assert partner is not None, "check_sides"
        other = arranged.replaced(landmark_names=tuple(names[j] for j in partner))
        arranged = other.arrange(names, "landmarks")
    seen = Mapped(joints, config.theta or MEANS, bool(joints.stand_ins)).see(known)
    return lift_images(arranged, seen, chain)


def check_skeleton(
    images: LandmarkSet, found: Lifting, config: FitConfig, dictionary: Dictionary
) -> tuple[str, ...]:
    """Warn where most images are implausible, but not if their landmarks are of another skeleton.

    Others are those with as many landmarks, which `keypoints` might have meant.
    """
    own = implausible_share(found, config)
    names = images.landmark_names
    taken = next((each for each in SKELETONS.values() if each.landmark_names == names), None)
    if taken is None or not own > LIMITS.implausible:
        return ()
    shares = {
        other.name: implausible_share(lifting, config)
        for other in SKELETONS.values()
        if len(other.landmark_names) == len(names) and other is not taken
        for lifting in [
            lift_named(images.replaced(landmark_names=other.landmark_names), config, dictionary)
        ]
        if lifting is not None
    }
    best = min(shares, key=lambda name: shares[name], default=None)
    if best is None or not shares[best] < own / 2:
        return ()
    return (
        f"{own:.0%} of a sample of {len(images)} images are implausible as {taken.name}, and "
        f"{shares[best]:.0%} as {best}: is it {best}? Say so by `keypoints: {best}`",
    )


def implausible_share(found: Lifting, config: FitConfig) -> float:
    """Return the share of the images that are implausible, of those that can be judged."""
    plausibility = found.estimate.further["plausibility"]
    judged = plausibility[np.isfinite(plausibility)]
    return float((judged < config.posterior.implausible).mean()) if len(judged) else float("nan")


def check_sides(
    sample: Sample, found: Lifting, config: FitConfig, dictionary: Dictionary
) -> tuple[str, ...]:
    """Warn where images are clearly likelier with left and right exchanged."""
    if of_files(dictionary, sample.images.landmark_names).mirror_index is None:
        return ()
    other = lift_named(sample.images, config, dictionary, exchanged=True)
    if other is None:
        return ()
    gain = other.estimate.further["log_evidence"] - found.estimate.further["log_evidence"]
    gain = gain[np.isfinite(gain)]
    if len(gain) < LIMITS.fewest:
        return ()
    error = gain.std() / np.sqrt(len(gain))
    known = of_files(dictionary, sample.images.landmark_names).landmark_names
    backwards = walks_backwards(found, known, sample)
    total = gain.mean() + backwards / LIMITS.growth
    if not total > max(LIMITS.gain, LIMITS.errors * error):
        return ()
    return (
        f"left and right may be exchanged: with the names of the sides exchanged, a sample of "
        f"{len(gain)} images is likelier by {total:.1f} nats an image (perspective "
        f"{gain.mean():+.1f}, walking forwards {total - gain.mean():+.1f}); look at some results, "
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
