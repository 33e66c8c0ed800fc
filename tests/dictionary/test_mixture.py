"""Mixtures over shapes: a certificate, planted mixtures, scikit-learn."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import multivariate_normal

from shapefit.dictionary.mixture import (
    Mixture,
    expected_log_density,
    learn_mixture,
    log_prior,
    maximise,
)
from tests.gaussians import covariance_of_root, draw_shapes
from tests.points import flatten


def draw(n: int, seed: int = 0, p: int = 3):
    """Shapes of three well separated Gaussians, and their mixture."""
    rng = np.random.default_rng(seed)
    weights = np.array([0.5, 0.3, 0.2])
    means = 3 * rng.normal(size=(3, 3, p))
    roots = 0.3 * rng.normal(size=(3, 3 * p, 3 * p)) / np.sqrt(p)
    covariances = covariance_of_root(roots, floor=0.02)
    mixture = Mixture(weights, means, covariances)
    return draw_shapes(mixture, n, rng), mixture


def covariance_of(shapes):
    """Return the population's covariance of shapes or of rows."""
    return np.cov(flatten(shapes).T, bias=True)


def nearest_component(mixture, mean):
    """Return the number of the component whose mean is nearest."""
    squares = (mixture.means - mean) ** 2
    return int(squares.sum(axis=(1, 2)).argmin())


def test_a_planted_mixture_is_recovered():
    shapes, truth = draw(6000)

    found = learn_mixture(shapes, 3, shrinkage=0.0, variance_floor=1e-9).mixture

    order = [nearest_component(found, mean) for mean in truth.means]
    assert sorted(order) == [0, 1, 2]
    assert found.weights[order] == pytest.approx(truth.weights, abs=0.03)
    assert found.means[order] == pytest.approx(truth.means, abs=0.05)
    assert found.covariances[order] == pytest.approx(truth.covariances, abs=0.05)


@pytest.mark.parametrize("shrinkage", [0.0, 0.3])
def test_no_round_lowers_the_objective(shrinkage):
    rng = np.random.default_rng(1)
    shapes = rng.normal(size=(400, 3, 4)) ** 3

    learned = learn_mixture(
        shapes, 6, shrinkage=shrinkage, variance_floor=0.05, tolerance=0.0
    )

    trace = learned.trace
    assert len(trace) > 5
    assert (np.diff(trace) >= -1e-8 * np.abs(trace[1:])).all()


@pytest.mark.parametrize("p", [3, 8])
def test_log_densities_are_those_of_scipy(p):
    shapes, mixture = draw(130, p=p)

    found = mixture.log_density(shapes)

    for k in range(3):
        gaussian = multivariate_normal(mixture.means[k].ravel(), mixture.covariances[k])
        expected = np.log(mixture.weights[k]) + gaussian.logpdf(flatten(shapes))
        assert_allclose(found[:, k], expected)


@pytest.mark.parametrize("p", [3, 8])
def test_covariances_are_those_of_weighted_shapes(rng, p):
    """Of some that have hardly a share, too."""
    X = rng.normal(size=(150, 3 * p))
    share = rng.uniform(size=(150, 2))
    share[::7, 0] = 1e-20

    found = maximise(X, share, np.zeros((3 * p, 3 * p)), 0.0, 0.0)

    for k in range(2):
        expected = np.cov(X.T, aweights=share[:, k], bias=True)
        assert_allclose(found.covariances[k], expected, atol=1e-12)


def test_the_log_prior_of_two_covariances():
    """-nu / 2 sum (log det C + tr C^-1 G), with G = 2 I and nu = 3."""
    covariances = np.array([np.diag([1.0, 2.0, 3.0]), 4 * np.eye(3)])
    mixture = Mixture(np.full(2, 0.5), np.zeros((2, 3, 1)), covariances)

    found = log_prior(mixture, 2 * np.eye(3), 3.0)

    first_term = np.log(6) + 2 * (1 + 1 / 2 + 1 / 3)
    second_term = 3 * np.log(4) + 2 * 3 / 4
    assert found == pytest.approx(-1.5 * (first_term + second_term))


def test_the_expected_log_density_is_that_of_shapes_with_errors():
    """Exact for a quadratic: the mean over errors of sqrt(d floor) along each axis."""
    shapes, mixture = draw(7)
    d = 9
    floor = 0.05
    errors = np.sqrt(d * floor) * np.concatenate([np.eye(d), -np.eye(d)])
    moved = flatten(shapes) + errors[:, None]
    log_densities = mixture.log_density(moved.reshape(-1, 3, 3))
    expected = log_densities.reshape(2 * d, 7, 3).mean(axis=0)

    found = expected_log_density(flatten(shapes), mixture, floor)

    assert_allclose(found, expected)


def test_one_component_is_the_gaussian_of_all_shapes(rng):
    shapes = rng.normal(size=(50, 3, 2))
    found = learn_mixture(shapes, 1, shrinkage=0.0, variance_floor=1e-9).mixture
    assert_allclose(found.covariances[0], covariance_of(shapes))


def test_more_components_than_shapes_are_refused(rng):
    shapes = rng.normal(size=(50, 3, 2))
    with pytest.raises(ValueError, match=r"within 1\.\.50, is 51"):
        learn_mixture(shapes, 51, shrinkage=0.0, variance_floor=1e-9)


def test_a_component_that_dies_is_left_out():
    """Of shapes that are all but one, components of one place give way."""
    rng = np.random.default_rng(0)
    shapes = 1e-9 * rng.normal(size=(50, 3, 3))
    shapes[0] += 5.0

    found = learn_mixture(shapes, 3, shrinkage=0.3, variance_floor=0.01).mixture

    assert (found.weights > 1e-3 / 50).all()
    assert found.weights.sum() == pytest.approx(1)


def test_shrinkage_is_the_share_of_the_covariance_of_all():
    """Of two clusters far apart with as many shapes each, by hand."""
    rng = np.random.default_rng(5)
    floor = 0.01
    shrinkage = 1e-3
    middles = 50 * np.array([[[-1.0]], [[1.0]]])
    clusters = (rng.normal(size=(2, 100, 9)) + middles).reshape(2, 100, 3, 3)
    shapes = clusters.reshape(200, 3, 3)

    found = learn_mixture(shapes, 2, shrinkage=shrinkage, variance_floor=floor).mixture

    whole_covariance = covariance_of(shapes) + floor * np.eye(9)
    for cluster in clusters:
        cluster_covariance = covariance_of(cluster) + floor * np.eye(9)
        expected = (1 - shrinkage) * cluster_covariance + shrinkage * whole_covariance
        k = nearest_component(found, cluster.mean(axis=0))
        assert_allclose(found.covariances[k], expected, rtol=1e-6)


def test_no_bit_depends_on_the_number_of_threads(monkeypatch):
    shapes, _ = draw(400)

    def learn_on(cores):
        monkeypatch.setattr("os.cpu_count", lambda: cores)
        return learn_mixture(shapes, 3, shrinkage=0.3, variance_floor=0.01)

    one = learn_on(1)

    for cores in (2, 3):
        several = learn_on(cores)
        assert_array_equal(one.trace, several.trace)
        assert_array_equal(one.mixture.covariances, several.mixture.covariances)
