"""Error bars of frames with errors in common: the formula, and planted sequences."""

import numpy as np
from numpy.testing import assert_allclose

from shapefit.lifting.sequences.clips import (
    PAIRS,
    add_common_error,
    nearest_informative,
)
from shapefit.lifting.sequences.smoothing import CONSTANTS

T, P = 9, 4
RESIDUAL_VARIANCE = 0.01


def parts_of(C):
    """Deviations and correlations (n, 3, p) of covariances (n, p, 3, 3)."""
    sd = np.sqrt(np.einsum("npaa->nap", C))
    pairs = [C[:, :, a, b] / (sd[:, a] * sd[:, b]) for a, b in PAIRS]
    return sd, np.stack(pairs, axis=1)


def draw_covariances(rng, *shape):
    A = rng.standard_normal((*shape, 3, 3))
    return A @ A.swapaxes(-1, -2) + 0.1 * np.eye(3)


def test_covariances_are_added(rng):
    S, own = draw_covariances(rng, 6, P), draw_covariances(rng, 6, P)
    constant = rng.uniform(0, 2, (6, P))
    found = add_common_error(parts_of(S), parts_of(own), constant)
    whole = S + CONSTANTS.shared**2 * own + (constant**2)[..., None, None] * np.eye(3)
    for got, expected in zip(found, parts_of(whole), strict=True):
        assert_allclose(got, expected, rtol=1e-12)


def test_an_image_that_says_nothing_has_the_bars_of_its_neighbour():
    known = np.array([1, 0, 0, 0, 1, 0, 0, 0, 1], dtype=bool)
    clips = (slice(0, 5), slice(5, 7), slice(7, 9))
    frames = np.arange(9.0)
    found = nearest_informative(known, clips, frames)
    assert found.tolist() == [0, 0, 0, 4, 4, 5, 6, 8, 8]
    frames[1:] += 3  # the second image is nearer to the last of its clip
    found = nearest_informative(known, clips, frames)
    assert found.tolist() == [0, 4, 4, 4, 4, 5, 6, 8, 8]
