"""The model that explains best what the images say: the maximisation step."""

from __future__ import annotations

import numpy as np

from shapefit.dictionary.from_2d.model import Floats, Gaussian

MOST_MODES = 64

LEAST = 1e-9
"""Variance of a coordinate at least."""


def maximise(mean: Floats, covariance: Floats, left: int = 1, most: int = MOST_MODES) -> Gaussian:
    """Split a covariance (3p, 3p) about the mean (3, p) into leading modes and a rest rho.

    The likeliest split: rho is the mean of the eigenvalues that are left (Tipping and Bishop 1999).
    At least `left` eigenvalues are, or the rest is next to nothing; modes are at `most` so many.
    Noise and views stay to be set.
    """
    p = mean.shape[1]
    centred = covariance.reshape(3, p, 3, p)
    centred = centred - centred.mean(axis=1, keepdims=True)
    centred = centred - centred.mean(axis=3, keepdims=True)
    size, axes = np.linalg.eigh(centred.reshape(3 * p, 3 * p))
    q = min(most, 3 * p - 3 - left)
    others = size[3 : 3 * p - q]  # the first three are translations
    rest = max(float(others.mean()), LEAST) if len(others) else LEAST
    modes = axes[:, -q:] * np.sqrt(np.maximum(size[-q:] - rest, 0.0))
    return Gaussian(
        mean - mean.mean(axis=1, keepdims=True), modes.reshape(3, p, q), rest, 1.0, np.zeros(1), 1.0
    )
