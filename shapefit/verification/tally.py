"""How many images each claim holds for, summed over a file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce

import numpy as np

from shapefit.verification.check import Check


@dataclass
class Count:
    """Images that make a claim, images that miss it, and the largest rounding allowed."""

    made: int = 0
    missed: int = 0
    allowed: float = 0.0


class Tally:
    """Sums up checks; claims keep the order in which they first come."""

    def __init__(self) -> None:
        self.counts: dict[str, Count] = {}

    def add(self, checks: Iterable[Check]) -> None:
        """Take in the checks of some more images; several can be of one claim."""
        for claim, same in _by_claim(checks).items():
            count = self.counts.setdefault(claim, Count())
            made, missed = (
                reduce(np.logical_or, each)
                for each in ((one.made for one in same), (one.missed for one in same))
            )
            count.made += int(np.count_nonzero(made))
            count.missed += int(np.count_nonzero(missed))
            for one in same:
                allowed = one.allowed[one.made & np.isfinite(one.allowed)]
                count.allowed = max(count.allowed, float(allowed.max(initial=0.0)))

    def lines(self) -> list[str]:
        """Return the table as lines of Markdown."""
        head = ["| claim | images | do not hold | rounding allowed |", "|---|--:|--:|--:|"]
        return head + [
            f"| {claim} | {count.made} | {count.missed} | {_number(count.allowed)} |"
            for claim, count in self.counts.items()
        ]


def _by_claim(checks: Iterable[Check]) -> dict[str, list[Check]]:
    found: dict[str, list[Check]] = {}
    for one in checks:
        found.setdefault(one.claim, []).append(one)
    return found


def _number(value: float) -> str:
    return f"{value:.1g}" if value else "none"
