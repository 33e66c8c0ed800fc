"""Frames in which a detector has exchanged left and right, found by continuity.

Where left and right change places, the differences D = w_left - w_right of all pairs of
landmarks change their signs from one frame to the next, and nothing else moves. For the
difference D' that a pair had when it was last seen, and a step of the size s,

    S = (nu + 2) / 2 log[(nu + ||D - D'||^2 / s^2) / (nu + ||D + D'||^2 / s^2)]

is the log likelihood of an exchange, by Student's t distribution with nu degrees of
freedom, which jumps of single landmarks do not outvote. The likeliest run of the states
{as named, exchanged} has the largest sum of S - price over its changes (Viterbi). It
says where sides change places, but not which of the two states is right: most frames
within a second are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, finite_median
from shapefit.lifting.sequences.smoothing import CONSTANTS
from shapefit.timeline import Timeline

STUDENT_FREEDOM = 3.0
"""nu."""

MAX_FRAMES_BETWEEN = 5
"""Frames after which the last difference of a pair says nothing of its next one."""

MIN_STEP = 0.05
"""s of a body at rest, in median distances of left from right."""

RAYLEIGH_MEDIAN = 1.177
"""Median of the length of a vector of two Gaussians of deviation 1."""


class Exchanges(NamedTuple):
    """Which frames (t,) have their sides exchanged; whether one run of sides is left.

    Without `continuous` left and right change places for longer than a second, and
    nobody knows which part of the sequence is named rightly.
    """

    exchanged: Flags
    continuous: bool


def find_exchanges(
    landmarks: Floats, pairs: NDArray[np.integer], timeline: Timeline
) -> Exchanges:
    """Find the frames in which a detector has exchanged left and right.

    Those are frames whose sides are other than in most frames within a second.

    A swap that lasts longer than a second is not found, but makes `continuous` False.
    landmarks (t, 2, p), nan where hidden; pairs (q, 2) of left and right.
    """
    position = timeline.position
    change = find_changes(landmarks, pairs, position)
    state = likeliest_states(change)
    if not state.any():
        return Exchanges(state, continuous=True)
    a_second = max(1, round(timeline.rate))
    count = np.concatenate([[0], np.cumsum(state)])
    first = np.searchsorted(position, position - a_second, "left")
    last = np.searchsorted(position, position + a_second, "right")
    usual = 2 * (count[last] - count[first]) > last - first
    exchanged = state != usual
    left = state ^ exchanged
    return Exchanges(exchanged, continuous=bool((left == left[0]).all()))


def find_changes(
    landmarks: Floats, pairs: NDArray[np.integer], position: Floats
) -> Floats:
    """Return the log likelihood ratio (t,) that sides change places before each frame.

    The sum of S (see above) over the pairs; positive speaks for it. position (t,) in
    time, in frames.
    """
    difference = landmarks[..., pairs[:, 0]] - landmarks[..., pairs[:, 1]]
    visible: Flags = np.asarray(np.isfinite(difference).all(axis=1))
    frame = np.where(visible, np.arange(len(visible))[:, None], -1)
    before = np.full_like(frame, -1)
    before[1:] = np.maximum.accumulate(frame, axis=0)[:-1]
    passed = position[:, None] - position[np.maximum(before, 0)]
    is_recent = visible & (before >= 0) & (passed <= MAX_FRAMES_BETWEEN)
    D = np.where(is_recent[:, None], difference, 0.0)
    last = np.take_along_axis(difference, np.maximum(before, 0)[:, None], axis=0)
    last = np.where(is_recent[:, None], last, 0.0)
    same = ((D - last) ** 2).sum(axis=1)
    other = ((D + last) ** 2).sum(axis=1)
    least = np.where(is_recent, np.minimum(same, other), np.nan)
    step = np.sqrt([finite_median(column, 0.0) for column in least.T])
    size = np.sqrt(finite_median((difference**2).sum(axis=1).ravel(), 0.0))
    min_step = max(MIN_STEP * size, 1e-150)
    s2 = np.maximum(step / RAYLEIGH_MEDIAN, min_step) ** 2
    nu = STUDENT_FREEDOM
    S = (nu + 2) / 2 * np.log((nu + same / s2) / (nu + other / s2))
    total: Floats = np.where(is_recent, S, 0.0).sum(axis=1)
    return total


def likeliest_states(change: Floats) -> Flags:
    """Return which frames (t,) are exchanged in the likeliest run; the first is not.

    change (t,): the log likelihood ratios of `find_changes`.
    """
    gain = change - CONSTANTS.exchange_price
    value = np.array([0.0, -np.inf])
    came = np.zeros((len(change), 2), dtype=np.intp)
    for t in range(1, len(change)):
        changed = value[::-1] + gain[t]
        came[t] = np.where(changed > value, [1, 0], [0, 1])
        value = np.maximum(value, changed)
    state = np.zeros(len(change), dtype=bool)
    now = int(value[1] > value[0])
    for t in range(len(change) - 1, -1, -1):
        state[t] = now
        now = int(came[t, now])
    return state
