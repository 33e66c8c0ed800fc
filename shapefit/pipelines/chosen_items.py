"""Items chosen by names and globs, or as many as wanted from all over the input."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase


def fits(item: str, pattern: str) -> bool:
    """Whether an item is called `pattern` or matches it as a glob: `a[1]` fits a[1] and a1."""
    return pattern == item or fnmatchcase(item, pattern)


class ChosenItems:
    """The items that a config key chooses: those that fit one of its patterns."""

    def __init__(self, key: str, patterns: Sequence[str]) -> None:
        self._key = key
        self._patterns = tuple(patterns)
        self._used: set[str] = set()

    def __contains__(self, item: str) -> bool:
        """Whether the item is chosen."""
        fitting = [pattern for pattern in self._patterns if fits(item, pattern)]
        self._used.update(fitting)
        return bool(fitting)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What chose none of the items asked for so far."""
        unused = [pattern for pattern in self._patterns if pattern not in self._used]
        return tuple(f"{self._key}: no item is called or matches '{p}'" for p in unused)


def spread(wanted: int, count: int) -> tuple[int, ...]:
    """Return the middle of each of as many equal parts of 0..count - 1 as wanted."""
    parts = min(wanted, count)
    return tuple((2 * part + 1) * count // (2 * parts) for part in range(parts))
