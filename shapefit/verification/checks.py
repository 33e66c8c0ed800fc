"""Claims about many images: by how much each misses a claim, and how much rounding allows.

A sum that takes N roundings is off by at most N u / (1 - N u) of the sum of its terms' magnitudes,
u = 2^-53 (Higham, Accuracy and Stability of Numerical Algorithms, section 3.1). Everything here is
allowed C u (p + 3 m) (1 + r) sum |terms| for p landmarks and m active transforms, the fit having
rounded in an order of its own, r being how many of their sizes the landmarks lie from the origin;
and 1e-9 of the number itself at least.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shapefit.arrays import Flags, Floats

ROUNDING = 32 * 2.0**-53
"""C u: a landmark or a transform takes part in a handful of sums, in the fit and here."""
FLOOR = 1e-9
"""Share of a number by which it may always be off."""

Columns = Mapping[str, NDArray[Any]]
"""Datasets of n images of a result by name; points one a column, (n, 3, p) or (n, 2, p)."""


@dataclass(frozen=True)
class Check:
    """How far n images are from a claim: `off` (n,) may be at most `allowed` (n,).

    made (n,), the images of which it is claimed. What is nan, or allowed without bound, misses it.
    """

    claim: str
    off: Floats
    allowed: Floats
    made: Flags

    @cached_property
    def missed(self) -> Flags:
        """The images (n,) for which the claim is false."""
        return np.asarray(self.made & ~((self.off <= self.allowed) & (self.allowed < np.inf)))

    def reason(self, image: int) -> str:
        """Say how one image misses the claim."""
        if not np.isfinite(self.off[image]):
            return f"{self.claim}: it is not so"
        return f"{self.claim}: off by {self.off[image]:.2g}, allowed {self.allowed[image]:.1g}"


@dataclass
class Checks:
    """The checks of n images; `fitted` (n,) are those with a shape, of which most is claimed.

    columns, what the result states; settled: the datasets in which no number can be another one
    without a check that fails.
    """

    fitted: Flags
    columns: Columns
    made: list[Check] = field(default_factory=list)
    settled: set[str] = field(default_factory=set)

    def add(
        self,
        claim: str,
        off: Floats,
        allowed: Floats | float,
        settles: str = "",
        of: Flags | None = None,
    ) -> None:
        """Add a claim about differences (n, ...), of which the worst of an image counts.

        allowed (n, ...) or (n,) as the differences; settles: datasets, with spaces between; of
        (n,): the images of which it is claimed, those with a shape unless given.
        """
        n = len(self.fitted)
        off = np.reshape(off, (n, -1)) if n else np.zeros((0, 1))
        allowed = np.asarray(allowed, dtype=np.float64)
        if allowed.size > max(n, 1):
            allowed = np.broadcast_to(allowed.reshape(n, -1), off.shape)
            with np.errstate(invalid="ignore"):
                worst = np.nan_to_num(off - allowed, nan=np.inf).argmax(axis=1)[:, None]
            off, allowed = (np.take_along_axis(each, worst, axis=1) for each in (off, allowed))
        allowed = np.broadcast_to(allowed.reshape(-1), n)
        self.made.append(Check(claim, largest(off), allowed, self.fitted if of is None else of))
        self.settled.update(settles.split())

    def equal(self, name: str, of_what: str, found: Floats, allowed: Floats | float) -> None:
        """Add the claim that a dataset (n, ...) follows, as found, from something else."""
        off = np.abs(self.columns[name] - found)
        self.add(f"{name} follows from {of_what}", off, allowed, name)

    def hold(
        self, claim: str, holds: ArrayLike, settles: str = "", of: Flags | None = None
    ) -> None:
        """Add a claim that holds or not, with nothing between."""
        self.add(claim, np.where(holds, 0.0, np.inf), 0.0, settles, of)

    def missed(self) -> Flags:
        """The images (n,) for which some claim is false."""
        return np.any([np.zeros_like(self.fitted), *(one.missed for one in self.made)], axis=0)

    def reasons(self) -> Sequence[tuple[int, str]]:
        """Each image with a false claim, and the first of its false claims."""
        found = []
        for image in np.flatnonzero(self.missed()).tolist():
            first, *more = (one for one in self.made if one.missed[image])
            also = f" (and {len(more)} more)" if more else ""
            found.append((image, first.reason(image) + also))
        return found


def largest(values: Floats) -> Floats:
    """Return the largest number of each image (n,) of values (n, ...), nan where one is nan.

    NumPy is quicker along the images than within one.
    """
    if not len(values):
        return np.zeros(0)
    found: Floats = np.ascontiguousarray(values.reshape(len(values), -1).T).max(axis=0)
    return found
