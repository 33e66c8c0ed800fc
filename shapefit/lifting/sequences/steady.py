"""What every sequence allows: posterior means that do not jump from frame to frame.

    argmin_y  sum_t (y_t - m_t)^2 / sd_t^2  +  sum_t (y_(t-1) - 2 y_t + y_(t+1))^2 / a^2

for the mean m and the standard deviation sd of each coordinate in single images. The means are not
taken apart into modes, and no bone is held rigid: this is for sequences that know no better.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

Floats = NDArray[np.float64]

DIFFERENCE = (1.0, -2.0, 1.0)


def steady(means: Floats, deviations: Floats, acceleration: Floats) -> Floats:
    """Smooth means (t, 3, p) of standard deviations (t, 3, p), inf where nothing is known.

    acceleration a (p,); two frames at least must be known.
    """
    t, _, p = means.shape
    weight = 1 / deviations**2
    fixed = np.zeros((3, t))
    for a, left in enumerate(DIFFERENCE if t > 2 else ()):
        for b, right in enumerate(DIFFERENCE[: a + 1]):
            fixed[a - b, b : b + t - 2] += left * right
    smoothed = np.empty_like(means)
    for axis in range(3):
        for j in range(p):
            bands = fixed / acceleration[j] ** 2
            bands[0] += weight[:, axis, j]
            pull = weight[:, axis, j] * means[:, axis, j]
            smoothed[:, axis, j] = solveh_banded(bands, pull, lower=True)
    return smoothed
