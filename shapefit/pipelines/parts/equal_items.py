"""Items that are in two parts: found exactly, in memory that does not grow with their number.

Names are put in two orders: that of their characters, and the shorter ones first. Names with
numbers of a fixed width follow one another in the first, `image9`, `image10` in the second. Two
parts whose names lie apart in either order have no name in common, and are not read.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from shapefit.io.names import Equal, Hashes, find_equal_names, repeated, stable_hashes
from shapefit.io.source import open_results

Key = TypeVar("Key")
Order = Callable[["Span"], tuple[Any, Any]]


@dataclass(frozen=True)
class Span:
    """The first and last of some names by their characters, and with the shorter ones first."""

    first: str
    last: str
    shortest: str
    longest: str

    @classmethod
    def of(cls, names: Iterable[str]) -> Span:
        """Return the span of names, at least one."""
        names = tuple(names)
        return cls(min(names), max(names), min(names, key=by_length), max(names, key=by_length))

    def __or__(self, other: Span) -> Span:
        return Span.of((*vars(self).values(), *vars(other).values()))


def by_length(name: str) -> tuple[int, str]:
    """Return what sorts the shorter names first."""
    return len(name), name


ORDERS: tuple[Order, ...] = (
    lambda span: (span.first, span.last),
    lambda span: (by_length(span.shortest), by_length(span.longest)),
)


def overlapping(spans: Mapping[Key, Span]) -> list[list[Key]]:
    """Return groups of two or more parts; only those in one group can share a name."""
    groups = [list(spans)]
    before = 0
    while len(groups) > before:
        before = len(groups)
        for order in ORDERS:
            groups = [part for group in groups for part in _split(group, spans, order)]
    return [group for group in groups if len(group) > 1]


def _split(group: Sequence[Key], spans: Mapping[Key, Span], order: Order) -> Iterator[list[Key]]:
    """Yield the parts whose ranges touch one another together, in one of the orders."""
    ranged = sorted(((order(spans[key]), key) for key in group), key=lambda each: each[0])
    together: list[Key] = []
    reached: Any = None
    for (first, last), key in ranged:
        if together and first > reached:
            yield together
            together = []
        reached = last if not together else max(reached, last)
        together.append(key)
    if together:
        yield together


def find_equal_items(
    spans: Mapping[Path, Span], met: list[Hashes], lifted: Collection[Path]
) -> Equal:
    """Return the items that are in two or more results, all in one folder.

    met: the stable hashes of the names in the results that were just `lifted`. Of others they are
    read where these may share a name, and those in question all where two hashes are the same.
    Where nothing was lifted, an earlier run has reported them.
    """
    groups = overlapping(spans) if lifted else []
    for part in (part for group in groups for part in group if part not in lifted):
        for block in _items(part):
            met.append(stable_hashes(block))
    if not groups or not met or not len(repeated(np.concatenate(met))):
        return Equal(0, ())
    return sum((find_equal(sorted(group)) for group in groups), Equal(0, ()))


def find_equal(parts: Sequence[Path]) -> Equal:
    """Return the items that are in two or more of these results, which are read."""
    lists = {part: partial(_items, part) for part in parts}
    return find_equal_names(lists)


def _items(part: Path) -> Iterator[Sequence[str]]:
    with open_results([part]) as source:
        yield from source.names()
