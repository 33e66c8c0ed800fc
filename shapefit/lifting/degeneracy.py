"""Which images cannot be lifted, and why."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats
from shapefit.geometry.normalisation import LARGEST, SMALLEST

FEWEST = 3
BEYOND_CHANCE = FEWEST + 1
"""Landmarks that must agree with each other to be believed: some shape fits any three."""

# Landmarks lie on a line where their second singular value is this small beside the first.
FLAT = 1e-9


def find_degenerate(landmarks: Floats, weights: Floats) -> dict[int, str]:
    """Images whose visible landmarks do not span the image plane in float64, with the reason.

    landmarks (n, 2, p), weights (n, p) with 0 = hidden.
    """
    visible = weights > 0
    count = visible.sum(axis=1)
    points = np.where(visible[:, None, :], landmarks, 0.0)
    size = np.abs(points).max(axis=(1, 2), initial=0.0)
    unit = np.where(size > 0, size, 1.0)
    points = points / unit[:, None, None]
    mean = points.sum(axis=2) / np.maximum(count, 1)[:, None]
    centred = np.where(visible[:, None, :], points - mean[..., None], 0.0)
    extent = np.minimum(size, LARGEST) * np.abs(centred).max(axis=(1, 2), initial=0.0)
    s = np.linalg.svd(centred, compute_uv=False)

    def reason(image: np.intp) -> str:
        if count[image] == 0:
            return "all landmarks are hidden"
        if count[image] < FEWEST:
            return f"only {count[image]} visible landmarks, {FEWEST} are needed"
        if s[image, 0] <= FLAT:
            return "all visible landmarks are at one point"
        if s[image, 1] <= FLAT * s[image, 0]:
            return "all visible landmarks lie on one line"
        if size[image] > LARGEST:
            return f"coordinates too large, up to {size[image]:.2g}: use a larger unit"
        return f"landmarks too close together, within {extent[image]:.2g}: use a smaller unit"

    degenerate = (count < FEWEST) | (s[:, 1] <= FLAT * s[:, 0]) | (s[:, 0] == 0)
    degenerate |= (size > LARGEST) | (extent < SMALLEST)
    return {int(image): reason(image) for image in np.flatnonzero(degenerate)}
