"""Planted images: shapes of one class, seen by a camera that is known."""

from dataclasses import dataclass

import numpy as np
import pytest

from shapefit.arrays import Floats
from shapefit.dictionary.from_2d.model import Gaussian, Images, Views
from shapefit.geometry.rotations import random_rotations
from tests.points import norms, with_noise


@dataclass
class Planted:
    """Images, their shapes before the camera, and the model and views behind them."""

    images: Images
    shapes: Floats
    model: Gaussian
    views: Views


@pytest.fixture
def plant(rng):
    """Return a function that draws n images of p landmarks."""

    def make(n, p=12, modes=3, deviation=0.15, noise=0.0, hidden=0.0) -> Planted:
        mean = centred_landmarks(rng.standard_normal((3, p)))
        V = centred_landmarks(deviation * rng.standard_normal((3, p, modes)))
        R = random_rotations(n, rng)
        deformation = np.einsum("ipq,nq->nip", V, rng.standard_normal((n, modes)))
        shapes = R @ (mean + deformation)

        landmarks = with_noise(shapes[:, :2], noise, rng)
        landmarks += rng.standard_normal((n, 2, 1))
        weights = (rng.random((n, p)) >= hidden).astype(float)
        images = Images(landmarks, weights, one_sequence(n))
        model = Gaussian(
            mean,
            modes=V,
            rest=1e-3,
            noise=0.02**2,
            log_size=np.zeros(1),
            size_variance=0.1**2,
        )
        return Planted(images, shapes, model, Views(R, np.zeros(n)))

    return make


def centred_landmarks(points):
    """Subtract the mean over landmarks (3, p, ...)."""
    return points - points.mean(axis=1, keepdims=True)


def one_sequence(n):
    """Return the number of the sequence of each of n images: 0 for all."""
    return np.zeros(n, np.intp)


def images_of(landmarks):
    """Return images of one sequence, in which all landmarks are seen."""
    n, _, p = landmarks.shape
    return Images(landmarks, np.ones((n, p)), one_sequence(n))


def relative_error(found, shapes):
    """Mean of ||X - X^|| / ||X||, the sign of depth chosen once for all."""
    mirrored = found * [[1], [1], [-1]]
    as_it_is = norms(found - shapes) / norms(shapes)
    in_the_mirror = norms(mirrored - shapes) / norms(shapes)
    return min(as_it_is.mean(), in_the_mirror.mean())
