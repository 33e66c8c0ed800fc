"""The numbers that stand at given places of the order, exactly, without sorting them all."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Keys = NDArray[np.uint64]

DIGIT = 16
"""Bits by which numbers are counted in one pass."""

SIGN = np.uint64(1 << 63)


def select(
    count: int, blocks: Callable[[], Iterable[Floats]], ranks: Sequence[int], most: int
) -> Floats:
    """x_(r) for each rank r, counted from 0, of `count` numbers without nan: radix selection.

    `blocks` reads the numbers anew; at most `most` of them are held, beside a block. The bits of
    a number, as `ordered_keys` has them, are counted by their first digit, those that begin like
    a number that is sought by the next one, until few enough are left to be sorted.
    """
    wanted = [_Wanted(rank) for rank in ranks]
    shift, size = 64, count
    while size > most and shift:
        shift -= DIGIT
        starts = {each.start for each in wanted}
        counts = {start: np.zeros(1 << DIGIT, np.int64) for start in starts}
        for keys in map(ordered_keys, blocks()):
            for start, own in _beginning(keys, starts, shift + DIGIT):
                digits = (own >> np.uint64(shift)).astype(np.int64) & ((1 << DIGIT) - 1)
                counts[start] += np.bincount(digits, minlength=1 << DIGIT)
        left: dict[int, int] = {}
        for each in wanted:
            left |= each.descend(counts[each.start])
        size = sum(left.values())
    starts = {each.start for each in wanted}
    if not shift:  # all bits are known
        return np.array([numbers(np.array([each.start], np.uint64))[0] for each in wanted])
    found: dict[int, list[Keys]] = {start: [] for start in starts}
    for keys in map(ordered_keys, blocks()):
        for start, own in _beginning(keys, starts, shift):
            found[start].append(own)
    ordered = {start: np.sort(np.concatenate(parts)) for start, parts in found.items()}
    return numbers(np.array([ordered[each.start][each.rank] for each in wanted], np.uint64))


class _Wanted:
    """A rank that is sought among the numbers whose bits begin with `start`."""

    def __init__(self, rank: int) -> None:
        self.rank, self.start = rank, 0

    def descend(self, counts: NDArray[np.int64]) -> dict[int, int]:
        """Go on among the numbers with the next digit; return their beginning and number."""
        ends = np.cumsum(counts)
        digit = int(np.searchsorted(ends, self.rank, "right"))
        self.rank -= int(ends[digit] - counts[digit])
        self.start = self.start << DIGIT | digit
        return {self.start: int(counts[digit])}


def _beginning(keys: Keys, starts: Iterable[int], shift: int) -> Iterator[tuple[int, Keys]]:
    """Each beginning, and the keys whose bits from `shift` on are it."""
    for start in starts:
        if shift == 64:
            yield start, keys
        else:
            yield start, keys[keys >> np.uint64(shift) == np.uint64(start)]


def ordered_keys(values: Floats) -> Keys:
    """Integers that are ordered like the numbers: all bits of a negative one are turned around."""
    bits = np.ascontiguousarray(values, np.float64).view(np.uint64)
    return np.where(bits & SIGN, ~bits, bits | SIGN)


def numbers(keys: Keys) -> Floats:
    """Return the numbers of `ordered_keys`."""
    return np.where(keys & SIGN, keys ^ SIGN, ~keys).view(np.float64)
