"""A planted body that turns before a camera, and what single images say of it."""

import numpy as np
import pytest

from shapefit.lifting.sequences.smoothing import SequenceModel, observe

BONES = np.array([[0, 1], [1, 2], [2, 3], [1, 4]])
T, P = 24, 5


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.fixture
def model():
    return SequenceModel(BONES, np.full(P, 0.02) ** -2.0, np.full(len(BONES), 0.005))


@pytest.fixture
def body(rng):
    """A rigid body (T, 3, P) that turns by a half circle."""
    shape = rng.standard_normal((3, P))
    shape -= shape.mean(axis=1, keepdims=True)
    turn = np.pi * np.arange(T) / T
    c, s, o = np.cos(turn), np.sin(turn), np.zeros(T)
    R = np.stack([c, o, s, o, o + 1, o, -s, o, c], axis=1).reshape(T, 3, 3)
    return R @ shape


@pytest.fixture
def images(rng):
    """Two modes an image: depths with errors, and their mirror image with a small
    share.
    """

    def see(points, noise=0.0, depth=0.3, sure=0.05):
        t, _, p = points.shape
        landmarks = points[:, :2] + noise * rng.standard_normal((t, 2, p))
        mean = points.copy()
        mean[:, 2] += depth * rng.standard_normal((t, p))
        mean[:, 2] -= mean[:, 2].mean(axis=1, keepdims=True)
        mean[:, :2] = landmarks
        mirrored = mean * np.array([1.0, 1.0, -1.0])[:, None]
        variance = np.repeat([sure**2, sure**2, depth**2], p)
        covariance = np.tile(np.diag(variance), (t, 2, 1, 1))
        evidence = np.tile([0.0, -2.0], (t, 1))
        modes = np.stack([mean, mirrored], axis=1)
        return observe(
            landmarks, np.ones((t, p)), mean, evidence, modes, covariance, 0.01
        )

    return see
