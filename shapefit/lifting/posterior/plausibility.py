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
    from scipy.special import chdtrc

    freedom = 2.0 * np.asarray(seen) - VIEWED
    some = freedom > 0
    p: Floats = np.where(some, chdtrc(np.where(some, freedom, 1.0), surprise), np.nan)
    p = np.where(some & (believed < FEWEST_BELIEVED), 0.0, p)
    return np.where(np.isnan(surprise), np.nan, p)
