"""Which landmarks are on the left and which on the right, as names or a dictionary say."""

from __future__ import annotations

import re
from collections.abc import Sequence

from shapefit.dictionary.model import Dictionary
from shapefit.geometry.symmetry import lateral_axis

MIDDLE, LEFT, RIGHT = 0, 1, 2

_OTHER = {"left": "right", "Left": "Right", "LEFT": "RIGHT", "l": "r", "L": "R"}
_WORD = re.compile(r"left|Left|LEFT|(?<![A-Za-z])[lL](?![a-z])|^[lL](?=[A-Za-z])")
"""`left` anywhere, `l` alone, and `l` before a name: left_hip, HipLeft, L_Hip, LHip, lhip."""


def find_sides(names: Sequence[str]) -> list[int]:
    """Return MIDDLE, LEFT or RIGHT for each name; what has no counterpart is in the middle."""
    place = {name: number for number, name in enumerate(names)}
    sides = [MIDDLE] * len(names)
    for name, number in place.items():
        for found in _WORD.finditer(name):
            other = name[: found.start()] + _OTHER[found[0]] + name[found.end() :]
            if other in place:
                sides[number], sides[place[other]] = LEFT, RIGHT
    return sides


def halves(dictionary: Dictionary, names: Sequence[str]) -> list[int]:
    """Return one side and the other for the landmarks that `mirror_index` pairs.

    They are those of the mean shape. Which of them is the left one is not known.
    """
    partner = dictionary.mirror_index
    if partner is None:
        return [MIDDLE] * len(names)
    mean = dictionary.mean_shape[lateral_axis(dictionary.mean_shape, partner)]
    place = {name: number for number, name in enumerate(dictionary.landmark_names)}

    def side(name: str) -> int:
        own = place.get(name)
        if own is None or own == partner[own]:
            return MIDDLE
        return LEFT if mean[own] > mean[partner[own]] else RIGHT

    return [side(name) for name in names]
