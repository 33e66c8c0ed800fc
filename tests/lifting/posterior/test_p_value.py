"""The p-value of an image: uniform where the model holds, 0 where nothing is
believed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.special import gammaincc

import shapefit
from shapefit.arrays import Flags, Floats
from shapefit.convex.problem import build_problem
from shapefit.convex.solver import solve_newton
from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary
from shapefit.lifting.posterior import p_value
from shapefit.lifting.posterior.method import lift_to_posterior, with_p_value
from shapefit.lifting.posterior.model import PosteriorModel
from shapefit.lifting.posterior.p_value import (
    draw_table,
    find_chance_above,
    find_p_values,
    moments_at,
    with_p_value_table,
)
from shapefit.lifting.posterior.posterior import Outliers, find_posterior
from tests.gaussians import covariance_of_root, single_gaussian
from tests.lifting.posterior.scenes import draw_images

N = 800
"""Images."""

RESIDUAL_VARIANCE = 0.006

OUTLIERS = Outliers(0.02, 0.05)
"""Their chance, and their density over the image."""


def people(count: int) -> Mixture:
    """The prior over `count` landmarks of people."""
    prior = shapefit.read_dictionary("people").prior
    assert prior is not None
    p = prior.means.shape[2]
    some = np.random.default_rng(0).permutation(p)[:count]
    return prior.marginal(np.sort(some))


def planted(count: int) -> Mixture:
    """Four Gaussians, as wide as a tenth of their shapes and more."""
    rng = np.random.default_rng(3)
    d = 3 * count
    means = rng.normal(size=(4, 3, count))
    near_the_first = means[0] + 0.4 * (means - means[0])
    roots = 0.1 * np.sqrt(4 / d) * rng.normal(size=(4, d, d))
    covariances = covariance_of_root(roots, floor=0.01)
    return Mixture(np.array([0.4, 0.3, 0.2, 0.1]), near_the_first, covariances)


@dataclass(frozen=True)
class Drawn:
    """Images of the model."""

    landmarks: Floats
    rotations: Floats
    is_outlier: Flags


def draw(prior: Mixture, chance: float = 0.0) -> Drawn:
    """Draw images of the model, of which some landmarks lie anywhere."""
    _, w, R = draw_images(prior, N, 7, RESIDUAL_VARIANCE)
    rng = np.random.default_rng(8)
    is_outlier = rng.random(w.shape[::2]) < chance
    half_side = OUTLIERS.density**-0.5 / 2
    anywhere = rng.uniform(-half_side, half_side, w.shape)
    return Drawn(np.where(is_outlier[:, None], anywhere, w), R, is_outlier)


@cache
def table_of(make: Callable[[int], Mixture], count: int) -> Floats:
    """Return the moments for a prior as it is, which take longer than all else here."""
    return moments_at(draw_table(make(count), (1.0,)), 1.0)


def find(make: Callable[[int], Mixture], count: int, hidden: int = 0) -> Floats:
    """P-values of images of the model, as the method finds them."""
    prior = make(count)
    landmarks = draw(prior).landmarks
    random_order = np.random.default_rng(8).random((N, count)).argsort(axis=1)
    weights = (random_order >= hidden).astype(float)
    lam = np.full(N, 0.1)
    problem = build_problem(landmarks, prior.means, lam, weights=weights)
    model = PosteriorModel(
        prior=prior,
        mean_shape=np.tensordot(prior.weights, prior.means, 1),
        p_value_table=table_of(make, count),
        residual_variance=RESIDUAL_VARIANCE,
    )

    found = lift_to_posterior(problem, model, solve=solve_newton)

    assert found.covariance is None  # for which nobody asked
    return with_p_value(found, problem, model, solve=solve_newton).p_value


def assert_uniform(p: Floats) -> None:
    """Within four standard errors of these images and of those that the method
    draws.
    """
    for chance in (0.05, 0.5):
        variance = chance * (1 - chance) * (1 / len(p) + 1 / 400)
        share_below = (p < chance).mean()
        assert share_below == pytest.approx(chance, abs=4 * np.sqrt(variance))


@pytest.mark.parametrize("make", [people, planted])
@pytest.mark.parametrize("count", [5, 8, 15])
def test_images_of_the_model_have_uniform_values(make, count):
    assert_uniform(find(make, count))


@pytest.mark.parametrize("visible", [8, 11])
def test_hidden_landmarks_have_no_degrees_of_freedom(visible):
    assert_uniform(find(people, 15, hidden=15 - visible))


def test_gross_landmarks_that_are_known_do_not_count():
    """In images of which all outliers are found, and no other landmark is one."""
    p = 15
    prior = people(p)
    images = draw(prior, chance=0.05)
    residual_variance = np.full((N, p), RESIDUAL_VARIANCE)
    no_noise = np.zeros((N, p, 2, 2))
    starts = images.rotations[:, None]
    found = find_posterior(
        images.landmarks, residual_variance, no_noise, prior, starts, OUTLIERS
    )

    values = find_p_values(
        found.squared_mahalanobis,
        np.full(N, p),
        found.inlier_probability.sum(axis=1),
        table_of(people, p),
    )

    is_disbelieved = found.inlier_probability < 0.5
    is_known = (is_disbelieved == images.is_outlier).all(axis=1)
    has_outliers = images.is_outlier.any(axis=1)
    assert is_known[has_outliers].mean() > 0.7
    assert_uniform(values[is_known & has_outliers])


@pytest.mark.parametrize(
    ("square", "visible", "believed"), [(7.0, 3, 3.0), (np.nan, 12, 0.0)]
)
def test_three_landmarks_or_no_fit_have_no_value(square, visible, believed):
    assert np.isnan(find_one(square, visible, believed))


@pytest.mark.parametrize(("visible", "believed"), [(4, 2.9), (12, 7.9)])
def test_where_too_few_landmarks_are_believed_the_value_is_0(visible, believed):
    assert find_one(1.0, visible, believed) == 0


@pytest.mark.parametrize("believed", [8.1, 12.0])
def test_where_enough_are_believed_the_square_decides(believed):
    assert find_one(1.0, 12, believed) > 0.9


def find_one(square: float, visible: int, believed: float) -> float:
    """Return the p-value of one image under the planted prior."""
    (value,) = find_p_values(
        np.array([square]),
        np.array([visible]),
        np.array([believed]),
        table_of(planted, 15),
    )
    return float(value)


@pytest.fixture(scope="module")
def table() -> Floats:
    """What is stored for two scales of the residual variance, 1 and 4."""
    return draw_table(planted(15), (1.0, 4.0))


class TestTable:
    def test_it_has_four_counts_of_landmarks_for_each_scale(self, table):
        first_scale_rows = table[: len(table) // 2]
        assert first_scale_rows[:, 1].tolist() == [4, 6, 9, 15]

    @pytest.mark.parametrize("scale", [1.0, 0.1])
    def test_it_gives_what_drawing_gives_for_the_first_scale_and_below(
        self, table, scale
    ):
        drawn = table_of(planted, 15)
        assert moments_at(table, scale) == pytest.approx(drawn)

    @pytest.mark.parametrize("cores", [1, 2, 3])
    def test_no_bit_depends_on_the_number_of_threads(self, table, monkeypatch, cores):
        monkeypatch.setattr("os.cpu_count", lambda: cores)
        assert_array_equal(draw_table(planted(15), (1.0, 4.0)), table)

    def test_above_the_last_scale_it_gives_that_of_the_last(self, table):
        last_scale_moments = table[table[:, 0] == 4, 1:]
        assert moments_at(table, 50.0) == pytest.approx(last_scale_moments)

    def test_between_scales_it_is_interpolated(self, table):
        drawn = moments_at(draw_table(planted(15), (2.0,)), 2.0)
        _, mean, variance = moments_at(table, 2.0).T
        _, drawn_mean, drawn_variance = drawn.T
        assert mean == pytest.approx(drawn_mean, abs=0.25)
        assert variance == pytest.approx(drawn_variance, rel=0.2)

    def test_the_control_variate_saves_some_of_the_images(self, monkeypatch):
        drawn_images = []

        def find_and_count(**keys):
            drawn_images.append(len(keys["landmarks"]))
            return find_posterior(**keys)

        monkeypatch.setattr(p_value, "find_posterior", find_and_count)
        draw_table(planted(15), (2.0,))

        without_it = 4 * p_value.DRAWN_IMAGES
        assert 0 < sum(drawn_images) < 0.85 * without_it


def test_distances_at_the_true_view_have_2p_less_2_degrees_of_freedom():
    p = 5
    mixture = planted(p)
    prior = single_gaussian(mixture.means[0], mixture.covariances[0])
    images = draw(prior)
    component = np.zeros(N, int)
    all_seen = np.ones((N, p), bool)

    distances = p_value.true_distances(
        prior, p_value.Drawn(component, images.rotations, images.landmarks, all_seen)
    )

    assert distances.mean() == pytest.approx(2 * p - 2, abs=0.5)


def test_without_a_prior_there_is_no_table():
    bare = Dictionary(np.ones((1, 3, 4)), tuple("abcd"), np.ones((3, 4)))
    assert with_p_value_table(bare) is bare


@pytest.mark.parametrize(
    ("mean", "variance"), [(4.5, 3.0), (24.0, 25.0), (76.0, 136.0)]
)
def test_wilson_and_hilferty(mean, variance):
    """Their approximation beside the gamma distribution itself."""
    x = np.linspace(0.5, 60, 40)
    exact = gammaincc(mean**2 / variance, x * mean / variance)

    found = find_chance_above(x, np.full(40, mean), np.full(40, variance))

    assert found == pytest.approx(exact, abs=4e-3)
