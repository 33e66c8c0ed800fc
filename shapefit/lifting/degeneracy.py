"""Landmarks in normalised units, and which images cannot be lifted, and why."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.geometry.normalisation import (
    MAX_COORDINATE,
    MIN_EXTENT,
    Normalised,
    normalise,
)

FEWEST = 3
BEYOND_CHANCE = FEWEST + 1
"""Landmarks that must agree with each other to count as inliers: some shape fits any
three.
"""

FLAT = 1e-9
"""Landmarks lie on a line where their second singular value is this small beside the
first.
"""

WIDE, SMALL, LARGE = 1e-3, 1e-100, 1e100
"""Landmarks whose singular values have at least this share of the sum of their squares
as their product are far from any line, and such sizes far within the bounds of
normalisation: of those nobody need look closer.
"""


def normalise_visible(
    landmarks: Floats, weights: Floats
) -> tuple[Normalised, dict[int, str]]:
    """(landmarks - centroid) / scale of what is seen, and the images where that means
    nothing.

    landmarks (n, 2, p), weights (n, p) with 0 = hidden. Images that find_degenerate
    names have the points 0, and centroid and scale nan.
    """
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # find_degenerate names what is too large
        norm = normalise(landmarks, weights > 0)
        # the product of the singular values of two rows is the root of their Gram
        # determinant
        x, y = norm.points[:, 0], norm.points[:, 1]
        xx, yy, xy = (np.einsum("np,np->n", *rows) for rows in ((x, x), (y, y), (x, y)))
        plain = xx * yy - xy**2 > (WIDE * (xx + yy)) ** 2
        plain &= np.abs(norm.centroid).max(axis=1) < LARGE
        plain &= (norm.scale > SMALL) & (norm.scale < LARGE)
    doubtful = np.flatnonzero(~plain)
    degenerate = find_degenerate(landmarks[doubtful], weights[doubtful])
    failures = {int(doubtful[row]): why for row, why in degenerate.items()}
    failed = list(failures)
    norm.points[failed], norm.centroid[failed], norm.scale[failed] = 0.0, np.nan, np.nan
    return norm, failures


def find_degenerate(landmarks: Floats, weights: Floats) -> dict[int, str]:
    """Images whose visible landmarks do not span the image plane in float64, with the
    reason.

    landmarks (n, 2, p), weights (n, p) with 0 = hidden.
    """
    visible: Flags = np.asarray(weights > 0)
    count = visible.sum(axis=1)
    points = np.where(visible[:, None, :], landmarks, 0.0)
    size = np.abs(points).max(axis=(1, 2), initial=0.0)
    points = points / np.where(size > 0, size, 1.0)[:, None, None]
    mean = points.sum(axis=2) / np.maximum(count, 1)[:, None]
    centred = np.where(visible[:, None, :], points - mean[..., None], 0.0)
    extent = np.minimum(size, MAX_COORDINATE) * np.abs(centred).max(
        axis=(1, 2), initial=0.0
    )
    s = np.linalg.svd(centred, compute_uv=False)
    rules = (
        (count == 0, "all landmarks are hidden"),
        (count < FEWEST, "only {count} visible landmarks, {fewest} are needed"),
        (s[:, 0] <= FLAT, "all visible landmarks are at one point"),
        (s[:, 1] <= FLAT * s[:, 0], "all visible landmarks lie on one line"),
        (
            size > MAX_COORDINATE,
            "coordinates too large, up to {size:.2g}: use a larger unit",
        ),
        (
            extent < MIN_EXTENT,
            "landmarks too close together, within {extent:.2g}: use a smaller unit",
        ),
    )
    reasons: dict[int, str] = {}
    for holds, text in rules:
        for i in np.flatnonzero(holds).tolist():
            facts = {
                "count": count[i],
                "fewest": FEWEST,
                "size": size[i],
                "extent": extent[i],
            }
            reasons.setdefault(i, text.format(**facts))
    return dict(sorted(reasons.items()))
