"""Planted problems: shapes from a known Gaussian, seen from random views."""

from types import SimpleNamespace

import numpy as np
import pytest

from shapefit.dictionary.from_2d.model import Gaussian, Images, Views
from shapefit.geometry.rotations import random_rotations


@pytest.fixture
def plant(rng):
    """Return a function that draws n images of p landmarks, their shapes before the camera."""

    def make(n, p=12, modes=3, deviation=0.15, noise=0.0, hidden=0.0):
        mean = rng.standard_normal((3, p))
        mean -= mean.mean(axis=1, keepdims=True)
        V = deviation * rng.standard_normal((3, p, modes))
        V -= V.mean(axis=1, keepdims=True)
        R = random_rotations(n, rng)
        shapes = R @ (mean + np.einsum("ipq,nq->nip", V, rng.standard_normal((n, modes))))
        landmarks = shapes[:, :2] + noise * rng.standard_normal((n, 2, p))
        landmarks += rng.standard_normal((n, 2, 1))
        weights = (rng.random((n, p)) >= hidden).astype(float)
        images = Images(landmarks, weights, np.zeros(n, np.intp))
        model = Gaussian(mean, V, 1e-3, 0.02**2, np.zeros(1), 0.1**2)
        return SimpleNamespace(
            images=images, shapes=shapes, model=model, views=Views(R, np.zeros(n))
        )

    return make


def relative_error(found, shapes):
    """Mean of ||X - X^|| / ||X||, the sign of depth chosen once for all."""
    return min(
        float(
            np.mean(
                np.linalg.norm(found * [[1], [1], [sign]] - shapes, axis=(1, 2))
                / np.linalg.norm(shapes, axis=(1, 2))
            )
        )
        for sign in (1.0, -1.0)
    )
