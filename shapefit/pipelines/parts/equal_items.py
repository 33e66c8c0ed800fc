"""Items that are in two parts: found exactly, in memory that does not grow with their number."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from shapefit.io.layout import RESULTS
from shapefit.io.spilled.columns import nearest_folder
from shapefit.io.spilled.equal_names import Equal, find_equal_names
from shapefit.io.stored.opening import open_stored


def find_equal(parts: Sequence[Path]) -> Equal:
    """Return the items that are in two or more of these results, all in one folder."""
    if not parts:
        return Equal(0, ())
    lists = {part: partial(_items, part) for part in parts}
    return find_equal_names(lists, nearest_folder(parts[0]))


def _items(part: Path) -> Iterator[Sequence[str]]:
    with open_stored(part, RESULTS) as reader:
        yield from reader.read_blocks("item")
