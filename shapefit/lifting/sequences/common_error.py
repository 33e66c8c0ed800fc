"""Error bars of a sequence whose frames have a part of their errors in common.

    C_t = S_t + r^2 P_t + (k sigma)^2 I

for the covariance S_t of a landmark that smoothing gives, P_t of the image alone, and the noise
sigma of the landmarks. Smoothing takes the errors of frames for independent. But what the prior and
the view get wrong in one frame they get wrong in its neighbours, too, and it does not average out:
of the deviations of the images the share r stays. Nor does what a detector gets wrong of a landmark
in all frames: that is about as large as the noise.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats

SHARE = 0.4
"""r, chosen on clips of subject 86 that the prior had not seen: exact landmarks, white noise,
correlated noise, and 30% hidden. 90% of their truth is then in the 90% ellipsoids."""

KEPT = 0.9
"""k, chosen on footage (benchmarks/footage.py) of six bodies other than 86, 13 and 14."""

PAIRS = ((0, 1), (0, 2), (1, 2))
"""Coordinates of a landmark, in the order of the correlations."""


def add_common_error(
    smoothed: tuple[Floats, Floats],
    images: tuple[Floats, Floats],
    share: float = SHARE,
    constant: Floats | float = 0.0,
) -> tuple[Floats, Floats]:
    """Deviations and correlations of C, from those of S and P, all (n, 3, p), and k sigma (n,).

    Correlations of x with y, x with z, and y with z of each landmark. A correlation of a landmark
    that has no deviation is 0.
    """
    (own, mixed), (image, image_mixed) = smoothed, images
    deviation = np.hypot(np.hypot(own, share * image), np.reshape(constant, (-1, 1, 1)))
    correlation = np.empty_like(deviation)
    for row, (a, b) in enumerate(PAIRS):
        covariance = mixed[:, row] * own[:, a] * own[:, b]
        covariance = covariance + share**2 * image_mixed[:, row] * image[:, a] * image[:, b]
        product = deviation[:, a] * deviation[:, b]
        correlation[:, row] = covariance / np.where(product == 0, 1.0, product)
    return deviation, correlation


def nearest_known(known: NDArray[np.bool_], clips: Iterable[slice]) -> NDArray[np.intp]:
    """Row (n,) of the nearest frame of the same clip that is known (n,), its own where none is.

    An image that says nothing has a covariance that says nothing of the errors of its frame.
    """
    rows = np.arange(len(known))
    for clip in clips:
        there, lacking = np.flatnonzero(known[clip]), np.flatnonzero(~known[clip])
        if len(there) and len(lacking):
            nearest = np.abs(lacking[:, None] - there).argmin(axis=1)
            rows[clip.start + lacking] = clip.start + there[nearest]
    return rows
