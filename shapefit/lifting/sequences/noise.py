"""The noise of the landmarks of a sequence, and how fast they move: both from the sequence itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.lifting.sequences.observations import Observations
from shapefit.lifting.sequences.smoothing import Model, Smoothed, smooth

Floats = NDArray[np.float64]

LEVELS = (0.004, 0.01, 0.03, 0.06, 0.12)
"""Standard deviations of a coordinate that are tried, in units of the size of the landmarks."""

FIRST = 3
"""The level that is tried first."""

WINDOW = 120
"""Frames in the middle of a sequence from which the noise is found."""


def find_noise(seen: Observations, model: Model) -> float:
    """Return the level of the most evidence: sigma of the objective of `smooth`.

    From the first level on the noise falls, or else rises, as long as the evidence grows.
    """
    first = max(0, (len(seen) - WINDOW) // 2)
    part = seen.take(slice(first, first + WINDOW))
    best, at = FIRST, smooth(part, model, LEVELS[FIRST])
    for step in (-1, 1):
        tried = best + step
        found: Smoothed = at
        while 0 <= tried < len(LEVELS):
            found = smooth(part, model, LEVELS[tried], found)
            if found.log_evidence <= at.log_evidence:
                break
            best, at, tried = tried, found, tried + step
        if best != FIRST:
            break
    return LEVELS[best]
