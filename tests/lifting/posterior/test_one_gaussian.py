"""The posterior under one Gaussian beside a dense computation of the same."""

import numpy as np
import pytest

from shapefit.dictionary.mixture import Mixture
from shapefit.lifting.posterior.posterior import Outliers, find_posterior
from tests.lifting.posterior import dense


def solve(scene, R, outliers=(0.0, 0.05)):
    prior = Mixture(np.ones(1), scene.mean[None], scene.covariance[None])
    return find_posterior(
        scene.landmarks[None],
        scene.residual_variance[None],
        scene.noise[None],
        prior,
        R[None, None],
        Outliers(*outliers),
        slopes=None if scene.slopes is None else scene.slopes[None],
        modes=1,
        covariance=True,
    )


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("hidden", [(), (2,), (0, 5)])
@pytest.mark.parametrize("chance", [0.0, 0.05])
@pytest.mark.parametrize("steep", [0.0, 0.4])
@pytest.mark.usefixtures("to_the_end")
def test_a_mode_is_that_of_the_dense_computation(draw_scene, noisy, hidden, chance, steep):
    scene, R = draw_scene(3, noisy=noisy, hidden=hidden, steep=steep)
    outliers = (chance, 0.05 / 37**2)
    found = solve(scene, R, outliers).modes
    R, s = found.rotation[0, 0], found.scale[0, 0]
    inlier_probability = np.nan_to_num(found.inlier_probability[0, 0], nan=1.0)

    def value(R, s):
        return dense.log_likelihood(scene, R, s, outliers, inlier_probability)

    assert np.abs(dense.derivative(value, R, s)).max() < 1e-3
    H = -dense.hessian(value, R, s) + np.eye(4)  # no view is less certain than a radian
    evidence = value(R, s) + 2 * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(H)[1]
    assert found.log_evidence[0, 0] == pytest.approx(evidence, abs=1e-3)
    y, C = dense.condition(scene, R, s, inlier_probability)
    assert found.mean[0, 0].ravel() == pytest.approx(y, abs=1e-9 * s)
    J = dense.derivative(lambda R, s: dense.condition(scene, R, s, inlier_probability)[0], R, s)
    whole = C + J.T @ np.linalg.inv(H) @ J
    assert found.covariance[0, 0] == pytest.approx(whole, abs=1e-4 * s**2)


def test_hidden_landmarks_are_marginalised(draw_scene):
    scene, R = draw_scene(5, hidden=(1, 6))
    full = solve(scene, R)
    retained = [0, 2, 3, 4, 5]
    rows = [a * 7 + j for a in range(3) for j in retained]
    small = dense.Scene(
        scene.landmarks[:, retained],
        scene.residual_variance[retained],
        scene.noise[retained],
        scene.mean[:, retained],
        scene.covariance[np.ix_(rows, rows)],
    )
    part = solve(small, R)
    assert full.log_evidence == pytest.approx(part.log_evidence, abs=1e-6)
    assert full.mean[0][:2, retained] == pytest.approx(part.mean[0][:2], abs=1e-4)
    depths = full.mean[0][2, retained]  # their mean is 0 over the landmarks that there are
    assert depths - depths.mean() == pytest.approx(part.mean[0][2], abs=1e-4)


def test_the_combination_of_one_mode_is_that_mode(draw_scene):
    scene, R = draw_scene(7)
    found = solve(scene, R)
    assert found.mean == pytest.approx(found.modes.mean[:, 0])
    assert found.covariance == pytest.approx(found.modes.covariance[:, 0])
    variance = np.diagonal(found.covariance[0]).reshape(3, 7)
    assert found.deviation[0] ** 2 == pytest.approx(variance)


def test_an_image_without_three_landmarks_has_no_posterior(draw_scene):
    scene, R = draw_scene(7, hidden=(0, 1, 2, 3, 4))
    found = solve(scene, R)
    assert np.isnan(found.mean).all()
    assert np.isnan(found.log_evidence).all()
