"""Which images cannot be lifted, and why."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FEWEST = 3
BEYOND_CHANCE = FEWEST + 1
"""Landmarks that must agree with each other to be believed: some shape fits any three."""

# Landmarks lie on a line where their second singular value is this small beside the first.
FLAT = 1e-9


def find_degenerate(landmarks: Floats, weights: Floats) -> dict[int, str]:
    """Images whose visible landmarks do not span the image plane, with the reason.

    landmarks (n, 2, p), weights (n, p) with 0 = hidden.
    """
    visible = weights > 0
    count = visible.sum(axis=1)
    points = np.where(visible[:, None, :], landmarks, 0.0)
    mean = points.sum(axis=2) / np.maximum(count, 1)[:, None]
    centred = np.where(visible[:, None, :], points - mean[..., None], 0.0)
    size = np.abs(points).max(axis=(1, 2), initial=0.0)
    s = np.linalg.svd(centred / np.where(size > 0, size, 1.0)[:, None, None], compute_uv=False)

    reasons: dict[int, str] = {}
    for image in np.flatnonzero((count < FEWEST) | (s[:, 1] <= FLAT * s[:, 0]) | (s[:, 0] == 0)):
        if count[image] == 0:
            reason = "all landmarks are hidden"
        elif count[image] < FEWEST:
            reason = f"only {count[image]} visible landmarks, {FEWEST} are needed"
        elif s[image, 0] <= FLAT:
            reason = "all visible landmarks lie on one point"
        else:
            reason = "all visible landmarks lie on one line"
        reasons[int(image)] = reason
    return reasons
