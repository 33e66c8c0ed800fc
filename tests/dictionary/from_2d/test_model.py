"""The model of landmarks alone: dense Gaussians as judge."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.arrays import Floats
from shapefit.core import IMAGES_PER_BLOCK
from shapefit.dictionary.from_2d.model import (
    Views,
    find_log_density,
    posterior_mean,
    split_ppca,
)
from shapefit.geometry.rotations import exponential

N = 4
"""Images."""

P = 6
"""Landmarks."""

WIDE = 1e8
"""Variance of a translation that might be anything."""


@pytest.fixture
def planted(plant):
    """Few images, some landmarks hidden, confidences that differ, views that are a
    little off.
    """
    drawn = plant(N, p=P, modes=2, noise=0.02, hidden=0.2)
    confidence = 0.5 + 0.5 * (np.arange(P) % 2)
    weights = confidence * (drawn.images.weights > 0)
    images = replace(drawn.images, weights=weights)
    turned = exponential(np.full((N, 3), 0.05)) @ drawn.views.rotation
    views = Views(turned, np.array([0.1, -0.1, 0.0, 0.05]))
    return replace(drawn, images=images, views=views)


def expect(planted, **changed):
    """Return the expectation over the shapes of all images."""
    made = replace(planted, **changed)
    return posterior_mean(made.images, made.views, made.model)


@dataclass
class DenseGaussian:
    """What the joint Gaussian of a shape (3p) and its landmarks says of one image."""

    mean: Floats
    covariance: Floats
    log_density: float
    residual_variance: float


def landmark_covariance(planted, i) -> Floats:
    """Return the covariance of the visible landmarks of an image."""
    weights = np.tile(planted.images.weights[i], 2)
    visible = weights > 0
    scaled = np.exp(planted.views.log_scale[i]) * planted.views.rotation[i][:2]
    A = np.kron(scaled, np.eye(P))[visible]
    T = np.kron(np.eye(2), np.ones((P, 1)))[visible]
    noise = planted.model.noise * np.diag(weights[visible] ** -2)
    return A @ planted.model.covariance @ A.T + noise + WIDE * T @ T.T


def dense_gaussian(planted, i) -> DenseGaussian:
    """Condition the joint Gaussian, all at once, with a translation that is wide."""
    model = planted.model
    weights = np.tile(planted.images.weights[i], 2)
    visible = weights > 0
    scaled = np.exp(planted.views.log_scale[i]) * planted.views.rotation[i][:2]
    A = np.kron(scaled, np.eye(P))[visible]
    omega = weights[visible]
    noise = model.noise * np.diag(omega**-2)

    C = model.covariance
    S = landmark_covariance(planted, i)
    mean = model.mean.ravel()
    r = planted.images.landmarks[i].ravel()[visible] - A @ mean
    gain = C @ A.T @ np.linalg.inv(S)
    noise_gain = noise @ np.linalg.inv(S)
    noise_mean = noise_gain @ r
    noise_covariance = noise - noise_gain @ noise
    noise_square = noise_mean**2 + np.diag(noise_covariance)

    squares = r @ np.linalg.solve(S, r)
    log_det = np.linalg.slogdet(S)[1] + len(r) * np.log(2 * np.pi)
    return DenseGaussian(
        mean=mean + gain @ r,
        covariance=C - gain @ A @ C,
        log_density=-0.5 * (squares + log_det),
        residual_variance=float((omega**2 * noise_square).sum()),
    )


@pytest.fixture
def dense(planted) -> list[DenseGaussian]:
    return [dense_gaussian(planted, i) for i in range(N)]


def test_shapes_are_means_of_the_joint_gaussian(planted, dense):
    shapes = expect(planted).shapes
    means = [exact.mean.reshape(3, P) for exact in dense]
    assert_allclose(shapes, means, atol=1e-5)


def test_noise_is_that_of_the_joint_gaussian(planted, dense):
    found = expect(planted).residual_variance
    exact = [exact.residual_variance for exact in dense]
    assert found == pytest.approx(exact, rel=1e-4)


def test_covariances_are_those_of_the_joint_gaussian(planted, dense):
    found = posterior_mean(
        planted.images, planted.views, planted.model, covariance=True
    ).covariance
    total = sum(exact.covariance for exact in dense)
    assert_allclose(found, total, atol=1e-5)


def test_covariances_of_many_images_add_up(plant, monkeypatch):
    """Of so many that one thread takes several blocks at a time."""
    n = 17 * IMAGES_PER_BLOCK
    planted = plant(n, p=5, noise=0.02, hidden=0.1)
    monkeypatch.setattr("os.cpu_count", lambda: 1)

    def find_covariance(rows):
        images, views = planted.images[rows], planted.views[rows]
        found = posterior_mean(images, views, planted.model, covariance=True)
        return found.covariance

    parts = sum(find_covariance(slice(i, i + 50)) for i in range(0, n, 50))
    assert_allclose(find_covariance(slice(n)), parts, rtol=1e-9, atol=1e-9)


def test_the_log_density_by_itself_is_that_with_the_moments(planted):
    alone = find_log_density(planted.images, planted.views, planted.model)
    assert_array_equal(alone, expect(planted).log_density)


def test_log_density_is_that_of_the_landmarks_up_to_the_wide_translation(
    planted, dense
):
    found = expect(planted).log_density

    variance = planted.model.size_variance
    squares = planted.views.log_scale**2 / variance
    log_density_of_scale = -0.5 * (squares + np.log(2 * np.pi * variance))
    flat = np.log(WIDE)  # of both coordinates: 2 / 2 log WIDE
    expected = np.array([exact.log_density for exact in dense]) + flat
    assert_allclose(found - log_density_of_scale, expected, atol=1e-3)


@pytest.fixture
def outliers(planted):
    """Of each image landmark 1 is an outlier, where it is seen."""
    outliers = np.zeros((N, P), bool)
    outliers[:, 1] = planted.images.weights[:, 1] > 0
    return outliers


def test_doubt_is_what_the_density_gains_where_one_belief_changes(planted, outliers):
    images = replace(planted.images, outliers=outliers)
    found = expect(planted, images=images)

    for i, j in np.argwhere(planted.images.weights > 0):
        flipped = outliers.copy()
        flipped[i, j] ^= True
        then = expect(planted, images=replace(images, outliers=flipped))
        gain = then.log_density[i] - found.log_density[i]
        assert found.flip_gain[i, j] == pytest.approx(gain, rel=1e-6, abs=1e-6)


def test_there_is_no_doubt_of_a_landmark_that_is_hidden(planted, outliers):
    images = replace(planted.images, outliers=outliers)
    gain = expect(planted, images=images).flip_gain
    assert np.isneginf(gain[planted.images.weights == 0]).all()


def test_an_outlier_is_hidden_and_costs_its_odds(planted, outliers):
    """One in fifty, anywhere in 20 units of area."""
    with_outliers = expect(planted, images=replace(planted.images, outliers=outliers))
    hidden = expect(planted, images=planted.images.hiding(outliers))

    log_odds = np.log(0.02 / 0.98 * 0.05)
    cost = with_outliers.log_density - hidden.log_density
    assert cost == pytest.approx(log_odds * outliers.sum(axis=1))


@pytest.mark.parametrize("direction", range(4))
def test_gradient_is_that_of_the_log_density(planted, direction):
    found = posterior_mean(planted.images, planted.views, planted.model, slopes=True)

    step = 1e-5

    def log_density_at(moved_by):
        move = np.zeros((N, 4))
        move[:, direction] = moved_by
        turned = exponential(move[:, :3]) @ planted.views.rotation
        views = Views(turned, planted.views.log_scale + move[:, 3])
        return expect(planted, views=views).log_density

    difference = log_density_at(step) - log_density_at(-step)
    slope = difference / (2 * step)
    assert_allclose(found.gradient[:, direction], slope, rtol=1e-4, atol=1e-4)


def test_information_is_that_of_the_mean_shape_seen(planted):
    """J^T S^-1 J, with J the motions of the projected mean shape."""
    found = posterior_mean(planted.images, planted.views, planted.model, slopes=True)

    step = 1e-6
    for i in range(N):
        visible = np.tile(planted.images.weights[i], 2) > 0
        R = planted.views.rotation[i]
        s = np.exp(planted.views.log_scale[i])

        def project(move, R=R, s=s, visible=visible):
            turned = exponential(move[None, :3])[0] @ R
            seen = s * np.exp(move[3]) * turned[:2] @ planted.model.mean
            return seen.ravel()[visible]

        moves = step * np.eye(4)
        J = np.stack([project(move) - project(-move) for move in moves]) / (2 * step)
        expected = J @ np.linalg.solve(landmark_covariance(planted, i), J.T)
        expected[3, 3] += 1 / planted.model.size_variance
        assert_allclose(found.information[i], expected, rtol=1e-4, atol=1e-4)


def test_the_rest_of_a_covariance_is_the_mean_of_the_eigenvalues_that_are_left(rng):
    """Of eigenvalues 1 to 9 the four largest become modes."""
    p = 4
    across_ones = np.linalg.svd(np.ones((1, p))).Vh[1:]
    centred_coordinates = np.kron(np.eye(3), across_ones.T)  # (12, 9)
    orthogonal, _ = np.linalg.qr(rng.standard_normal((9, 9)))
    axes = centred_coordinates @ orthogonal
    eigenvalues = np.arange(1.0, 10)
    covariance = (axes * eigenvalues) @ axes.T

    found = split_ppca(np.zeros((3, p)), covariance, max_modes=4)

    rest = np.mean([1, 2, 3, 4, 5])
    assert found.rest == pytest.approx(rest)
    V = found.modes.reshape(3 * p, 4)
    expected = (axes[:, 5:] * (eigenvalues[5:] - rest)) @ axes[:, 5:].T
    assert_allclose(V @ V.T, expected, atol=1e-12)
