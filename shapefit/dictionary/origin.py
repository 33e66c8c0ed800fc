"""Where the training shapes of a dictionary come from, and on what terms."""

from __future__ import annotations

from typing import NamedTuple

from shapefit.dictionary.model import LEARNED_FROM, NEAR_AND_FAR, OPEN, VERDICT, Dictionary


class Origin(NamedTuple):
    """Texts of the provenance of a dictionary; None where it does not say."""

    source: str | None
    licence: str | None
    acknowledgement: str | None


def origin_of(dictionary: Dictionary) -> Origin:
    """Return what `learn-dict` stored of the section `origin` of its config."""
    return Origin(*(dictionary.provenance.get(name) for name in Origin._fields))


def describe_learning(dictionary: Dictionary) -> tuple[str, ...]:
    """Say of a class that was learned from 2D landmarks how sure its depth is; else nothing."""
    known = dictionary.provenance
    if LEARNED_FROM not in known:
        return ()
    verdict = known.get(VERDICT, "of an earlier version, which stored no verdict")
    line = f"the class was learned from 2D {known[LEARNED_FROM]}: {verdict}; near and far "
    if dictionary.depth_is_open:
        line += (
            f"{OPEN}, so that no image is trusted and error bars cover both: learn it again with "
            "`flip=true` or `flip=false`, as results show it"
        )
    else:
        line += known[NEAR_AND_FAR]
    return (line,)
