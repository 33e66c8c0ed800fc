"""The sample of the first images that a fit is prepared by, and what is chosen by its evidence.

The log evidence log p(w) of an image under the posterior is compared: for the skeleton theta of a
detector of people, and for how wide the prior is and how exactly landmarks are known. A prior that
was learned from few poses is too sure of itself, and landmarks of an animal follow its bones less
exactly than those of a person. Of factors f on the covariances of the prior and residual variances
v, a file is lifted with the pair of the greatest mean log evidence

    1/n sum_i log p(w_i | f, v),    f in {1, 2, 4, 8},  v in {v_0, 2 v_0, 4 v_0, 8 v_0},

where v_0 is the residual variance of the dictionary. Smaller ones are not tried: their evidence is
flat where error bars are far too narrow already. Of pairs that are as likely as the best by the
standard error of their difference, the widest prior is taken and, with it, the least v.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.dictionary.from_2d.model import evenly
from shapefit.io import LandmarkSet
from shapefit.io.skeletons import THETA
from shapefit.lifting.lift import Lifting
from shapefit.pipelines.fit.lift import Lifter, lift_images, with_p_values
from shapefit.pipelines.joints import MEANS, LandmarkMap, Matched

LARGEST, FEW, FEWEST = 96, 24, 10
"""Images of a sample, of a first look at it, and images of which fewer say nothing."""

FEWEST_SEEN = 5
"""Landmarks of an image of the sample; four fit almost any shape."""

STEP, RATE = 0.5, 24.0
"""Seconds over which a body is seen to come nearer; frames per second where no file says it."""

STEPS = (-0.2, -0.1, 0.0, 0.1, 0.2)
"""Of the logarithm of a parameter, tried about its mean, and half of them about the best."""

FACTORS = (1.0, 2.0, 4.0, 8.0)
"""Of the covariances of the prior, and of the residual variance."""

OUTLIER, MOSTLY = 0.5, 0.5
"""Inlier probability below which a landmark is an outlier; share of the images in which it is one
from which on the landmark itself is doubted."""

Pair = tuple[float, float]
"""Factors on the covariances of the prior and on the residual variance."""


@dataclass(frozen=True)
class Sample:
    """Images spread over the first ones, of those that show enough landmarks.

    own     as the files have them, without distortion
    images  with the landmarks of the dictionary
    pairs   (q, 2) of images that follow one another by STEP seconds in a sequence
    """

    own: LandmarkSet
    images: LandmarkSet
    pairs: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.images)

    @property
    def few(self) -> LandmarkSet:
        """Those of the first look."""
        return self.images.take(evenly(len(self), FEW))

    def lift(self, lifter: Lifter) -> Lifting:
        """Lift the sample by the posterior, with p-values."""
        return with_p_values(lift_images(self.images, lifter), lifter)


def draw_sample(images: LandmarkSet, matched: Matched) -> Sample:
    """Draw images that are spread over all and, where there are sequences, those a step later."""
    images = images.take(np.flatnonzero(images.seen().sum(axis=1) >= FEWEST_SEEN))
    n, pairs = len(images), np.empty((0, 2), np.intp)
    rows = evenly(n, LARGEST)
    if images.sequences is not None and n > LARGEST:
        first = evenly(n, LARGEST // 2)
        later = first + max(1, round(STEP * (images.frame_rate or RATE)))
        later = np.where(later < n, later, first)
        rows = np.union1d(first, later)
    if images.sequences is not None:
        names = np.array(images.sequences, dtype=object)
        later = rows + max(1, round(STEP * (images.frame_rate or RATE)))
        place_of = {int(row): at for at, row in enumerate(rows)}
        pairs = np.array(
            [
                (at, place_of[int(other)])
                for at, other in enumerate(later)
                if int(other) in place_of and names[rows[at]] == names[other]
            ],
            dtype=np.intp,
        ).reshape(-1, 2)
    own = images.take(rows)
    return Sample(own, matched.arrange(own, "landmarks"), pairs)


def log_evidence(images: LandmarkSet, lifter: Lifter) -> Floats:
    """Return log p(w) (n,) of images."""
    found: Floats = lift_images(images, lifter).estimate.further["log_evidence"]
    return found


def mean_gain(before: Floats, after: Floats) -> tuple[float, float, int]:
    """Return the mean of after - before where it is finite, its standard error, and of how many."""
    gain = (after - before)[np.isfinite(after - before)]
    if len(gain) < 2:
        return 0.0, np.inf, len(gain)
    return float(gain.mean()), float(gain.std() / np.sqrt(len(gain))), len(gain)


def choose_skeleton(
    given: Mapping[str, float] | None, mapped: LandmarkMap, sample: Sample, lifter: Lifter
) -> tuple[dict[str, float] | None, str]:
    """Return the parameters of the skeleton, as given, else estimated, else usual; and a line."""
    if not mapped.joints.markers:
        return None if given is None else dict(given), ""
    start = {**MEANS, **(given or {})}
    names = [name for name in mapped.joints.parameters if name not in (given or {})]
    if not names or not len(sample):
        return start, ""

    def evidence(theta: Mapping[str, float]) -> float:
        seen = replace(mapped, theta=theta).apply(lifter.dictionary)
        return float(np.nansum(log_evidence(sample.few, replace(lifter, dictionary=seen))))

    theta, deviation = maximise_theta(evidence, names, start)
    told = ", ".join(
        f"{name} x {theta[name]:.2f}"
        + (f" +- {theta[name] * deviation[name]:.2f}" if name in deviation else "")
        for name in names
    )
    return theta, f"skeleton of the detector: {told}"


def maximise_theta(
    evidence: Callable[[Mapping[str, float]], float], names: Sequence[str], start: dict[str, float]
) -> tuple[dict[str, float], dict[str, float]]:
    """Maximise log p(w | theta) + log p(theta) over the named parameters, one by one, twice.

    Each is taken to the top of the parabola through the best value tried and its neighbours.
    Returns theta, and the standard deviations of logarithms that the curvature gives.
    """
    theta, deviation = dict(start), dict[str, float]()
    for factor in (1.0, 0.5):
        for name in names:
            mean, wide = THETA[name].mean, THETA[name].std
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
                deviation[name] = float(curvature**-0.5)
            theta[name] = float(np.exp(top))
    return theta, deviation


class Scale(NamedTuple):
    """Factors on the covariances of the prior and residual variance; the nats an image gained."""

    prior: float
    residual_variance: float
    gain: float


def choose_scale(
    open_keys: Sequence[str], sample: Sample, as_learned: Lifting, lifter: Lifter
) -> tuple[dict[str, float], str]:
    """Return `scale` and `residual_variance` of the prior, and a line about what has changed.

    Keys that are open are chosen by evidence; without any, both stay as they are in the lifter, by
    which the sample was lifted `as_learned`.
    """
    start = lifter.variance
    scales = tuple(
        f * lifter.prior_scale for f in (FACTORS if "scale" in open_keys else FACTORS[:1])
    )
    variances = FACTORS if "residual_variance" in open_keys else FACTORS[:1]

    def evidence(pair: Pair, images: LandmarkSet) -> Floats:
        scale, factor = pair
        changed = replace(lifter, prior_scale=scale, residual_variance=factor * start)
        return log_evidence(images, changed)

    found = Scale(scales[0], variances[0], 0.0)
    if open_keys and len(sample) >= FEWEST:
        images = without_outliers(sample.images, as_learned)
        found = find_scale(evidence, images, scales, variances)
    variance = found.residual_variance * start
    changes = []
    if found.prior != scales[0]:
        changes.append(f"prior widened x {found.prior:g}: poses unlike the training data")
    if found.residual_variance > 1:
        changes.append(f"residual variance {variance:g} in place of {start:g}")
    line = ", ".join(changes) + (f" ({found.gain:+.1f} nats an image)" if changes else "")
    return {"scale": found.prior, "residual_variance": variance}, line


def without_outliers(images: LandmarkSet, found: Lifting) -> LandmarkSet:
    """Hide landmarks that are outliers in most images.

    Their errors say nothing of the others, but would make them all less exact.
    """
    inlier_probability = found.estimate.further["inlier_probability"]
    seen = np.maximum(np.isfinite(inlier_probability).sum(axis=0), 1)
    hidden = (inlier_probability < OUTLIER).sum(axis=0) > MOSTLY * seen
    if not 0 < hidden.sum() <= len(hidden) / 3:  # none, or the prior is wrong, not the landmarks
        return images
    landmarks = images.landmarks.copy()
    landmarks[..., hidden] = np.nan
    return images.replaced(landmarks=landmarks)


def find_scale(
    evidence: Callable[[Pair, LandmarkSet], Floats],
    images: LandmarkSet,
    scales: tuple[float, ...] = FACTORS,
    variances: tuple[float, ...] = FACTORS,
) -> Scale:
    """Choose among pairs of factors by their evidence (n,) of images, in order of both.

    All pairs are tried where, at first sight, the next scale or the next variance is likelier.
    """
    first = scales[0], variances[0]
    few = images.take(evenly(len(images), FEW))
    near = [(f, first[1]) for f in scales[1:2]] + [(first[0], v) for v in variances[1:2]]
    before = evidence(first, few)
    if not any(np.nanmean(evidence(pair, few) - before) > 0 for pair in near):
        return Scale(*first, 0.0)
    return likeliest({(f, v): evidence((f, v), images) for f in scales for v in variances})


def likeliest(of: Mapping[Pair, Floats]) -> Scale:
    """Choose by evidence (n,): the widest of those as likely as the best; then the least v."""
    best = max(of, key=lambda pair: float(np.nanmean(of[pair])))

    def is_as_likely(pair: Pair) -> bool:
        lost, error, _ = mean_gain(of[pair], of[best])
        return lost <= error

    prior, variance = max(filter(is_as_likely, of), key=lambda pair: (pair[0], -pair[1]))
    first = next(iter(of))
    return Scale(prior, variance, mean_gain(of[first], of[prior, variance])[0])
