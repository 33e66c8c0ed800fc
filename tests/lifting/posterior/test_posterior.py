"""The posterior under mixtures: sampling, equivariance, calibration, outliers."""

import numpy as np
import pytest

from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.rotations import rotation_about
from shapefit.lifting.posterior.posterior import Outliers
from tests.lifting.posterior.dense import draw_images, shares_of, solve


def test_regions_hold_what_they_say_for_shapes_of_the_model(draw_mixture):
    prior, residual_variance, n, p = draw_mixture(4, size=0.1), 0.005, 600, 7
    y, w, R = draw_images(prior, n, 6, residual_variance)
    found = solve(prior, w, R[:, None], residual_variance, covariance=True)
    y[:, 2] -= y[:, 2].mean(axis=1, keepdims=True)
    blocks = found.covariance.reshape(n, 3, p, 3, p)
    apart = (y - found.mean).transpose(0, 2, 1)
    C = np.stack([blocks[:, :, j, :, j] for j in range(p)], axis=1)
    square = np.einsum("npa,npa->np", apart, np.linalg.solve(C, apart[..., None])[..., 0])
    for share, bound in ((0.5, 2.366), (0.9, 6.251)):  # quantiles of chi^2 with 3 degrees
        inside = (square < bound).mean(axis=1)  # landmarks of one image go together
        error = inside.std() / np.sqrt(n)
        assert inside.mean() == pytest.approx(share, abs=4 * error + 0.02)


def test_a_gross_landmark_is_disbelieved_and_the_others_stay(draw_mixture):
    prior, residual_variance, n, p = draw_mixture(5, p=13, size=0.08), 0.005, 40, 13
    y, w, R = draw_images(prior, n, 7, residual_variance)
    clean = solve(prior, w, R[:, None], residual_variance, outliers=Outliers(0.05))
    w[:, :, 4] += np.array([2.0, -1.5])
    found = solve(prior, w, R[:, None], residual_variance, outliers=Outliers(0.05))
    others = np.arange(p) != 4
    error = [np.median(np.abs(f.mean - y)[:, :2, others].mean(axis=(1, 2))) for f in (clean, found)]
    assert np.median(found.inlier_probability[:, 4]) < 0.01
    assert np.median(found.inlier_probability[:, others]) > 0.99
    assert error[1] < 1.1 * error[0]


def test_the_weight_of_a_component_counts():
    mean = np.random.default_rng(0).normal(size=(3, 6))
    mean -= mean.mean(axis=1, keepdims=True)
    C = 0.01 * np.eye(18)
    prior = Mixture(np.array([0.9, 0.1]), np.stack([mean, mean]), np.stack([C, C]))
    w = mean[None, :2]
    found = solve(prior, w, np.eye(3)[None, None], 0.01, modes=2)
    assert shares_of(found.modes)[0] == pytest.approx([0.9, 0.1], rel=1e-6)
    assert found.modes.component[0].tolist() == [0, 1]


def test_a_climb_that_ends_on_a_saddle_does_not_count_beside_a_maximum():
    """A flat shape, foreshortened: seen face on it is a saddle between two tilts of equal worth."""
    rng = np.random.default_rng(0)
    mean = np.vstack([rng.normal(size=(2, 9)), np.zeros(9)])
    mean -= mean.mean(axis=1, keepdims=True)
    prior = Mixture(np.ones(1), mean[None], 1e-3 * np.eye(27)[None])
    tilt = rotation_about(np.array([0.0, 1.0, 0.0]), np.array(0.3))
    starts = np.stack([np.eye(3), tilt, tilt.T])[None]
    found = solve(prior, (tilt @ mean)[None, :2], starts, 1e-3, modes=3)
    assert shares_of(found.modes)[0] == pytest.approx([0.5, 0.5, 0], abs=1e-5)


def test_components_together_are_those_alone(draw_mixture):
    """Climbs side by side, that leave as they arrive or lose hope, change nothing that counts."""
    prior, residual_variance = draw_mixture(8, k=13, p=9, size=0.1), 0.01
    _, w, R = draw_images(prior, 12, 9, residual_variance)
    w[2:, :, 3], w[5, :, [0, 7]] = np.nan, np.nan
    outliers = Outliers(0.02)
    together = solve(prior, w, R[:, None], residual_variance, outliers=outliers)
    alone = [
        solve(
            Mixture(np.ones(1), mean[None], C[None]),
            w,
            R[:, None],
            residual_variance,
            outliers=outliers,
        )
        for mean, C in zip(prior.means, prior.covariances, strict=True)
    ]
    logs = np.log(prior.weights)[:, None] + np.stack([one.log_evidence for one in alone])
    evidence = np.logaddexp.reduce(logs)
    assert together.log_evidence == pytest.approx(evidence, abs=0.02)
    share = np.exp(logs - evidence)
    mean = np.einsum("kn,knap->nap", share, np.stack([one.mean for one in alone]))
    assert np.abs(together.mean - mean).max() < 0.02
