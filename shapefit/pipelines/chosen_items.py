"""Items chosen by names and globs while they stream by."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase


class ChosenItems:
    """The items that a config key chooses: those that are called or match one of its patterns."""

    def __init__(self, key: str, patterns: Sequence[str]) -> None:
        self._key = key
        self._patterns = tuple(patterns)
        self._used: set[str] = set()

    def __contains__(self, item: str) -> bool:
        """Whether the item is chosen; a name is taken literally before it is taken for a glob."""
        fits = [p for p in self._patterns if p == item or fnmatchcase(item, p)]
        self._used.update(fits)
        return bool(fits)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What chose none of the items asked for so far."""
        unused = [pattern for pattern in self._patterns if pattern not in self._used]
        return tuple(f"{self._key}: no item is called or matches '{p}'" for p in unused)
