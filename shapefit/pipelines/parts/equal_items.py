"""Items that are in two parts: found exactly, in memory that does not grow with their number."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from tempfile import gettempdir

from shapefit.io.layout import RESULTS
from shapefit.io.spilled.equal_names import Equal, find_equal_names
from shapefit.io.stored.opening import open_stored
from shapefit.stores.urls import UrlPath


def find_equal(parts: Sequence[Path]) -> Equal:
    """Return the items that are in two or more of these results, all in one folder."""
    if not parts:
        return Equal(0, ())
    beside = Path(gettempdir()) if isinstance(parts[0], UrlPath) else parts[0].parent
    return find_equal_names({part: partial(_items, part) for part in parts}, beside)


def _items(part: Path) -> Iterator[Sequence[str]]:
    with open_stored(part, RESULTS) as reader:
        yield from reader.read_blocks("item")
