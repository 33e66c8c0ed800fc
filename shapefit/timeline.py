"""When the images of a sequence were taken: missing frames, and the stretches between
long gaps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers, split_runs

ASSUMED_RATE = 24.0
"""Frames a second where no file states it: that of film."""

UNKNOWN_RATE = 1.0
"""Frames a second in files of formats that must state a rate, where none is known:
their times are numbers of frames.
"""

MAX_GAP_SECONDS = 0.25
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
    """Return the times (t,) of `count` images of a sequence, in frames since the first.

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


ROUNDED = 5e-4
"""How far a frame rate is from one in use that it is taken for, of its size."""

OF_TELEVISION = 1000 / 1001
"""Of a whole number of Hz: 29.97 Hz is 30 of these."""


def find_rate(frames: NDArray[np.integer] | None, times: Floats | None) -> float | None:
    """Return the frames a second of images of frames (t,) at times (t,) in seconds;
    None where times do not say it.

    It is a rate in use where all steps that fit the median step, or that step itself,
    are near it; else that of all these steps. All come first: times are rounded, and
    the median of 24 Hz in whole milliseconds is nearer to 23.976.
    """
    if frames is None or times is None:
        return None
    known = np.isfinite(times)
    passed = np.diff(times[known])
    steps = np.diff(frames[known])
    forward = (passed > 0) & (steps > 0)
    passed, steps = passed[forward], steps[forward]
    if not len(steps):
        return None
    usual = np.sort(steps / passed)[(len(steps) - 1) // 2]
    fitting = np.abs(passed * usual - steps) <= JITTER
    count = float(steps[fitting].sum())
    seconds = float(passed[fitting].sum())
    for rate in (count / seconds, float(usual)):
        whole = float(round(rate))
        broadcast = round(rate / OF_TELEVISION) * OF_TELEVISION
        for near in (whole, broadcast):
            alike = abs(rate - near) < ROUNDED * near
            if alike and abs(seconds * near - count) <= JITTER:
                return near
    return count / seconds


def begins_sequence(sequences: Sequence[str]) -> Flags:
    """Flag the items (n - 1,), from the second on, that begin a sequence.

    They have another name in `sequences` (n,) than the item before, or none: an item
    without a sequence is by itself.
    """
    names = np.array(sequences, dtype=object)
    is_new: Flags = (names[1:] != names[:-1]) | (names[1:] == "")
    return is_new


@dataclass(frozen=True, eq=False, repr=False)
class Timeline:
    """The images of one sequence: position (t,) in frames, which rises, and their rate
    in Hz.
    """

    position: Floats
    rate: float

    @classmethod
    def of_frames(cls, count: int, rate: float = ASSUMED_RATE) -> Timeline:
        """Return the timeline of `count` frames in a row, none of them missing."""
        return cls(np.arange(count, dtype=np.float64), rate)

    def __len__(self) -> int:
        return len(self.position)

    @cached_property
    def steps(self) -> Floats:
        """Frames from each image to the next (t - 1,)."""
        return np.diff(self.position)

    @cached_property
    def stretches(self) -> list[slice]:
        """Slices of images, cut where frames are missing for over `MAX_GAP_SECONDS`."""
        longest = 1.0 + max(MAX_GAP_SECONDS * self.rate, JITTER)
        return split_runs(self.steps > longest, len(self))

    def second_differences(self) -> Floats:
        """Return weights (t, 3) of the second difference that begins at each image.

        They are 0 where it would leave the sequence or its stretch. Of images h and k
        frames apart

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

    def frame_numbers(self, max_missing: int | None = None) -> Integers:
        """Return the number (t,) of each image's frame, missing frames counted.

        Positions rounded to whole numbers, from 0 and rising. A gap counts as at most
        `max_missing` frames, which shortens long ones.
        """
        steps = np.maximum(np.rint(self.steps), 1)
        if max_missing is not None:
            steps = np.minimum(steps, max_missing + 1)
        return np.concatenate([[0], np.cumsum(steps)])[: len(self)].astype(np.int64)


def parse_frame_range(text: str | None) -> tuple[int | None, int | None]:
    """Parse a range of frames, such as "100:400", into first and stop; None if open.

    Raises ValueError for other texts, and for a range without frames.
    """
    if text is None:
        return None, None
    ends = text.split(":")
    if len(ends) != 2 or not all(end == "" or end.isdecimal() for end in ends):
        raise ValueError(
            f"{text!r} is no range of frames; give FIRST:STOP, such as 100:400"
        )
    first, stop = (int(end) if end else None for end in ends)
    if stop is not None and (first or 0) >= stop:
        raise ValueError(f"{text!r} has no frames; give a STOP after FIRST")
    return first, stop
