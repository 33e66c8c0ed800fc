"""The search for what makes a sample likeliest: skeleton of the detector, scales of the
prior.

It knows nothing of methods: the log evidence log p(w) of images comes as a function. It
is compared for the skeleton theta of a detector of people, and for factors f on the
covariances of the prior and residual variances v:

    1/n sum_i log p(w_i | f, v),    f in {1, 2, 4, 8},  v in {v_0, 2 v_0, 4 v_0, 8 v_0},

where v_0 is that of the dictionary. Smaller ones are not tried: their evidence is flat
where error bars are far too narrow already. Of pairs that are as likely as the best by
the standard error of their difference, the widest prior is taken and, with it, the
least v.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from shapefit import log
from shapefit.arrays import Floats, evenly
from shapefit.io.skeletons import THETA
from shapefit.records import Landmarks

FIRST_LOOK = 24
"""Images by which a search begins, and by which a skeleton is found."""

STEPS = (-0.2, -0.1, 0.0, 0.1, 0.2)
"""Of the logarithm of a parameter, tried about its mean, and half of them about the
best.
"""

FACTORS = (1.0, 2.0, 4.0, 8.0)
"""Tried on the covariances of the prior and on the residual variance."""

MIN_GAINS = 4
"""Images whose gains have a standard error."""


class Factors(NamedTuple):
    """Factors on the covariances of the prior, and on the residual variance."""

    prior: float
    variance: float


LogEvidence = Callable[[Factors, Landmarks], Floats]
"""log p(w) (n,) of images with these factors."""


def maximise_theta(
    evidence: Callable[[Mapping[str, float]], float],
    names: Sequence[str],
    start: Mapping[str, float],
) -> dict[str, float]:
    """Return the body proportions theta that maximise log p(w | theta) + log p(theta).

    names are those to find, from `start`, twice, one after the other. Each is taken to
    the top of the parabola through the best value tried and its neighbours.
    """
    theta = dict(start)
    for width in (1.0, 0.5):
        for name in names:
            x = np.log(theta[name]) + width * np.array(STEPS)
            values = log_prior_of_skeleton(name, x)
            for step, value in enumerate(np.exp(x)):
                values[step] += evidence(theta | {name: float(value)})
            theta[name] = float(np.exp(top_of_parabola(x, values)))
    return theta


def log_prior_of_skeleton(name: str, x: Floats) -> Floats:
    """Return log p(theta) at logarithms x (m,) of a parameter, up to a constant."""
    parameter = THETA[name]
    away = (x - np.log(parameter.mean)) / parameter.std
    logarithm: Floats = -0.5 * away**2
    return logarithm


def top_of_parabola(x: Floats, values: Floats) -> float:
    """Return where the parabola through the best value and its neighbours is highest.

    It is at most a step away from the middle one.
    """
    best = int(np.argmax(values))
    middle = min(max(best, 1), len(x) - 2)
    below = values[middle - 1]
    at = values[middle]
    above = values[middle + 1]
    step = x[1] - x[0]
    curvature = (2 * at - below - above) / step**2
    if not curvature > 0:
        return float(x[best])
    away = (above - below) / (2 * step * curvature)
    return float(x[middle] + np.clip(away, -step, step))


def choose_factors(
    evidence: LogEvidence,
    images: Landmarks,
    scales: tuple[float, ...] = FACTORS,
    variances: tuple[float, ...] = FACTORS,
) -> Factors:
    """Return the pair of factors by which images have the greatest mean evidence.

    `scales` on the prior and `variances` rise; the first pair of them is the default.
    All pairs are tried where, at first sight, the next scale or the next variance is
    likelier. Of pairs as likely as the best, the widest is taken; then the least
    variance.
    """
    first = Factors(scales[0], variances[0])
    few = images.take(evenly(len(images), FIRST_LOOK))
    before = evidence(first, few)
    wider = [Factors(scale, first.variance) for scale in scales[1:2]]
    looser = [Factors(first.prior, variance) for variance in variances[1:2]]
    if not any(is_likelier(before, evidence(pair, few)) for pair in wider + looser):
        return first
    pairs = [Factors(*pair) for pair in product(scales, variances)]
    tried = {pair: evidence(pair, images) for pair in pairs}
    for pair, values in tried.items():
        log.debug("fit", "mean log evidence %.4g with %s", np.nanmean(values), pair)
    best = max(pairs, key=lambda pair: float(np.nanmean(tried[pair])))
    likely = [pair for pair in pairs if is_as_likely(tried[pair], tried[best])]
    return max(likely, key=lambda pair: (pair.prior, -pair.variance))


def is_likelier(before: Floats, after: Floats) -> bool:
    """Whether the sum of log p(w) (n,) over the images is larger after than before."""
    return bool(np.nansum(after - before) > 0)


def is_as_likely(evidence: Floats, best: Floats) -> bool:
    """Whether mean log p(w) (n,) is at most a standard error below that of the best."""
    lost, error = mean_gain(evidence, best)
    return lost <= error


def mean_gain(before: Floats, after: Floats) -> tuple[float, float]:
    """Return the mean of after - before where it is finite, and its standard error.

    They are 0 and infinite for fewer than MIN_GAINS images. By batch means, as
    neighbours resemble each other (Flegal and Jones, Annals of Statistics 2010).
    """
    gain = (after - before)[np.isfinite(after - before)]
    if len(gain) < MIN_GAINS:
        return 0.0, np.inf
    blocks = np.array_split(gain, int(np.sqrt(len(gain))))
    means = [block.mean() for block in blocks]
    error = np.std(means, ddof=1) / np.sqrt(len(means))
    return float(gain.mean()), float(error)
