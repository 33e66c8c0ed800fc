"""Long lists of names, cut short for messages."""

from __future__ import annotations

from collections.abc import Sequence


def abbreviate(names: Sequence[str]) -> str:
    """Name the first five, and count the others."""
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
