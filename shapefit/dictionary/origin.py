"""Where the training shapes of a dictionary come from, and on what terms."""

from __future__ import annotations

from typing import NamedTuple

from shapefit.dictionary.model import Dictionary


class Origin(NamedTuple):
    """Texts of the provenance of a dictionary; None where it does not say."""

    source: str | None
    licence: str | None
    acknowledgement: str | None


def origin_of(dictionary: Dictionary) -> Origin:
    """Return what `learn-dict` stored of the section `origin` of its config."""
    return Origin(*(dictionary.provenance.get(name) for name in Origin._fields))
