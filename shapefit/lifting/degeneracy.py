"""Landmarks in normalised units, and which images cannot be lifted, and why."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.geometry.normalisation import LARGEST, SMALLEST, Normalised, normalise

FEWEST = 3
BEYOND_CHANCE = FEWEST + 1
"""Landmarks that must agree with each other to be believed: some shape fits any three."""

# Landmarks lie on a line where their second singular value is this small beside the first.
FLAT = 1e-9
# Their product is at least this share of (the sum of their squares): far from any line.
WIDE = 1e-3
# Sizes far within the bounds of normalisation.
PLAIN_SIZES = 1e-100, 1e100


def normalise_visible(landmarks: Floats, weights: Floats) -> tuple[Normalised, dict[int, str]]:
    """(landmarks - centroid) / scale of what is seen, and the images where that means nothing.

    landmarks (n, 2, p), weights (n, p) with 0 = hidden. Images that find_degenerate names have the
    points 0, and centroid and scale nan.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # find_degenerate names what is too large
        found = normalise(landmarks, weights > 0)
        doubtful = np.flatnonzero(~is_plain(found))
    failures = {
        int(doubtful[row]): why
        for row, why in find_degenerate(landmarks[doubtful], weights[doubtful]).items()
    }
    failed = list(failures)
    found.points[failed], found.centroid[failed], found.scale[failed] = 0.0, np.nan, np.nan
    return found, failures


def is_plain(found: Normalised) -> NDArray[np.bool_]:
    """Whether landmarks (n,) are so wide, and of such a size, that nobody need look closer.

    The product of the singular values of two rows is the root of the determinant of their Gram
    matrix.
    """
    x, y = found.points[:, 0], found.points[:, 1]
    xx, yy, xy = (np.einsum("np,np->n", *rows) for rows in ((x, x), (y, y), (x, y)))
    wide = xx * yy - xy**2 > (WIDE * (xx + yy)) ** 2
    least, most = PLAIN_SIZES
    near = np.abs(found.centroid).max(axis=1) < most
    plain: NDArray[np.bool_] = wide & near & (found.scale > least) & (found.scale < most)
    return plain


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
