"""Levels of the truth in error bars: against dense linear algebra, and planted from the
bars.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import chdtr, chdtri  # scipy.stats takes a second to import

from shapefit.evaluation.calibration import (
    SQUARED_RADII,
    ErrorBars,
    bar_scale_factors,
    measure_error_bars,
    summarise_coverage,
)
from tests.gaussians import covariance_of_root, deviations_and_correlations
from tests.points import centred, with_noise

BINOMIAL = 4
"""Standard errors of a binomial share within which a planted one must be."""


def draw(rng, n, p, size):
    """Estimates (n, 3, p), covariances (n, p, 3, 3), and truths drawn from them, then
    moved.
    """
    estimate = rng.standard_normal((n, 3, p))
    root = size * rng.standard_normal((n, p, 3, 3))
    covariance = covariance_of_root(root, floor=0.1 * size**2)
    L = np.linalg.cholesky(covariance)
    error = np.einsum("npab,npb->nap", L, rng.standard_normal((n, p, 3)))
    scale = rng.uniform(0.1, 10, (n, 1, 1))
    shift = rng.standard_normal((n, 3, 1))
    return estimate, covariance, scale * (estimate + error) + shift


def find_levels(estimate, truth, *bars):
    """The level of the ellipsoid on which the truth lies, uniform where bars are true;
    widths.
    """
    unturned = np.tile(np.eye(3), (len(truth), 1, 1))
    square, width = measure_error_bars(estimate, truth, unturned, *bars)
    return chdtr(3, square), width


def placed_by_least_squares(estimate, truth, sd):
    """The truth placed, its scale, the leverages (2, p): by a dense system over a, t_x,
    t_y.
    """
    p = estimate.shape[1]
    weight = 1 / sd[:2].ravel()
    columns = np.column_stack([truth[:2].ravel(), np.repeat(np.eye(2), p, axis=0)])
    A = weight[:, None] * columns
    b = weight * estimate[:2].ravel()
    (a, *t), *_ = np.linalg.lstsq(A, b, rcond=None)
    leverage = np.diag(A @ np.linalg.pinv(A)).reshape(2, p)
    depth = estimate[2].mean() - a * truth[2].mean()
    placed = a * truth + np.array([*t, depth])[:, None]
    return placed, a, leverage


def test_levels_and_widths_are_those_of_dense_algebra(rng):
    n, p = 12, 7
    estimate, covariance, truth = draw(rng, n, p, 0.2)
    sd, correlation = deviations_and_correlations(covariance)

    level, width = find_levels(estimate, truth, sd, correlation)

    for i in range(n):
        placed, scale, leverage = placed_by_least_squares(estimate[i], truth[i], sd[i])
        error = estimate[i] - placed
        error[:2] /= np.sqrt(1 - leverage)
        for j in range(p):
            C = covariance[i, j]
            square = error[:, j] @ np.linalg.solve(C, error[:, j])
            squared_axes = chdtri(3, 0.1) * np.linalg.eigvalsh(C)
            in_unit_of_truth = np.sqrt(squared_axes.mean()) / scale
            assert level[i, j] == pytest.approx(chdtr(3, square))
            assert width[i, j] == pytest.approx(in_unit_of_truth)


def posterior_and_truth(rng, n, hidden, noise=0.03, p=15, k=42):
    """A Gaussian model of shapes and what it says of n images (n, 3, p), beside true
    shapes.

    The view is known; size and place of a shape are not. `hidden` landmarks an image
    are unseen.
    """
    mean = centred(rng.standard_normal((3, p)))
    B = centred(0.15 * rng.standard_normal((k, 3, p)))
    linear_map = linear_map_of(mean, B)
    prior = np.diag([1.0] * k + [1e-8] * 3)  # size and place are free
    estimate = np.empty((n, 3, p))
    truth = np.empty((n, 3, p))
    covariance = np.empty((n, p, 3, 3))
    for i in range(n):
        truth[i] = mean + np.tensordot(rng.standard_normal(k), B, 1)
        visible = rng.permutation(p) >= hidden
        X = linear_map[:2, visible].reshape(-1, k + 3)
        y = with_noise(truth[i][:2, visible], noise, rng).ravel()
        unknown_covariance = np.linalg.inv(X.T @ X / noise**2 + prior)
        unknowns = unknown_covariance @ X.T @ (y - X[:, k]) / noise**2
        estimate[i] = mean + linear_map @ unknowns
        covariance[i] = np.einsum(
            "api,ij,bpj->pab", linear_map, unknown_covariance, linear_map
        )
    resized = 2.7 * truth + rng.standard_normal((n, 3, 1))
    return estimate, covariance, resized


def linear_map_of(mean, B):
    """Return what coefficients, size, and shifts along x and y do to a shape:
    (3, p, k + 3).
    """
    k = len(B)
    linear_map = np.zeros((*mean.shape, k + 3))
    linear_map[:, :, :k] = np.moveaxis(B, 0, 2)
    linear_map[:, :, k] = mean
    linear_map[0, :, k + 1] = 1
    linear_map[1, :, k + 2] = 1
    return linear_map


@pytest.mark.parametrize("hidden", [0, 7])
@pytest.mark.parametrize("nominal", [0.5, 0.9])
class TestPosterior:
    """Depths that are barely known must not move the scale of x and y, which are known
    well.
    """

    N = 400

    def test_it_holds_as_much_of_the_truth_as_it_says(self, rng, hidden, nominal):
        estimate, covariance, truth = posterior_and_truth(rng, self.N, hidden)
        bars = deviations_and_correlations(covariance)

        level, _ = find_levels(estimate, truth, *bars)

        shares = (level <= nominal).mean(axis=1)
        error = BINOMIAL * shares.std() / np.sqrt(self.N)
        assert shares.mean() == pytest.approx(nominal, abs=error)

    def test_narrower_bars_hold_less(self, rng, hidden, nominal):
        estimate, covariance, truth = posterior_and_truth(rng, self.N, hidden)
        sd, correlation = deviations_and_correlations(covariance)

        level, _ = find_levels(estimate, truth, 0.8 * sd, correlation)

        assert (level <= nominal).mean() < nominal - 0.05


class TestUnknowns:
    """What is not known is left out, and changes nothing of the rest."""

    @pytest.fixture
    def drawn(self, rng):
        """Four images: of the third there is no estimate, of the second too few true
        landmarks to place, of the first one true landmark is missing.
        """
        estimate, covariance, truth = draw(rng, 4, 6, 0.2)
        truth[0, :, 2] = np.nan
        truth[1, :, 2:] = np.nan
        estimate[2] = np.nan
        return estimate, truth, *deviations_and_correlations(covariance)

    def test_they_have_no_level_and_no_width(self, drawn):
        level, width = find_levels(*drawn)
        unknown = np.isnan(level)
        assert unknown.sum(axis=1).tolist() == [1, 6, 6, 0]
        assert_array_equal(np.isnan(width), unknown)

    def test_the_others_do_not_feel_them(self, drawn):
        others = [0, 1, 3, 4, 5]
        level, _ = find_levels(*drawn)
        alone, _ = find_levels(*(each[:1, :, others] for each in drawn))
        assert_allclose(level[0, others], alone[0])


def test_radii_are_those_of_the_chi_squared_distribution():
    expected = [chdtri(3, 1 - level) for level in SQUARED_RADII]
    assert [*SQUARED_RADII.values()] == pytest.approx(expected, rel=1e-14)


class TestSums:
    """Levels of three images of two landmarks, one of which is unknown."""

    @pytest.fixture
    def bars(self):
        level = np.array([[0.2, 0.8], [0.6, np.nan], [0.95, 0.4]])
        width = np.array([[1.0, 2.0], [3.0, np.nan], [5.0, 6.0]])
        return ErrorBars(chdtri(3, 1 - level), {"normalised": width})

    def test_the_share_of_an_image_is_of_the_landmarks_within_90_percent(self, bars):
        assert_allclose(bars.coverage_by_image(), [1, 1, 0.5])

    def test_groups_are_summed_up_where_they_have_images(self, bars):
        groups = {"13": ("a", "b"), "14": ("c",), "15": ("d",)}

        first, second = summarise_coverage("m", bars, ["a", "b", "c"], groups)

        assert first["group"] == "13"
        assert first["counted"] == 3
        assert first["inside"] == pytest.approx([1 / 3, 1.0])
        assert first["median_width"] == {"normalised": 2.0}
        assert second["counted"] == 2
        assert second["inside"] == [0.5, 0.5]


class TestScaleFactors:
    """Factors for bars of 50% and 90% undo what they lack."""

    @pytest.fixture
    def squares(self, rng):
        """Squared errors as true bars have them, in order."""
        errors = rng.standard_normal((40_000, 3))
        return np.sort((errors**2).sum(axis=1))

    def factors(self, squares):
        return bar_scale_factors(ErrorBars(squares[:, None], {}))

    def test_errors_twice_as_large_as_the_bars_have_the_factor_2(self, squares):
        factors = self.factors(4 * squares)
        assert [*factors.values()] == pytest.approx([2, 2], rel=0.01)

    def test_where_large_errors_alone_are_twice_as_large_one_factor_is_2(self, squares):
        is_large = squares > np.quantile(squares, 0.6)
        factors = self.factors(np.where(is_large, 4 * squares, squares))
        assert [*factors.values()] == pytest.approx([1, 2], rel=0.01)

    def test_of_nine_errors_the_fifth_and_the_ninth_count(self):
        factors = self.factors(np.arange(1.0, 10))
        expected = np.sqrt(np.array([5, 9]) / [*SQUARED_RADII.values()])
        assert [*factors.values()] == pytest.approx(expected)

    def test_too_few_errors_have_no_factor(self, squares):
        assert self.factors(squares[:8])["90%"] is None
