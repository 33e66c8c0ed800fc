"""How far a turntable has turned at each frame of a sequence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from shapefit.arrays import Floats
from shapefit.io import ShapeSource


def sequence_lengths(source: ShapeSource) -> Counter[str]:
    """Count the frames of each sequence."""
    lengths: Counter[str] = Counter()
    for names in source.sequences():
        lengths.update(names)
    return lengths


class Turntable:
    """Counts the frames of each sequence: frame t of n has made t / n of a turn."""

    def __init__(self, lengths: Mapping[str, int]) -> None:
        self._length = lengths
        self._seen: Counter[str] = Counter()

    def turns(self, sequences: Sequence[str]) -> Floats:
        """Return the turns (n,) of the next n frames, which belong to these sequences."""
        turns = np.empty(len(sequences))
        for frame, name in enumerate(sequences):
            turns[frame] = self._seen[name] / self._length[name]
            self._seen[name] += 1
        return turns
