"""Items by name: the one that each image names, and those that a config chooses."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from shapefit.errors import input_error
from shapefit.io.records import Records

BY_ITEM = "item"
"""Stands for the items of the images themselves."""


def named_items(
    images: Records,
    dataset: str,
    place: str | Path,
    key: str,
) -> tuple[str, ...]:
    """Return what a dataset of the images names, one per image; BY_ITEM names the items.

    `key` of the config chose the dataset. Raises InputError at `place` where they have no
    such dataset with one name per image.
    """
    if dataset == BY_ITEM:
        return images.items
    per_item = {name: images.per_item(name) for name in images.further}
    named = {name: v for name, v in per_item.items() if v is not None and v.ndim == 1}
    if dataset not in named:
        found = f"there is no dataset '{dataset}' with one name per image"
        texts = (name for name, values in named.items() if values.dtype.kind in "OSU")
        others = ", ".join([BY_ITEM, *sorted(texts)])
        raise input_error(place, found, f"set `{key}` to one of: {others}")
    return tuple(map(str, named[dataset]))


def matches(item: str, pattern: str) -> bool:
    """Whether an item is called `pattern` or matches it as a glob: `a[1]` matches a[1] and a1."""
    return pattern == item or fnmatchcase(item, pattern)


class ChosenItems:
    """The items that a config key chooses: those that match one of its patterns."""

    def __init__(self, key: str, patterns: Sequence[str]) -> None:
        self._key = key
        self._patterns = tuple(patterns)
        self._used: set[str] = set()

    def __contains__(self, item: str) -> bool:
        """Whether the item is chosen."""
        matching = [pattern for pattern in self._patterns if matches(item, pattern)]
        self._used.update(matching)
        return bool(matching)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What chose none of the items asked for so far."""
        unused = [pattern for pattern in self._patterns if pattern not in self._used]
        return tuple(f"{self._key}: no item has this name or matches '{p}'" for p in unused)


def spread(wanted: int, count: int) -> tuple[int, ...]:
    """Return the middle of each of as many equal parts of 0..count - 1 as wanted."""
    parts = min(wanted, count)
    return tuple((2 * part + 1) * count // (2 * parts) for part in range(parts))
