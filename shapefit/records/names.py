"""Names in Unicode's composed form, in which names that look the same are the same."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable


def as_composed(text: str) -> str:
    """Return a text in Unicode's composed form: names that look the same are the same.

    Accented letters have two spellings; macOS writes one, keyboards the other.
    """
    return text if text.isascii() else unicodedata.normalize("NFC", text)


def all_composed(texts: Iterable[str]) -> tuple[str, ...]:
    """Return texts in Unicode's composed form, see `as_composed`."""
    whole = tuple(texts)
    return whole if "".join(whole).isascii() else tuple(map(as_composed, whole))
