"""Items that are in two parts: found exactly, in memory that does not grow with their number.

The names of all items are hashed to 64 bits, which are sorted out into files by their lowest bits.
A name that is in two parts has a hash that is in one of the files twice; only names with such a
hash are compared.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

import numpy as np

from shapefit.io.layout import RESULTS
from shapefit.io.stored.opening import open_stored
from shapefit.stores.urls import UrlPath

BUCKETS = 256
"""Files that the hashes go to, one of which is in memory at a time: 0.3 MB of 10^7 items."""

MOST_COMPARED = 1_000_000
"""Hashes whose names are compared in one reading of the parts."""

MOST_NAMED = 3
"""Items that are named as examples."""


@dataclass(frozen=True)
class Equal:
    """How many names are in more than one part, and the first of them with two of their parts."""

    count: int
    examples: tuple[tuple[str, Path, Path], ...]

    def __add__(self, other: Equal) -> Equal:
        examples = sorted((*self.examples, *other.examples))[:MOST_NAMED]
        return Equal(self.count + other.count, tuple(examples))

    def __str__(self) -> str:
        named = ", ".join(f"'{item}' in {a.name} and {b.name}" for item, a, b in self.examples)
        more = self.count - len(self.examples)
        return named + (f" and {more} more" if more else "")


def find_equal(parts: Sequence[Path]) -> Equal:
    """Return the items that are in two or more of these results."""
    found = Equal(0, ())
    if len(parts) < 2:
        return found
    for hashes in _met_twice(parts):
        where: dict[str, tuple[Path, Path | None]] = {}
        for part in parts:
            for names in _items(part):
                for row in np.flatnonzero(np.isin(_hashed(names), hashes)).tolist():
                    name = names[row]
                    first, second = where.setdefault(name, (part, None))
                    if first != part and second is None:
                        where[name] = first, part
        both = [(name, a, b) for name, (a, b) in where.items() if b is not None]
        found += Equal(len(both), tuple(sorted(both)[:MOST_NAMED]))
    return found


def _met_twice(parts: Sequence[Path]) -> Iterator[np.ndarray]:
    """Yield the hashes that are there twice, a limited number at a time."""
    with ExitStack() as files:
        beside = None if isinstance(parts[0], UrlPath) else parts[0].parent
        buckets = [files.enter_context(TemporaryFile(dir=beside)) for _ in range(BUCKETS)]
        for part in parts:
            for names in _items(part):
                _sort_out(_hashed(names), buckets)
        held: list[np.ndarray] = []
        for bucket in buckets:
            bucket.seek(0)
            hashes, counts = np.unique(np.frombuffer(bucket.read(), np.int64), return_counts=True)
            held.append(hashes[counts > 1])
            if sum(map(len, held)) >= MOST_COMPARED:
                yield np.concatenate(held)
                held = []
        rest = np.concatenate([np.zeros(0, np.int64), *held])
        if len(rest):
            yield rest


def _sort_out(hashes: np.ndarray, buckets: Sequence[IO[bytes]]) -> None:
    """Append hashes to the files of their lowest bits."""
    own = hashes % len(buckets)
    order = np.argsort(own, kind="stable")
    ends = np.searchsorted(own[order], np.arange(1, len(buckets)))
    for bucket, some in zip(buckets, np.split(hashes[order], ends), strict=True):
        bucket.write(some.tobytes())


def _hashed(names: Sequence[str]) -> np.ndarray:
    return np.fromiter(map(hash, names), np.int64, len(names))


def _items(part: Path) -> Iterator[Sequence[str]]:
    with open_stored(part, RESULTS) as reader:
        yield from reader.read_blocks("item")
