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

from shapefit.arrays import Floats, evenly
from shapefit.io import LandmarkSet
from shapefit.io.skeletons import THETA
from shapefit.lifting.lift import Lifting
from shapefit.pipelines.fit.lift import Lifter, lift_images, with_p_values
from shapefit.pipelines.joints import MEANS, LandmarkMap, Matched

LARGEST, FEW, FEWEST = 96, 24, 10
"""Images of a sample, of a first look at it, and images of which fewer say nothing."""

FEWEST_VISIBLE = 5
"""Landmarks of an image of the sample; four fit almost any shape."""

STEP, RATE = 0.5, 24.0
"""Seconds between the two images of a pair; frames per second where no file states it."""

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

    in_file, with the landmarks of the files, undistorted; images, with those of the dictionary.
    """

    in_file: LandmarkSet
    images: LandmarkSet

    def __len__(self) -> int:
        return len(self.images)

    def lift(self, lifter: Lifter) -> Lifting:
        """Lift the sample by the posterior, with p-values."""
        return with_p_values(lift_images(self.images, lifter), lifter)


def draw_sample(images: LandmarkSet, matched: Matched) -> Sample:
    """Draw images that are spread over all; of long sequences pairs that are a step apart."""
    images = images.take(np.flatnonzero(images.visible().sum(axis=1) >= FEWEST_VISIBLE))
    n, rows = len(images), evenly(len(images), LARGEST)
    if images.sequences is not None and n > LARGEST:
        step = max(1, round(STEP * (images.frame_rate or RATE)))
        rows = evenly(n, LARGEST // 2)
        rows = np.union1d(rows, rows[rows + step < n] + step)
    in_file = images.take(rows)
    return Sample(in_file, matched.arrange(in_file, "landmarks"))


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
    few = sample.images.take(evenly(len(sample), FEW))

    def evidence(theta: Mapping[str, float]) -> float:
        marked = replace(mapped, theta=theta).apply(lifter.dictionary)
        return float(np.nansum(log_evidence(few, replace(lifter, dictionary=marked))))

    theta, deviation = maximise_theta(evidence, names, start)
    errors = {name: f" +- {theta[name] * sd:.2f}" for name, sd in deviation.items()}
    factors = ", ".join(f"{name} x {theta[name]:.2f}{errors.get(name, '')}" for name in names)
    return theta, f"skeleton of the detector: {factors}"


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
            x = np.log(theta[name]) + factor * np.array(STEPS)
            prior = -0.5 * ((x - np.log(THETA[name].mean)) / THETA[name].std) ** 2
            values = prior + [evidence(theta | {name: float(np.exp(each))}) for each in x]
            best = min(max(int(np.argmax(values)), 1), len(x) - 2)
            below, at, above = values[best - 1 : best + 2]
            step = x[1] - x[0]
            curvature = (2 * at - below - above) / step**2
            top = x[int(np.argmax(values))]
            if curvature > 0:
                top = x[best] + np.clip((above - below) / (2 * step * curvature), -step, step)
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
    before, scale = lifter.variance, Scale(1.0, 1.0, 0.0)

    def scaled(prior: float, variance: float) -> dict[str, float]:
        return {"prior_scale": prior * lifter.prior_scale, "residual_variance": variance * before}

    if open_keys and len(sample) >= FEWEST:
        scale = find_scale(
            lambda pair, images: log_evidence(images, replace(lifter, **scaled(*pair))),  # type: ignore[arg-type]
            without_outliers(sample.images, as_learned),
            FACTORS if "scale" in open_keys else FACTORS[:1],
            FACTORS if "residual_variance" in open_keys else FACTORS[:1],
        )
    prior, variance = scaled(scale.prior, scale.residual_variance).values()
    changes = []
    if scale.prior != 1:
        changes.append(f"prior widened x {prior:g}: poses unlike the training data")
    if scale.residual_variance != 1:
        changes.append(f"residual variance {variance:g} in place of {before:g}")
    line = ", ".join(changes) + (f" ({scale.gain:+.1f} nats an image)" if changes else "")
    return {"scale": prior, "residual_variance": variance}, line


def without_outliers(images: LandmarkSet, lifting: Lifting) -> LandmarkSet:
    """Hide landmarks that are outliers in most images.

    Their errors say nothing of the others, but would make them all less exact.
    """
    inlier_probability = lifting.estimate.further["inlier_probability"]
    visible = np.maximum(np.isfinite(inlier_probability).sum(axis=0), 1)
    hidden = (inlier_probability < OUTLIER).sum(axis=0) > MOSTLY * visible
    if not 0 < hidden.sum() <= len(hidden) / 3:  # none, or the prior is wrong, not the landmarks
        return images
    return images.replaced(landmarks=np.where(hidden, np.nan, images.landmarks))


def find_scale(
    evidence: Callable[[Pair, LandmarkSet], Floats],
    images: LandmarkSet,
    scales: tuple[float, ...] = FACTORS,
    variances: tuple[float, ...] = FACTORS,
) -> Scale:
    """Choose among pairs of factors by their evidence (n,) of images, in order of both.

    All pairs are tried where, at first sight, the next scale or the next variance is likelier. Of
    pairs as likely as the best, the widest is taken; then the least variance.
    """
    first, few = (scales[0], variances[0]), images.take(evenly(len(images), FEW))
    near = [(f, first[1]) for f in scales[1:2]] + [(first[0], v) for v in variances[1:2]]
    before = evidence(first, few)
    if not any(np.nanmean(evidence(pair, few) - before) > 0 for pair in near):
        return Scale(*first, 0.0)
    of_pair = {(f, v): evidence((f, v), images) for f in scales for v in variances}
    best = max(of_pair, key=lambda pair: float(np.nanmean(of_pair[pair])))

    def is_as_likely(pair: Pair) -> bool:
        lost, error, _ = mean_gain(of_pair[pair], of_pair[best])
        return lost <= error

    chosen = max(filter(is_as_likely, of_pair), key=lambda pair: (pair[0], -pair[1]))
    return Scale(*chosen, mean_gain(of_pair[first], of_pair[chosen])[0])


def log_evidence(images: LandmarkSet, lifter: Lifter) -> Floats:
    """Return log p(w) (n,) of images."""
    evidence: Floats = lift_images(images, lifter).estimate.further["log_evidence"]
    return evidence


def mean_gain(before: Floats, after: Floats) -> tuple[float, float, int]:
    """Return the mean of after - before where it is finite, its standard error, and of how many.

    The error is that of the means of sqrt(n) blocks of neighbours, whose gains resemble each other
    (batch means: Flegal and Jones, Annals of Statistics 2010).
    """
    gain = (after - before)[np.isfinite(after - before)]
    if len(gain) < 4:
        return 0.0, np.inf, len(gain)
    means = [block.mean() for block in np.array_split(gain, int(np.sqrt(len(gain))))]
    return float(gain.mean()), float(np.std(means, ddof=1) / np.sqrt(len(means))), len(gain)
