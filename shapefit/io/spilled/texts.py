"""A column of texts, such as the names of many items."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.io.spilled.columns import Column, stretches

AT_A_TIME = 1 << 14
"""Texts that are read at a time."""


class Texts:
    """Texts that are appended, then read by slices like a tuple."""

    def __init__(self, folder: Path | None) -> None:
        self._letters = Column(folder, np.uint8)
        self._ends = Column(folder, np.int64)

    def __len__(self) -> int:
        return len(self._ends)

    def append(self, texts: Iterable[str]) -> None:
        """Append texts."""
        encoded = [text.encode("utf-8", "surrogatepass") for text in texts]
        sizes = np.fromiter(map(len, encoded), np.int64, len(encoded))
        before = len(self._letters)
        self._letters.append(np.frombuffer(b"".join(encoded), np.uint8))
        self._ends.append(before + np.cumsum(sizes))

    def __getitem__(self, rows: slice) -> tuple[str, ...]:
        start, stop, _ = rows.indices(len(self))
        if start >= stop:
            return ()
        ends = self._ends[max(start - 1, 0) : stop]
        if start == 0:
            ends = np.concatenate([[0], ends])
        letters = self._letters[int(ends[0]) : int(ends[-1])].tobytes()
        places = (ends - ends[0]).tolist()
        if letters.isascii():
            text = letters.decode("ascii")
            return tuple(text[a:b] for a, b in pairwise(places))
        return tuple(letters[a:b].decode("utf-8", "surrogatepass") for a, b in pairwise(places))

    def take(self, rows: NDArray[np.intp]) -> tuple[str, ...]:
        """Return the texts of these rows, in their order."""
        unique, places = np.unique(rows, return_inverse=True)
        found: list[str] = []
        for part in stretches(unique):
            own = unique[part]
            read = self[int(own[0]) : int(own[-1]) + 1]
            found += [read[row] for row in (own - own[0]).tolist()]
        return tuple(found[place] for place in places.reshape(-1).tolist())

    def blocks(self, start: int = 0, stop: int | None = None) -> Iterator[tuple[str, ...]]:
        """Read the texts of these rows, some thousand at a time."""
        end = len(self) if stop is None else stop
        return (self[row : min(row + AT_A_TIME, end)] for row in range(start, end, AT_A_TIME))
