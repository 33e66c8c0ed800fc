"""The order of items in time: by the numbers of their frames, sequence by sequence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Integers
from shapefit.errors import input_error


def order_by_frame(
    sequences: Sequence[str] | None, frames: Integers | None
) -> NDArray[np.intp] | None:
    """Return the indices (n,) that sort items by frame, sequence by sequence, or None.

    None where the frames rise already, and without sequences or frames. Items of no
    sequence, "", stay in their order.
    """
    if sequences is None or frames is None:
        return None
    which, places = _number_sequences(sequences, frames)
    together = np.argsort(which, kind="stable")
    same = np.diff(which[together]) == 0
    if not (same & (np.diff(places[together]) < 0)).any():
        return None
    return np.lexsort((places, which))


def check_frames(
    sequences: Sequence[str] | None,
    frames: Integers | None,
    items: Sequence[str],
    place: str,
) -> None:
    """Raise InputError at the place where a sequence has two items in one frame."""
    if sequences is None or frames is None:
        return
    which, places = _number_sequences(sequences, frames)
    order = np.lexsort((places, which))
    again = (np.diff(which[order]) == 0) & (np.diff(places[order]) == 0)
    for row in np.flatnonzero(again).tolist():
        one, other = sorted(order[row : row + 2].tolist())
        if sequences[one] and items[one] != items[other]:
            problem = f"holds '{items[one]}' and '{items[other]}' in one frame"
            raise input_error(place, problem, "keep one pose of a body per frame")


def _number_sequences(
    sequences: Sequence[str], frames: Integers
) -> tuple[NDArray[np.intp], Integers]:
    """Return the number of the sequence (n,) and the frame (n,) of each item.

    The frame of an item without a sequence, "", is 0.
    """
    number: dict[str, int] = {}
    which = np.array([number.setdefault(s, len(number)) for s in sequences], np.intp)
    return which, np.where(which == number.get("", -1), 0, frames)
