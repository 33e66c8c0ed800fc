"""Mixtures over shapes: a certificate, planted mixtures, scikit-learn."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.dictionary.mixture import (
    Mixture,
    expected_log_density,
    learn_mixture,
    log_prior,
)


def draw(n: int, seed: int = 0, p: int = 3):
    """Shapes of three well separated Gaussians, and their mixture."""
    rng = np.random.default_rng(seed)
    weights = np.array([0.5, 0.3, 0.2])
    means = 3 * rng.normal(size=(3, 3, p))
    roots = 0.3 * rng.normal(size=(3, 3 * p, 3 * p)) / np.sqrt(p)
    covariances = roots @ roots.swapaxes(1, 2) + 0.02 * np.eye(3 * p)
    k = rng.choice(3, size=n, p=weights)
    z = np.einsum(
        "nij,nj->ni", np.linalg.cholesky(covariances)[k], rng.normal(size=(n, 3 * p))
    )
    return (means.reshape(3, -1)[k] + z).reshape(n, 3, p), Mixture(
        weights, means, covariances
    )


def test_a_planted_mixture_is_recovered():
    shapes, truth = draw(6000)
    found = learn_mixture(shapes, 3, shrinkage=0.0, floor=1e-9).mixture
    order = [
        int(((found.means - mean) ** 2).sum(axis=(1, 2)).argmin())
        for mean in truth.means
    ]
    assert sorted(order) == [0, 1, 2]
    assert found.weights[order] == pytest.approx(truth.weights, abs=0.03)
    assert found.means[order] == pytest.approx(truth.means, abs=0.05)
    assert found.covariances[order] == pytest.approx(truth.covariances, abs=0.05)


@pytest.mark.parametrize("shrinkage", [0.0, 0.3])
def test_no_round_lowers_the_objective(shrinkage):
    rng = np.random.default_rng(1)
    shapes = rng.normal(size=(400, 3, 4)) ** 3
    trace = learn_mixture(
        shapes, 6, shrinkage=shrinkage, floor=0.05, tolerance=0.0
    ).trace
    assert len(trace) > 5
    assert (np.diff(trace) >= -1e-8 * np.abs(trace[1:])).all()


def test_the_log_prior_of_two_covariances():
    covariances = np.array([np.diag([1.0, 2.0, 3.0]), 4 * np.eye(3)])
    mixture = Mixture(np.full(2, 0.5), np.zeros((2, 3, 1)), covariances)
    expected = -1.5 * (np.log(6) + 2 * (1 + 1 / 2 + 1 / 3) + 3 * np.log(4) + 2 * 3 / 4)
    assert log_prior(mixture, 2 * np.eye(3), 3.0) == pytest.approx(expected)


def test_the_expected_log_density_is_that_of_shapes_with_errors(rng):
    """Exact for a quadratic: the mean over errors of sqrt(d floor) along each axis."""
    shapes, mixture = draw(7)
    d, floor = 9, 0.05
    X = shapes.reshape(7, d)
    errors = np.sqrt(d * floor) * np.concatenate([np.eye(d), -np.eye(d)])
    apart = (X + errors[:, None]).reshape(-1, 3, 3)
    expected = mixture.log_density(apart).reshape(2 * d, 7, 3).mean(axis=0)
    assert_allclose(expected_log_density(X, mixture, floor), expected)


def test_one_component_is_the_gaussian_of_all_shapes(rng):
    shapes = rng.normal(size=(50, 3, 2))
    found = learn_mixture(shapes, 1, shrinkage=0.0, floor=1e-9).mixture
    assert_allclose(found.covariances[0], np.cov(shapes.reshape(50, 6).T, bias=True))
    with pytest.raises(ValueError, match=r"within 1\.\.50, is 51"):
        learn_mixture(shapes, 51, shrinkage=0.0, floor=1e-9)


def test_a_component_that_dies_is_left_out():
    """Of shapes that are all but one, components of one place give way."""
    shapes = np.zeros((50, 3, 3)) + 1e-9 * np.random.default_rng(0).normal(
        size=(50, 3, 3)
    )
    shapes[0] += 5.0
    found = learn_mixture(shapes, 3, shrinkage=0.3, floor=0.01).mixture
    assert (found.weights > 1e-3 / 50).all()
    assert found.weights.sum() == pytest.approx(1)


def test_shrinkage_is_the_share_of_the_covariance_of_all():
    """Of two clusters far apart with as many shapes each, by hand."""
    rng, floor, shrinkage = np.random.default_rng(5), 0.01, 1e-3
    X = rng.normal(size=(2, 100, 9)) + 50 * np.array([[[-1.0]], [[1.0]]])
    found = learn_mixture(
        X.reshape(200, 3, 3), 2, shrinkage=shrinkage, floor=floor
    ).mixture
    G = np.cov(X.reshape(200, 9).T, bias=True) + floor * np.eye(9)
    for cluster in X:
        own = np.cov(cluster.T, bias=True) + floor * np.eye(9)
        k = (
            np.abs(found.means.reshape(2, 9) - cluster.mean(axis=0))
            .sum(axis=1)
            .argmin()
        )
        expected = (1 - shrinkage) * own + shrinkage * G
        assert_allclose(found.covariances[k], expected, rtol=1e-6)


def test_no_bit_depends_on_the_number_of_threads(monkeypatch):
    shapes, _ = draw(400)
    found = []
    for cores in (1, 3):
        monkeypatch.setattr("os.cpu_count", lambda cores=cores: cores)
        found.append(learn_mixture(shapes, 3, shrinkage=0.3, floor=0.01))
    one, other = found
    assert_array_equal(one.trace, other.trace)
    assert_array_equal(one.mixture.covariances, other.mixture.covariances)
