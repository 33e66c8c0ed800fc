"""One claim of a result about many images, by how much they miss it, and how many hold.

A sum of products that takes N roundings, in whatever order, is off by at most N u / (1 - N u) of
the sum of its terms' magnitudes, u = 2^-53 (Higham, Accuracy and Stability of Numerical
Algorithms, section 3.1). No number here takes more than N = 4 (p + 3 m) + 64 roundings of terms,
for p landmarks and m active transforms. The fit has rounded too, in an order of its own: a claim
may be off by twice the bound.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats

UNIT = 2.0**-53
SIDES = 2


def rounding_factor(landmarks: int, transforms: NDArray[np.int64]) -> Floats:
    """2 N u / (1 - N u): the share of its terms' magnitudes by which a claim may be off, (n,)."""
    roundings = (4.0 * (landmarks + 3 * transforms) + 64) * UNIT
    factor: Floats = SIDES * roundings / (1 - roundings)
    return factor


@dataclass(frozen=True)
class Check:
    """How far n images are from what a claim says: `off` (n,) may be at most `allowed` (n,).

    An `off` that is nan misses every claim, and what cannot be bounded allows nothing. `made` (n,)
    are the images of which the claim is made.
    """

    claim: str
    off: Floats
    allowed: Floats
    made: Flags

    @cached_property
    def missed(self) -> Flags:
        """The images (n,) that the claim is made of and does not hold for."""
        holds = (self.off <= self.allowed) & np.isfinite(self.allowed)
        return np.asarray(self.made & ~holds)

    def reason(self, image: int) -> str:
        """Say how one image misses the claim."""
        if np.isnan(self.off[image]):
            return f"{self.claim}: not a number is stated"
        if not np.isfinite(self.off[image]):
            return f"{self.claim}: it is not so"
        return (
            f"{self.claim}: off by {self.off[image]:.2g}, rounding allows {self.allowed[image]:.1g}"
        )

    def of_images(self, rows: NDArray[np.intp], count: int) -> Check:
        """Return the check of `count` images, of which these were the images `rows`."""
        if len(rows) == count:
            return self
        off, allowed = np.zeros(count), np.zeros(count)
        made = np.zeros(count, dtype=bool)
        off[rows], allowed[rows], made[rows] = self.off, self.allowed, self.made
        return Check(self.claim, off, allowed, made)


def largest(values: Floats) -> Floats:
    """Return the largest number of each image (n,) of values (n, ...), nan where one is nan.

    NumPy is quicker along the images than within one.
    """
    n, size = len(values), math.prod(values.shape[1:])
    found: Floats = np.ascontiguousarray(values.reshape(n, size).T).max(axis=0)
    return found


def check(claim: str, off: Floats, allowed: Floats | float, made: Flags | None = None) -> Check:
    """Return the check of differences (n, ...), each allowed so much; the worst of an image counts.

    `made` None is all images.
    """
    n, shape = len(off), off.shape
    off = off.reshape(n, math.prod(shape[1:]))
    allowed = np.asarray(allowed, dtype=float)
    if off.shape[1] == 1:
        off, allowed = off[:, 0], allowed.reshape(-1)
    elif allowed.size <= max(n, 1):
        off, allowed = largest(off), allowed.reshape(-1)
    else:
        allowed = np.broadcast_to(allowed, (n, *shape[1:])).reshape(off.shape)
        with np.errstate(invalid="ignore"):
            excess = off - allowed
        worst = np.where(np.isnan(excess), np.inf, excess).argmax(axis=1)[:, None]
        off, allowed = (np.take_along_axis(x, worst, axis=1)[:, 0] for x in (off, allowed))
    if made is None:
        made = np.ones(n, dtype=bool)
    return Check(claim, off, np.array(np.broadcast_to(allowed, n)), made)


def flagged(claim: str, holds: Flags) -> Check:
    """Return the check of what holds or does not, with nothing between."""
    return check(claim, np.where(holds, 0.0, np.inf), 0.0)


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
