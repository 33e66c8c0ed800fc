"""How plausible an image is under the prior: a p-value of what was observed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats

VIEWED = 6
"""Numbers of a view: rotation, scale, translation; they take up as many of the 2 m coordinates."""


FEWEST_BELIEVED = 3.0
"""Landmarks that fix a view; with fewer that are not gross an image says nothing."""


def find_plausibility(surprise: Floats, seen: NDArray[np.integer], believed: Floats) -> Floats:
    """P(chi^2 > surprise) with 2 m - 6 degrees of freedom for m seen landmarks; (n,).

    believed (n,) is the expected number of seen landmarks that are not gross.

    The surprise is the squared Mahalanobis distance of the landmarks from those expected, averaged
    over the modes, and a price for every gross landmark. Few landmarks have few degrees of
    freedom, so that the p-value does not depend on how many are seen. It is nan where 3 are seen
    or fewer, which any view fits, and where there is no posterior. It is 0 where more are seen,
    but fewer than 3 believed.
    """
    pairs = np.asarray(seen) - VIEWED // 2
    some = pairs > 0
    p: Floats = np.where(some, exceeds(surprise, pairs), np.nan)
    p = np.where(some & (believed < FEWEST_BELIEVED), 0.0, p)
    return np.where(np.isnan(surprise), np.nan, p)


def exceeds(square: Floats, pairs: NDArray[np.integer]) -> Floats:
    """P(chi^2 > x) (n,) with 2 k degrees of freedom: exp(-x/2) sum_(i < k) (x/2)^i / i!.

    square x (n,) and pairs k (n,). The terms are sums of logarithms, for exp(-x/2) alone may be 0.
    """
    half = np.maximum(square, 0.0) / 2
    term, total = -half, np.exp(-half)
    with np.errstate(divide="ignore"):
        for i in range(1, int(pairs.max(initial=0))):
            term = term + np.log(half / i)
            total += np.where(i < pairs, np.exp(term), 0.0)
    return np.minimum(total, 1.0)
