"""Which frames of a page show several individuals at one moment."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from shapefit.arrays import Integers
from shapefit.io.foreign.items import FRAME
from shapefit.pipelines.view.frames import Frames
from shapefit.pipelines.view.gathering import Gathered

FILES = "*"
"""In the place of a video: files of one individual each, which are shown together."""


def find_moments(found: Sequence[Gathered], frames: Frames) -> Integers | None:
    """Return a number (n,) that frames of one moment share, 0 for others; None where all are 0.

    The individuals of a video are its sequences, `video/individual`; or each is a file. Frames of
    one moment have the same number in the dataset `frame`.
    """
    owner = {
        item: each.name for each in found for listing in each.listings for item in listing.items
    }
    numbers = np.full(len(frames.items), np.nan)
    for each in found:
        numbers = np.where(np.isfinite(numbers), numbers, each.of_frames.get(FRAME, np.nan))
    starts = [*(start for _, start in frames.sequences), len(frames.items)]
    names = [name for name, _ in frames.sequences]
    owners = [owner.get(frames.items[start]) for start in starts[:-1]]
    each_a_file = len(set(owners)) == len(owners)
    members: dict[tuple[str, int], list[int]] = {}
    for name, (start, end) in zip(names, pairwise(starts), strict=True):
        video = name.rpartition("/")[0] or (FILES if name and each_a_file else "")
        for frame in range(start, end) if video else ():
            if np.isfinite(numbers[frame]):
                members.setdefault((video, int(numbers[frame])), []).append(frame)
    moments = np.zeros(len(frames.items), dtype=np.int64)
    shared = [several for several in members.values() if len(several) > 1]
    for moment, several in enumerate(shared, 1):
        moments[several] = moment
    return moments if shared else None
