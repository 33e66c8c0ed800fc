"""When the images of a sequence were taken: missing frames, and the stretches between
long gaps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers, median

ASSUMED_RATE = 24.0
"""Frames a second where no file states it: that of film."""

LONGEST_GAP = 0.25
"""Seconds over which missing frames leave a sequence in one; beyond them motion does
not say where a body has gone.
"""

JITTER = 0.5
"""Frames by which a stated time may be off the number of its frame: clocks of cameras
tremble, and times are rounded.
"""


def place_in_time(
    frames: NDArray[np.integer] | None, times: Floats | None, rate: float, count: int
) -> Floats:
    """Return the places (t,) of `count` images of a sequence in time, in frames from 0.

    frames (t,) rise; without them one image follows the other. times (t,) in seconds,
    nan where they are not stated, count where they contradict the frames.
    """
    steps = np.ones(max(count - 1, 0)) if frames is None else np.diff(frames)
    steps = np.asarray(steps, np.float64)
    if times is not None:
        moved = np.diff(times) * rate
        known = np.isfinite(moved) & (moved > 0)
        steps = np.where(known & (np.abs(moved - steps) > JITTER), moved, steps)
    return np.concatenate([[0.0], np.cumsum(steps)])[:count]


ROUNDED = 1e-3
"""How far a frame rate is from a whole number that it is taken for, of its size."""


def find_rate(frames: NDArray[np.integer] | None, times: Floats | None) -> float | None:
    """Return the frames a second of images of frames (t,) at times (t,) in seconds, by
    the median of their steps; None where times do not say it.
    """
    if frames is None or times is None:
        return None
    known = np.isfinite(times)
    passed, steps = np.diff(times[known]), np.diff(frames[known])
    rates = steps[(passed > 0) & (steps > 0)] / passed[(passed > 0) & (steps > 0)]
    if not len(rates):
        return None
    rate = median(rates)
    near = float(round(rate))
    return near if abs(rate - near) < ROUNDED * near else rate


@dataclass(frozen=True)
class Timeline:
    """The images of one sequence: position (t,) in frames, which rises, and their rate
    in Hz.
    """

    position: Floats
    rate: float

    @classmethod
    def of_frames(cls, count: int, rate: float = ASSUMED_RATE) -> Timeline:
        """Return that of so many frames, none of them missing."""
        return cls(np.arange(count, dtype=np.float64), rate)

    def __len__(self) -> int:
        return len(self.position)

    @cached_property
    def steps(self) -> Floats:
        """Frames from each image to the next (t - 1,)."""
        return np.diff(self.position)

    @cached_property
    def stretches(self) -> list[slice]:
        """Runs of images between which frames are missing for over `LONGEST_GAP`."""
        longest = 1.0 + max(LONGEST_GAP * self.rate, JITTER)
        ends = np.flatnonzero(self.steps > longest) + 1
        return [slice(a, b) for a, b in pairwise([0, *ends.tolist(), len(self)])]

    def second_differences(self) -> Floats:
        """Weights (t, 3) of the second difference that begins at each image; 0 where it
        would leave the sequence or its stretch.

        Of images h and k frames apart

            ((y_3 - y_2) / k - (y_2 - y_1) / h) / sqrt((h + k) / 2),

        which for h = k = 1 is y_1 - 2 y_2 + y_3. Its variance does not depend on h and
        k where a velocity wanders.
        """
        weights = np.zeros((len(self), 3))
        for rows in self.stretches:
            if rows.stop - rows.start < 3:
                continue
            h = self.steps[rows.start : rows.stop - 2]
            k = self.steps[rows.start + 1 : rows.stop - 1]
            size = np.sqrt((h + k) / 2)
            first, last = 1 / (h * size), 1 / (k * size)
            inner = slice(rows.start, rows.stop - 2)
            weights[inner] = np.stack([first, -first - last, last], axis=1)
        return weights

    def on_grid(self, longest: int | None = None) -> Integers:
        """Return the place (t,) of each image among all frames, missing ones too; of a
        gap at most so many.
        """
        steps = np.maximum(np.rint(self.steps), 1)
        if longest is not None:
            steps = np.minimum(steps, longest + 1)
        return np.concatenate([[0], np.cumsum(steps)])[: len(self)].astype(np.int64)
