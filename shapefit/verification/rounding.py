"""What rounding can do to a number: the bounds within which claims are compared.

A sum of products that takes N roundings, in whatever order, is off by at most N u / (1 - N u) of
the sum of its terms' magnitudes, u = 2^-53 (Higham, Accuracy and Stability of Numerical
Algorithms, section 3.1). No number here takes more than N = 4 (p + 3 m) + 64 roundings of terms,
for p landmarks and m active transforms. The fit has rounded too, in an order of its own: a claim
may be off by twice the bound.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats

UNIT = 2.0**-53
SIDES = 2


def rounding_factor(landmarks: int, transforms: NDArray[np.int64]) -> Floats:
    """2 N u / (1 - N u): the share of its terms' magnitudes by which a claim may be off, (n,)."""
    roundings = (4.0 * (landmarks + 3 * transforms) + 64) * UNIT
    factor: Floats = SIDES * roundings / (1 - roundings)
    return factor
