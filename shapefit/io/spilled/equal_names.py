"""Names that are in two lists: found exactly, in memory that does not grow with their number.

Only names whose hash is there twice are compared.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from shapefit.io.spilled.name_index import Hashes, hashed, index_of

MOST_COMPARED = 1_000_000
"""Hashes whose names are compared in one reading of the lists."""

MOST_NAMED = 3
"""Names that are given as examples."""

Blocks = Callable[[], Iterable[Sequence[str]]]
"""Reads the names of a list anew, block by block."""


@dataclass(frozen=True)
class Equal:
    """How many names are in more than one list, and the first of them with two of their lists."""

    count: int
    examples: tuple[tuple[str, Path, Path], ...]

    def __add__(self, other: Equal) -> Equal:
        examples = sorted((*self.examples, *other.examples))[:MOST_NAMED]
        return Equal(self.count + other.count, tuple(examples))

    def __str__(self) -> str:
        named = ", ".join(f"'{item}' in {a.name} and {b.name}" for item, a, b in self.examples)
        more = self.count - len(self.examples)
        return named + (f" and {more} more" if more else "")


def find_equal_names(lists: Mapping[Path, Blocks], folder: Path | None) -> Equal:
    """Return the names that are in two or more of these lists, each of which a file holds.

    Hashes that do not fit in memory go to an unnamed file in the folder, as a `Column` does.
    """
    found = Equal(0, ())
    if len(lists) < 2:
        return found
    for hashes in _met_twice(lists, folder):
        where: dict[str, tuple[Path, Path | None]] = {}
        for file, blocks in lists.items():
            for names in blocks():
                for row in np.flatnonzero(np.isin(hashed(names), hashes)).tolist():
                    name = names[row]
                    first, second = where.setdefault(name, (file, None))
                    if first != file and second is None:
                        where[name] = first, file
        both = [(name, a, b) for name, (a, b) in where.items() if b is not None]
        found += Equal(len(both), tuple(sorted(both)[:MOST_NAMED]))
    return found


def _met_twice(lists: Mapping[Path, Blocks], folder: Path | None) -> Iterator[Hashes]:
    """Yield the hashes that are there twice, a limited number at a time."""
    index = index_of(folder, chain.from_iterable(blocks() for blocks in lists.values()))
    held: list[Hashes] = []
    for hashes in index.repeated():
        held.append(hashes)
        if sum(map(len, held)) >= MOST_COMPARED:
            yield np.concatenate(held)
            held = []
    if any(map(len, held)):
        yield np.concatenate(held)
