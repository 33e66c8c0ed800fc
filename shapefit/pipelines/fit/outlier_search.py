"""`outliers` of `fit`: wrong landmarks are found first, and the fit does without them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.config.commands.fit_sections import OutliersConfig
from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSet
from shapefit.lifting.degeneracy import BEYOND_CHANCE, find_degenerate
from shapefit.lifting.lift import Lifting
from shapefit.lifting.options import SEARCHED
from shapefit.lifting.outliers.ransac import find_consensus

MOST_ROUNDS = 100
"""Of fitting and judging again, per image; they settle after a few."""

DRAWS = 500
"""Triples of landmarks drawn per image; 2,000 change no figure of the cars."""

Search = Callable[[LandmarkSet, Floats, Dictionary], Flags]
"""From images, their weights Omega (n, p) and a dictionary to the inliers (n, p)."""


def choose_search(config: OutliersConfig, threads: int) -> Search:
    """Return the search that the config names."""
    threshold = config.threshold or SEARCHED
    consensus = partial(
        find_consensus,
        threshold=threshold,
        draws=DRAWS,
        max_rounds=MOST_ROUNDS,
        threads=threads,
    )
    return lambda images, weights, dictionary: consensus(
        images.landmarks, weights, dictionary.mean_shape, find_seeds(images)
    )


def find_seeds(images: LandmarkSet) -> NDArray[np.uint64]:
    """Return a seed (n,) for each image, from the name of the item.

    So what is drawn for an image depends neither on the others nor on its place among them.
    """
    digests = [blake2b(f"0 {item}".encode(), digest_size=8).digest() for item in images.items]
    return np.frombuffer(b"".join(digests), dtype="<u8").astype(np.uint64)


@dataclass(frozen=True)
class Agreement:
    """The landmarks that agree with each other, in n images.

    visible and inliers (n, p); lost: image -> reason, for images in which too few agree.
    """

    visible: Flags
    inliers: Flags
    lost: Mapping[int, str]

    def label(self, lifting: Lifting) -> Lifting:
        """Label the other visible landmarks in what was lifted, and fail the images lost."""
        return replace(
            lifting,
            estimate=replace(lifting.estimate, outliers=self.visible & ~self.inliers),
            failures={**lifting.failures, **self.lost},
        )


def find_inliers(
    search: Search, images: LandmarkSet, weights: Floats, dictionary: Dictionary
) -> Agreement:
    """Find the inliers; the others are to be lifted with weight 0, as if they were hidden.

    Then neither the fit nor the normalisation knows them. An image whose inliers are fewer than
    BEYOND_CHANCE, or on one line, is lost, all its landmarks labelled. One that has no more
    visible landmarks, or whose landmarks are degenerate themselves, is not searched.
    """
    visible = weights > 0
    seen = visible.sum(axis=1)
    searched = seen >= BEYOND_CHANCE
    searched[list(find_degenerate(images.landmarks, weights))] = False
    inliers = search(images, np.where(searched[:, None], weights, 0.0), dictionary)
    inliers = np.where(searched[:, None], inliers, True) & visible
    agree = inliers.sum(axis=1)
    found = np.where((agree < BEYOND_CHANCE)[:, None], 0.0, inliers)
    lost = np.zeros(len(seen), dtype=bool)
    lost[list(find_degenerate(images.landmarks, found))] = True
    lost &= searched
    inliers[lost] = False
    reasons = {
        image: f"only {agree[image]} of {seen[image]} visible landmarks agree with each other; the "
        f"minimum is {BEYOND_CHANCE}, not all on one line"
        for image in np.flatnonzero(lost).tolist()
    }
    return Agreement(visible, inliers, reasons)
