"""The noise of the landmarks of a sequence, found in the sequence itself."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats, median
from shapefit.lifting.sequences.observations import Observations
from shapefit.lifting.sequences.smoothing import Model, Smoothed, first_lengths, smooth

LEVELS = (0.003, 0.01, 0.03, 0.06)
"""Standard deviations of a coordinate that are tried, in units of the size of the landmarks.

The last one is that with which the posteriors of the images took them.
"""

FIRST = 3
"""The level that is tried first."""

LEAST_TURN = 0.3
"""How much bones must turn, see `find_turn`, before a sequence shows lengths and
noise."""

SHARED = 20.0
"""How much larger a landmark's constant error may be than what is left of it in the residuals: most
of it bends the body instead."""

ROUNDS = 6
"""Steps at each level: the next one goes on from there."""

WINDOW = 120
"""Frames in the middle of a sequence from which the noise is found."""


def find_noise(seen: Observations, model: Model) -> float:
    """Return the sigma of the objective of `smooth`, from the middle of the sequence.

    The level of the most evidence: from the first one on the noise falls, or else rises, as long
    as the evidence grows. Evidence counts errors as independent. Those that neighbouring frames
    share do not average out over a sequence, so with residuals e of the correlation r

        sigma^2 = level^2 + r (`SHARED` rms(e))^2,

    at most that with which the images took their landmarks. That it is, too, where bones of known
    lengths hardly turn: seen from one side, landmarks that are off alike in all frames fit a rigid
    body as well as exact ones do.
    """
    most = float(np.sqrt(seen.misfit))
    if find_turn(seen, model) < LEAST_TURN:
        return most
    levels = (*(level for level in LEVELS if level < most), most)
    first = max(0, (len(seen) - WINDOW) // 2)
    part = seen.take(slice(first, first + WINDOW))
    best = min(FIRST, len(levels) - 1)
    first_level, at = best, smooth(part, model, levels[best], rounds=ROUNDS)
    for step in (-1, 1):
        tried = best + step
        found: Smoothed = at
        while 0 <= tried < len(levels):
            found = smooth(part, model, levels[tried], found, rounds=ROUNDS)
            if found.log_evidence <= at.log_evidence:
                break
            best, at, tried = tried, found, tried + step
        if best != first_level:
            break
    size, r = residuals(part, at)
    return min(float(np.hypot(levels[best], np.sqrt(r) * SHARED * size)), most)


def find_turn(seen: Observations, model: Model) -> float:
    """Median over the bones of how their projections vary over time, in their lengths.

    The root of the mean square distance of a bone's projection from its mean; a bone that turns
    once around in the plane of the image has 1.
    """
    i, j = model.bones.T
    w = np.where(seen.trust[:, None] > 0, seen.landmarks, np.nan)
    bone = w[:, :, i] - w[:, :, j]
    there = np.isfinite(bone).all(axis=1)
    count = there.sum(axis=0)
    usable = count > 0
    if not usable.any():
        return 0.0
    kept = np.where(there[:, None], bone, 0.0)
    mean = kept.sum(axis=0) / np.maximum(count, 1)
    apart = np.where(there[:, None], bone - mean, 0.0)
    spread = np.sqrt((apart**2).sum(axis=(0, 1)) / np.maximum(count, 1))
    lengths = first_lengths(seen.start, model)
    return median(spread[usable] / np.maximum(lengths[usable], 1e-12))


def find_haste(seen: Observations, acceleration: Floats) -> float:
    """How much faster than expected the landmarks move in their images: a factor from 1 to 30.

    Second differences of a steady motion resemble their neighbours; of white noise their variance
    is 6 and the covariance of neighbours -4 times that of the noise. With a correlation of 0.7 of
    the motion's, variance + 1.5 covariance = 2.05 times the mean square of the motion's.
    """
    w = np.where(seen.trust[:, None] > 0, seen.landmarks, np.nan)
    second = w[2:] - 2 * w[1:-1] + w[:-2]
    apart = second[1:] * second[:-1]
    with_neighbour = np.isfinite(apart)
    known = np.isfinite(second)
    if not with_neighbour.any():
        return 1.0
    variance = np.where(known, second**2, 0.0).sum(axis=(0, 1)) / np.maximum(known.sum((0, 1)), 1)
    covariance = np.where(with_neighbour, apart, 0.0).sum(axis=(0, 1))
    covariance = covariance / np.maximum(with_neighbour.sum(axis=(0, 1)), 1)
    moving = np.maximum(variance + 1.5 * covariance, 0.0) / 2.05
    seen_ever = known.any(axis=(0, 1))
    expected = float((acceleration[seen_ever] ** 2).sum())
    return float(np.clip(np.sqrt(moving[seen_ever].sum() / expected), 1.0, 30.0))


def residuals(seen: Observations, found: Smoothed) -> tuple[float, float]:
    """Root mean square residual of a coordinate, and its correlation between neighbouring frames.

    Of landmarks as far as they are trusted; the correlation is at least 0.
    """
    left = np.nan_to_num(seen.landmarks) - found.points[:, :2]
    left = left * np.sqrt(seen.trust)[:, None]
    whole = float((left**2).sum())
    if whole == 0:
        return 0.0, 0.0
    shared = float((left[1:] * left[:-1]).sum()) / whole
    return float(np.sqrt(whole / (2 * seen.trust.sum()))), max(shared, 0.0)
