"""The expectation against dense Gaussians, and its gradient against differences."""

from dataclasses import replace

import numpy as np
import pytest

from shapefit.dictionary.from_2d.model import Views, posterior_mean, scatter, split_ppca
from shapefit.geometry.rotations import exponential

WIDE = 1e8
"""Variance of a translation that might be anything."""


@pytest.fixture
def planted(plant):
    """Few images, some landmarks hidden, confidences that differ, views that are a little off."""
    made = plant(4, p=6, modes=2, noise=0.02, hidden=0.2)
    confidence = np.where(made.images.weights > 0, 0.5 + 0.5 * (np.arange(6) % 2), 0.0)
    made.images = type(made.images)(made.images.landmarks, confidence, made.images.sequence)
    turned = exponential(np.full((4, 3), 0.05)) @ made.views.rotation
    made.views = Views(turned, np.array([0.1, -0.1, 0.0, 0.05]))
    return made


def dense(made, i):
    """Return mean and covariance of the shape and of the seen landmarks, log density, and noise.

    All at once: joint Gaussian of the shape (3p) and the landmarks (2p), the translation wide.
    """
    model, p = made.model, made.images.weights.shape[1]
    A = np.exp(made.views.log_scale[i]) * np.kron(made.views.rotation[i][:2], np.eye(p))
    visible = np.tile(made.images.weights[i] > 0, 2)
    omega = np.tile(made.images.weights[i], 2)[visible]
    A, T = A[visible], np.kron(np.eye(2), np.ones((p, 1)))[visible]
    C = model.covariance
    S = A @ C @ A.T + model.noise * np.diag(omega**-2) + WIDE * T @ T.T
    r = made.images.landmarks[i].ravel()[visible] - A @ model.mean.ravel()
    gain = C @ A.T @ np.linalg.inv(S)
    log_density = -0.5 * (
        r @ np.linalg.solve(S, r) + np.linalg.slogdet(S)[1] + len(r) * np.log(2 * np.pi)
    )
    noise_gain = model.noise * np.diag(omega**-2) @ np.linalg.inv(S)
    e = noise_gain @ r
    of_noise = model.noise * np.diag(omega**-2) - noise_gain @ (model.noise * np.diag(omega**-2))
    residual_variance = float((omega**2 * (e**2 + np.diag(of_noise))).sum())
    return model.mean.ravel() + gain @ r, C - gain @ A @ C, log_density, residual_variance


def test_shapes_covariances_and_noise_are_those_of_the_joint_gaussian(planted):
    found = posterior_mean(planted.images, planted.views, planted.model)
    exact = [dense(planted, i) for i in range(4)]
    for i, (mean, _, _, residual_variance) in enumerate(exact):
        np.testing.assert_allclose(found.shapes[i].ravel(), mean, atol=1e-5)
        assert found.residual_variance[i] == pytest.approx(residual_variance, rel=1e-4)
    total = sum(covariance for _, covariance, _, _ in exact)
    np.testing.assert_allclose(scatter(found, planted.views, planted.model), total, atol=1e-5)


def test_log_density_is_that_of_the_landmarks_up_to_the_wide_translation(planted):
    found = posterior_mean(planted.images, planted.views, planted.model)
    spread = planted.model.size_variance
    of_scale = -0.5 * (planted.views.log_scale**2 / spread + np.log(2 * np.pi * spread))
    exact = np.array([dense(planted, i)[2] for i in range(4)])
    flat = np.log(WIDE)  # of both coordinates: 2 / 2 log WIDE
    np.testing.assert_allclose(found.log_density - of_scale, exact + flat, atol=1e-3)


def test_doubt_is_what_the_density_gains_where_one_belief_changes(planted):
    outliers = np.zeros(planted.images.weights.shape, bool)
    outliers[:, 1] = planted.images.weights[:, 1] > 0
    images = replace(planted.images, outliers=outliers)
    found = posterior_mean(images, planted.views, planted.model)
    for i, j in np.argwhere(planted.images.weights > 0):
        changed = outliers.copy()
        changed[i, j] ^= True
        then = posterior_mean(replace(images, outliers=changed), planted.views, planted.model)
        gain = then.log_density[i] - found.log_density[i]
        assert found.flip_gain[i, j] == pytest.approx(gain, rel=1e-6, abs=1e-6)
    assert np.isneginf(found.flip_gain[planted.images.weights == 0]).all()
    hidden = posterior_mean(planted.images.hiding(outliers), planted.views, planted.model)
    odds = np.log(0.02 / 0.98 * 0.05)  # one in fifty, anywhere in 20 units of area
    assert found.log_density - hidden.log_density == pytest.approx(odds * outliers.sum(axis=1))


def test_gradient_is_that_of_the_log_density(planted):
    found = posterior_mean(planted.images, planted.views, planted.model, slopes=True)
    h = 1e-5
    for direction in range(4):
        step = np.zeros((4, 4))
        step[:, direction] = h

        def moved(sign, step=step):
            turned = exponential(sign * step[:, :3]) @ planted.views.rotation
            views = Views(turned, planted.views.log_scale + sign * step[:, 3])
            return posterior_mean(planted.images, views, planted.model).log_density

        slope = (moved(1) - moved(-1)) / (2 * h)
        np.testing.assert_allclose(found.gradient[:, direction], slope, rtol=1e-4, atol=1e-4)


def test_the_rest_of_a_covariance_is_the_mean_of_the_eigenvalues_that_are_left(rng):
    p = 4
    centred = np.kron(np.eye(3), np.linalg.svd(np.ones((1, p)))[2][1:].T)  # (12, 9)
    axes = centred @ np.linalg.qr(rng.standard_normal((9, 9)))[0]
    covariance = (axes * np.arange(1.0, 10)) @ axes.T
    found = split_ppca(np.zeros((3, p)), covariance, most=4)
    assert found.rest == pytest.approx(np.mean([1, 2, 3, 4, 5]))
    V = found.modes.reshape(3 * p, 4)
    expected = (axes[:, 5:] * (np.arange(6.0, 10) - 3)) @ axes[:, 5:].T
    np.testing.assert_allclose(V @ V.T, expected, atol=1e-12)
