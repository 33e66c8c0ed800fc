"""The noise of the landmarks of a sequence, found in the sequence itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.lifting.sequences.observations import Observations
from shapefit.lifting.sequences.smoothing import Model, Smoothed, smooth

Floats = NDArray[np.float64]

LEVELS = (0.003, 0.01, 0.03, 0.06)
"""Standard deviations of a coordinate that are tried, in units of the size of the landmarks.

The last one is that with which the posteriors of the images took them.
"""

FIRST = 3
"""The level that is tried first."""

NEXT_TO_NONE = 0.01
"""Noise up to this is taken as it is found: what it has in common over time does not matter."""

WINDOW = 120
"""Frames in the middle of a sequence from which the noise is found."""


def find_noise(seen: Observations, model: Model) -> float:
    """Return the sigma of the objective of `smooth`, from the middle of the sequence.

    The level of the most evidence: from the first one on the noise falls, or else rises, as long
    as the evidence grows. Detectors err alike from frame to frame, so that as many frames say less
    than they seem to: with the correlation r of the residuals of neighbours sigma grows by
    sqrt((1 + r) / (1 - r)), at most to that of the images alone.
    """
    most = float(np.sqrt(seen.misfit))
    levels = (*(level for level in LEVELS if level < most), most)
    first = max(0, (len(seen) - WINDOW) // 2)
    part = seen.take(slice(first, first + WINDOW))
    best = min(FIRST, len(levels) - 1)
    first_level, at = best, smooth(part, model, levels[best])
    for step in (-1, 1):
        tried = best + step
        found: Smoothed = at
        while 0 <= tried < len(levels):
            found = smooth(part, model, levels[tried], found)
            if found.log_evidence <= at.log_evidence:
                break
            best, at, tried = tried, found, tried + step
        if best != first_level:
            break
    if levels[best] <= NEXT_TO_NONE:
        return levels[best]
    r = correlation(part, at)
    return min(levels[best] * float(np.sqrt((1 + r) / (1 - r))), most)


def correlation(seen: Observations, found: Smoothed) -> float:
    """Correlation of the residuals of trusted landmarks between neighbouring frames, 0 to 0.98."""
    left = np.nan_to_num(seen.landmarks) - found.points[:, :2]
    left = left * np.sqrt(seen.trust)[:, None]
    whole = float((left**2).sum())
    shared = float((left[1:] * left[:-1]).sum()) / whole if whole > 0 else 0.0
    return min(max(shared, 0.0), 0.98)
