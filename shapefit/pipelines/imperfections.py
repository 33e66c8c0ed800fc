"""What goes wrong with landmarks in real images: noise, hidden landmarks, wrong landmarks.

Random numbers belong to the seed, the purpose, and the position of the image: they are drawn for
whole batches of `BATCH` images, from a stream of their own for each batch and purpose. So what
happens to an image does not depend on how many follow, and less noise leaves the same landmarks
hidden.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats

BATCH = 1024
LEAST_VISIBLE = 3


class Purpose(IntEnum):
    """What a stream of random numbers is for; the values are part of what a seed means."""

    VIEW = 0
    NOISE = 1
    HIDDEN = 2


def stream(seed: int, purpose: Purpose, batch: int) -> np.random.Generator:
    """Return the random numbers of one purpose for images batch * BATCH, ... of the set."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(purpose, batch)))


def add_noise(landmarks: Floats, deviation: float, rng: np.random.Generator) -> Floats:
    """W + deviation * N(0, 1), landmarks (n, 2, p), n <= BATCH."""
    n, *rest = landmarks.shape
    return landmarks + deviation * rng.standard_normal((BATCH, *rest))[:n]


def hide(landmarks: Floats, share: float, rng: np.random.Generator) -> Floats:
    """Set a random `share` of the landmarks (n, 2, p) of each image to NaN, n <= BATCH.

    The number hidden in an image is share * p, rounded up or down at random so that the share
    holds on average; at least LEAST_VISIBLE landmarks stay.
    """
    n, _, p = landmarks.shape
    hidden = _choose(np.ones((n, p), bool), share, p - LEAST_VISIBLE, rng)
    return np.where(hidden[:, None], np.nan, landmarks)


def _choose(
    candidates: NDArray[np.bool_], share: float, most: int, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Choose share * count of the candidates (n, p) of each image at random, `most` at most."""
    n, p = candidates.shape
    rounding = rng.random(BATCH)[:n]
    keys = np.where(candidates, rng.random((BATCH, p))[:n], np.inf)
    number = np.floor(share * candidates.sum(axis=1) + rounding).clip(0, max(most, 0))
    rank = keys.argsort(axis=1).argsort(axis=1)
    return rank < number[:, None]
