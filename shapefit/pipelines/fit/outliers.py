"""Outliers that are searched before a fit: what no pose of the mean shape explains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from hashlib import blake2b
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.dictionary.model import Dictionary
from shapefit.lifting.degeneracy import BEYOND_CHANCE, find_degenerate
from shapefit.lifting.estimate import E
from shapefit.lifting.lift import Lifting
from shapefit.records import Landmarks

RANSAC_THRESHOLD = 0.25
"""Residual of an outlier in units of the size of the shape."""

RANSAC_DRAWS = 500
"""Triples of landmarks drawn per image: 2,000 change no figure of the cars."""

MAX_RANSAC_ROUNDS = 100
"""Of the search in an image."""

NO_CONSENSUS = (
    f"fewer than {BEYOND_CHANCE} visible landmarks, not all on one line, agree"
)


class Inliers(NamedTuple):
    """Which landmarks (n, p) are seen and agree; by row, why an image has too few."""

    flags: Flags
    failures: dict[int, str]


def lift_inliers(
    lift_weighted: Callable[[Floats], Lifting[E]],
    images: Landmarks,
    weights: Floats,
    dictionary: Dictionary,
    threshold: float | None,
    threads: int = 0,
) -> Lifting[E]:
    """Search outliers of images, then lift these with outliers hidden and marked.

    lift_weighted lifts them by weights (n, p). Without a threshold none is searched.
    """
    if threshold is None:
        return lift_weighted(weights)
    inliers = find_inliers(images, weights, dictionary, threshold, threads)
    lifting = lift_weighted(np.where(inliers.flags, weights, 0.0))
    outliers = (weights > 0) & ~inliers.flags
    return replace(
        lifting,
        estimate=replace(lifting.estimate, outliers=outliers),
        failures={**lifting.failures, **inliers.failures},
    )


def find_inliers(
    images: Landmarks,
    weights: Floats,
    dictionary: Dictionary,
    threshold: float,
    threads: int = 0,
) -> Inliers:
    """Find the inliers among landmarks of weights (n, p) > 0, by seeded draws.

    The seed of an image is the name of its item, so that no other image counts. Images
    with fewer than BEYOND_CHANCE landmarks, or degenerate ones, are not searched.
    """
    from shapefit.lifting.consensus import find_consensus

    w = images.as_columns()
    visible = weights > 0
    searched = visible.sum(axis=1) >= BEYOND_CHANCE
    searched[list(find_degenerate(w, weights))] = False
    found = find_consensus(
        w,
        np.where(searched[:, None], weights, 0.0),
        dictionary.mean_shape,
        seeds_of(images.items),
        threshold=threshold,
        draws=RANSAC_DRAWS,
        max_rounds=MAX_RANSAC_ROUNDS,
        threads=threads,
    )
    inliers = np.where(searched[:, None], found, True) & visible
    too_few = inliers.sum(axis=1) < BEYOND_CHANCE
    enough = np.where(too_few[:, None], 0.0, inliers)
    degenerate = find_degenerate(w, enough)
    lost = [image for image in degenerate if searched[image]]
    inliers[lost] = False
    return Inliers(inliers, dict.fromkeys(lost, NO_CONSENSUS))


def seeds_of(items: Sequence[str]) -> np.ndarray[tuple[int], np.dtype[np.uint64]]:
    """Return a seed (n,) for each item, from its name."""
    digests = [blake2b(f"0 {item}".encode(), digest_size=8).digest() for item in items]
    return np.frombuffer(b"".join(digests), dtype="<u8").astype(np.uint64)
