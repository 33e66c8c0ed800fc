"""How wide the prior is and how exactly landmarks are known, by the evidence of a sample.

A prior that was learned from few poses is too sure of itself, and landmarks of an animal follow its
bones less exactly than those of a person. Of the factors f on the covariances of the prior and the
misfits v, a file is lifted with the pair of the greatest mean log evidence

    1/n sum_i log p(w_i | f, v),    f in {1, 2, 4, 8},  v in {v_0, 2 v_0, 4 v_0, 8 v_0},

where v_0 is the misfit of the dictionary. Smaller ones are not tried: their evidence is flat where
error bars are far too narrow already. Of pairs that are as likely as the best by the standard error
of their difference, the widest prior is taken and, with it, the smallest misfit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.config import FitConfig
from shapefit.dictionary.from_2d.model import evenly
from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSet
from shapefit.pipelines.fit.checks import (
    FEWEST,
    MOSTLY,
    Lifted,
    enough_names,
    lift_sample,
    log_evidence,
    mean_gain,
)
from shapefit.pipelines.fit.lift import find_residual_variance
from shapefit.pipelines.joints import find_joints

FACTORS = (1.0, 2.0, 4.0, 8.0)
"""Of the covariances of the prior, and of the misfit."""

FIRST_LOOK, SAMPLE = 24, 96
"""Images for which the next wider prior and the next larger misfit are tried; where either is
likelier, so many are lifted with all pairs."""

FEWEST_SEEN = 5
"""Landmarks of an image of the sample; four fit almost any shape."""

Pair = tuple[float, float]
"""Factors on the covariances of the prior and on the misfit."""

Evidence = Callable[[Pair, LandmarkSet], Floats]


class Width(NamedTuple):
    """Factors on the covariances of the prior and on the misfit; the nats an image they gain."""

    prior: float
    residual_variance: float
    gain: float


def choose_width(
    config: FitConfig, images: LandmarkSet, dictionary: Dictionary, *, learned: bool = False
) -> tuple[dict[str, float], str]:
    """Return `prior_scale` and `residual_variance`, given or by evidence, and a line about them.

    The config has its camera and skeleton. What is not given stays as it was `learned` on demand;
    where all does, the line is empty.
    """
    own, start = config.prior, find_residual_variance(config, dictionary)
    widths = FACTORS if own.scale is None else (own.scale,)
    misfits = FACTORS if own.residual_variance is None else (1.0,)

    def keys(width: float, factor: float) -> dict[str, float]:
        return {"scale": width, "residual_variance": factor * start}

    def evidence(pair: Pair, sample: LandmarkSet) -> Floats:
        return log_evidence(sample, config.changed(prior=keys(*pair)), dictionary)

    first = Width(widths[0], misfits[0], 0.0)
    seen = images.take(np.flatnonzero(images.seen().sum(axis=1) >= FEWEST_SEEN))
    is_open = len(widths) + len(misfits) > 2 and not learned
    found = first
    if is_open and len(seen) >= FEWEST and enough_names(images.landmark_names, dictionary):
        as_learned = config.changed(prior=keys(*first[:2]))
        known = without_gross(seen, lift_sample(few_of(seen), as_learned, dictionary))
        found = find_width(evidence, known, widths, misfits)
    changed = (
        f"prior {found.prior:g} times as wide (covariances)" if found.prior != first.prior else "",
        f"residual_variance {found.residual_variance * start:g} in place of {start:g}"
        if found.residual_variance > 1
        else "",
    )
    told = ", ".join(filter(None, changed))
    told += f": likelier by {found.gain:.1f} nats an image" if told else ""
    return keys(found.prior, found.residual_variance), told


def few_of(images: LandmarkSet) -> LandmarkSet:
    """Return the images of the first look."""
    return images.take(evenly(len(images), FIRST_LOOK))


def without_gross(images: LandmarkSet, found: Lifted) -> LandmarkSet:
    """Hide landmarks that were gross in most images of the first look.

    What is wrong with a landmark says nothing of the others, but would make them all less exact.
    """
    inlier_probability = found.lifting.estimate.further["inlier_probability"]
    gross = (inlier_probability < MOSTLY).sum(axis=0) > MOSTLY * np.maximum(
        np.isfinite(inlier_probability).sum(axis=0), 1
    )
    if not 0 < gross.sum() <= len(gross) / 3:  # none, or the prior is wrong, not the landmarks
        return images
    known = found.dictionary.landmark_names
    markers = find_joints(images.landmark_names, known).markers
    names = {name for j in np.flatnonzero(gross) for name in markers.get(known[j], (known[j],))}
    landmarks = images.landmarks.copy()
    landmarks[..., [name in names for name in images.landmark_names]] = np.nan
    return images.replaced(landmarks=landmarks)


def find_width(
    evidence: Evidence,
    images: LandmarkSet,
    widths: tuple[float, ...] = FACTORS,
    misfits: tuple[float, ...] = FACTORS,
) -> Width:
    """Choose among pairs of factors by their evidence (n,) of images, in order of both."""
    first = widths[0], misfits[0]
    few = few_of(images)
    near = [(each, first[1]) for each in widths[1:2]] + [(first[0], each) for each in misfits[1:2]]
    before = evidence(first, few)
    if not any(np.nanmean(evidence(pair, few) - before) > 0 for pair in near):
        return Width(*first, 0.0)
    sample = images.take(evenly(len(images), SAMPLE))
    of = {(f, v): evidence((f, v), sample) for f in widths for v in misfits}
    return likeliest(of)


def likeliest(of: Mapping[Pair, Floats]) -> Width:
    """Choose by evidence (n,): the widest of those as likely as the best; then the least misfit."""
    best = max(of, key=lambda pair: float(np.nanmean(of[pair])))

    def is_as_likely(pair: Pair) -> bool:
        lost, error, _ = mean_gain(of[pair], of[best])
        return lost <= error

    prior, residual_variance = max(filter(is_as_likely, of), key=lambda pair: (pair[0], -pair[1]))
    first = next(iter(of))
    return Width(prior, residual_variance, mean_gain(of[first], of[prior, residual_variance])[0])
