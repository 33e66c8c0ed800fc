"""Where the values of a config were said."""

from __future__ import annotations

from typing import NamedTuple

Location = tuple[str | int, ...]
"""The keys and list positions that lead to a value."""


class Place(NamedTuple):
    """Where a key and its value stand, as a message names them."""

    key: str
    value: str
