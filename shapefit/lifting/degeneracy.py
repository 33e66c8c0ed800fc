"""Landmarks in normalised units, and which images cannot be lifted, and why."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.errors import counted
from shapefit.geometry.normalisation import (
    MAX_COORDINATE,
    MIN_EXTENT,
    Normalised,
    normalise,
)

MIN_VISIBLE_LANDMARKS = 3
"""Of an image that is lifted."""

BEYOND_CHANCE = MIN_VISIBLE_LANDMARKS + 1
"""Landmarks that must agree to count as inliers: some shape fits any three."""

MIN_SINGULAR_VALUE = 1e-9
"""Second singular value of landmarks, beside the first, down to which they lie on a
line.
"""

# Most images are far from degenerate by three quick rules; the others are looked at.

MIN_SINGULAR_PRODUCT = 1e-3
"""Product of the singular values of centred landmarks, as a share of the sum of their
squares, from which on they do not lie on a line.
"""

MIN_SCALE = 1e-100
"""Scale of landmarks above which nothing underflows."""

MAX_SCALE = 1e100
"""Scale of landmarks, and distance from the origin, below which nothing overflows."""


def normalise_visible(
    landmarks: Floats, weights: Floats
) -> tuple[Normalised, dict[int, str]]:
    """Centre and scale visible landmarks; return also why images cannot be lifted.

    points = (landmarks - centroid) / scale, both of the visible landmarks; reasons by
    index of the image. landmarks (n, 2, p), weights (n, p) with 0 = hidden. Images that
    find_degenerate names have the points 0, and centroid and scale nan.
    """
    # find_degenerate names what is too large
    with np.errstate(over="ignore", invalid="ignore"):
        norm = normalise(landmarks, weights > 0)
        doubtful = np.flatnonzero(~_is_far_from_degenerate(norm))
    degenerate = find_degenerate(landmarks[doubtful], weights[doubtful])
    failures = {int(doubtful[row]): reason for row, reason in degenerate.items()}
    failed = list(failures)
    norm.points[failed] = 0.0
    norm.centroid[failed] = np.nan
    norm.scale[failed] = np.nan
    return norm, failures


def _is_far_from_degenerate(norm: Normalised) -> Flags:
    """Return which images (n,) are clearly not degenerate, by three quick rules."""
    x = norm.points[:, 0]
    y = norm.points[:, 1]
    xx = np.einsum("np,np->n", x, x)
    yy = np.einsum("np,np->n", y, y)
    xy = np.einsum("np,np->n", x, y)
    # the product of the singular values of two rows is the root of their Gram
    # determinant
    is_fine = xx * yy - xy**2 > (MIN_SINGULAR_PRODUCT * (xx + yy)) ** 2
    is_fine &= np.abs(norm.centroid).max(axis=1) < MAX_SCALE
    is_fine &= norm.scale > MIN_SCALE
    is_fine &= norm.scale < MAX_SCALE
    return np.asarray(is_fine)


def find_degenerate(landmarks: Floats, weights: Floats) -> dict[int, str]:
    """Return by index the images that cannot be lifted, with the reason for each.

    Visible landmarks are too few, on one point or line, too large or too close
    together. In float64. landmarks (n, 2, p), weights (n, p) with 0 = hidden.
    """
    visible: Flags = np.asarray(weights > 0)
    count = visible.sum(axis=1)
    points = np.where(visible[:, None, :], landmarks, 0.0)
    size = np.abs(points).max(axis=(1, 2), initial=0.0)
    points = points / np.where(size > 0, size, 1.0)[:, None, None]
    mean = points.sum(axis=2) / np.maximum(count, 1)[:, None]
    centred = np.where(visible[:, None, :], points - mean[..., None], 0.0)
    widest = np.abs(centred).max(axis=(1, 2), initial=0.0)
    extent = np.minimum(size, MAX_COORDINATE) * widest
    s = np.linalg.svd(centred, compute_uv=False)
    is_point = s[:, 0] <= MIN_SINGULAR_VALUE
    is_line = s[:, 1] <= MIN_SINGULAR_VALUE * s[:, 0]
    is_too_large = size > MAX_COORDINATE
    is_too_small = extent < MIN_EXTENT
    has_few = count < MIN_VISIBLE_LANDMARKS
    is_degenerate = has_few | is_point | is_line | is_too_large | is_too_small
    reasons: dict[int, str] = {}
    for i in np.flatnonzero(is_degenerate).tolist():
        if count[i] == 0:
            reasons[i] = "all landmarks are hidden"
        elif has_few[i]:
            seen = counted(int(count[i]), "visible landmark")
            reasons[i] = f"only {seen}, {MIN_VISIBLE_LANDMARKS} are needed"
        elif is_point[i]:
            reasons[i] = "all visible landmarks are at one point"
        elif is_line[i]:
            reasons[i] = "all visible landmarks lie on one line"
        elif is_too_large[i]:
            reasons[i] = (
                f"coordinates too large, up to {size[i]:.2g}: use a larger unit"
            )
        else:
            reasons[i] = (
                f"landmarks too close together, within {extent[i]:.2g}: use a smaller"
                " unit"
            )
    return reasons
