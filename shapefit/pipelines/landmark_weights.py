"""How much each landmark of an image counts, and which count at all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.io import LandmarkSet


def find_weights(images: LandmarkSet) -> NDArray[np.float64]:
    """Omega (n, p): the confidence, or 1, where a landmark has a place, and 0 elsewhere."""
    placed = np.isfinite(images.landmarks).all(axis=1)
    return np.where(placed, 1.0 if images.confidence is None else images.confidence, 0.0)


def find_seen(images: LandmarkSet) -> NDArray[np.bool_]:
    """Omega > 0 (n, p): the landmarks that have a place and confidence."""
    return find_weights(images) > 0
