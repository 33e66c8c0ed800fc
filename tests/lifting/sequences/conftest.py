"""A planted body that turns before a camera, and what single images say of it."""

from dataclasses import replace

import numpy as np
import pytest

from shapefit.geometry.rotations import rotation_about_axis
from shapefit.lifting.sequences.smoothing import SequenceModel, observe
from tests.points import centred, with_noise

BONES = np.array([[0, 1], [1, 2], [2, 3], [1, 4]])

T = 24
"""Frames."""

P = 5
"""Landmarks."""


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.fixture
def model():
    stiffness = np.full(P, 0.02) ** -2.0
    bone_tolerance = np.full(len(BONES), 0.005)
    return SequenceModel(BONES, stiffness, bone_tolerance)


def without_bones(model: SequenceModel) -> SequenceModel:
    """Return the model of landmarks that no bone joins."""
    none = slice(0)
    return replace(
        model, bones=model.bones[none], bone_tolerance=model.bone_tolerance[none]
    )


@pytest.fixture
def body(rng):
    """A rigid body (T, 3, P) that turns by a half circle."""
    shape = centred(rng.standard_normal((3, P)))
    angles = np.pi * np.arange(T) / T
    return rotation_about_axis(1, angles) @ shape


@pytest.fixture
def images(rng):
    """Two modes an image: depths with errors, and their mirror image with a small
    share.
    """

    def see(points, noise=0.0, depth=0.3, sure=0.05):
        t, _, p = points.shape
        landmarks = with_noise(points[:, :2], noise, rng)
        depths = with_noise(points[:, 2], depth, rng)
        depths -= depths.mean(axis=1, keepdims=True)
        mean = np.concatenate([landmarks, depths[:, None]], axis=1)
        mirrored = mean * np.array([1.0, 1.0, -1.0])[:, None]
        modes = np.stack([mean, mirrored], axis=1)
        variance = np.repeat([sure**2, sure**2, depth**2], p)
        covariance = np.tile(np.diag(variance), (t, 2, 1, 1))
        log_evidence = np.tile([0.0, -2.0], (t, 1))
        trust = np.ones((t, p))
        return observe(landmarks, trust, mean, log_evidence, modes, covariance, 0.01)

    return see
