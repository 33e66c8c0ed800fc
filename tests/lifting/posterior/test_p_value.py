"""The p-value of an image: uniform where the model holds, 0 where nothing is
believed.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.special import gammaincc

import shapefit
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
from tests.lifting.posterior.scenes import draw_images

IMAGES, RESIDUAL_VARIANCE, CHANCE, DENSITY = 800, 0.006, 0.02, 0.05


def people(count: int) -> Mixture:
    """The prior over `count` landmarks of people."""
    prior = shapefit.read_dictionary("people").prior
    assert prior is not None
    p = prior.means.shape[2]
    return prior.marginal(np.sort(np.random.default_rng(0).permutation(p)[:count]))


def planted(count: int) -> Mixture:
    """Four Gaussians, as wide as a tenth of their shapes and more."""
    rng, d = np.random.default_rng(3), 3 * count
    means = rng.normal(size=(4, 3, count))
    means = means[0] + 0.4 * (means - means[0])
    roots = 0.1 * rng.normal(size=(4, d, d))
    covariances = 4 / d * roots @ roots.swapaxes(1, 2) + 0.01 * np.eye(d)
    return Mixture(np.array([0.4, 0.3, 0.2, 0.1]), means, covariances)


def draw(prior: Mixture, chance: float = 0.0):
    """Images of the model: landmarks (n, 2, p), rotations, and which landmarks are
    outliers.
    """
    _, w, R = draw_images(prior, IMAGES, 7, RESIDUAL_VARIANCE)
    rng, side = np.random.default_rng(8), DENSITY**-0.5
    outliers = rng.random(w.shape[::2]) < chance
    return (
        np.where(outliers[:, None], rng.uniform(-side / 2, side / 2, w.shape), w),
        R,
        outliers,
    )


@cache
def table_of(make: Callable[[int], Mixture], count: int):
    """Return the moments for a prior as it is, which take longer than all else here."""
    return moments_at(draw_table(make(count), (1.0,)), 1.0)


def find(make: Callable[[int], Mixture], count: int, hidden: int = 0):
    """P-values of images of the model, as the method finds them."""
    prior = make(count)
    w, _, _ = draw(prior)
    p = w.shape[2]
    order = np.random.default_rng(8).random((IMAGES, p)).argsort(axis=1)
    weights = (order >= hidden).astype(float)
    problem = build_problem(w, prior.means, np.full(IMAGES, 0.1), weights=weights)
    model = PosteriorModel(
        prior=prior,
        mean_shape=np.tensordot(prior.weights, prior.means, 1),
        p_value_table=table_of(make, count),
        residual_variance=RESIDUAL_VARIANCE,
    )
    found = lift_to_posterior(problem, model, solve=solve_newton)
    assert found.covariance is None  # for which nobody asked
    return with_p_value(found, problem, model, solve=solve_newton).p_value


def assert_uniform(p):
    """Within four standard errors of these images and of those that the method
    draws.
    """
    for chance in (0.05, 0.5):
        error = np.sqrt(chance * (1 - chance) * (1 / len(p) + 1 / 400))
        assert (p < chance).mean() == pytest.approx(chance, abs=4 * error)


@pytest.mark.parametrize("make", [people, planted])
@pytest.mark.parametrize("count", [5, 8, 15])
def test_images_of_the_model_have_uniform_values(make, count):
    assert_uniform(find(make, count))


def test_gross_landmarks_that_are_known_do_not_count():
    prior = people(15)
    w, R, outliers = draw(prior, chance=0.05)
    noise, gross_model = np.zeros((IMAGES, 15, 2, 2)), Outliers(CHANCE, DENSITY)
    residual_variance = np.full((IMAGES, 15), RESIDUAL_VARIANCE)
    found = find_posterior(w, residual_variance, noise, prior, R[:, None], gross_model)
    table = table_of(people, 15)
    p = find_p_values(
        found.squared_mahalanobis,
        np.full(IMAGES, 15),
        found.inlier_probability.sum(axis=1),
        table,
    )
    known = ((found.inlier_probability < 0.5) == outliers).all(axis=1)
    assert known[outliers.any(axis=1)].mean() > 0.7
    assert_uniform(p[known & outliers.any(axis=1)])


@pytest.mark.parametrize("visible", [8, 11])
def test_hidden_landmarks_have_no_degrees_of_freedom(visible):
    assert_uniform(find(people, 15, hidden=15 - visible))


def test_the_number_believed_decides_where_nothing_else_can():
    table = table_of(planted, 15)
    squared_mahalanobis = np.array([7.0, np.nan, 1.0, 1.0, 1.0, 1.0])
    visible = np.array([3, 12, 4, 12, 12, 12])
    believed = np.array([3.0, 0.0, 2.9, 7.9, 8.1, 12.0])
    p = find_p_values(squared_mahalanobis, visible, believed, table)
    assert np.isnan(p[:2]).all()
    assert p[2:4].tolist() == [0, 0]
    assert (p[4:] > 0.9).all()


def test_a_stored_table_gives_what_drawing_gives_and_is_interpolated_between_scales(
    monkeypatch,
):
    prior = planted(15)
    table = draw_table(prior, (1.0, 4.0))
    drawn = table_of(planted, 15)
    assert moments_at(table, 1.0) == pytest.approx(drawn)
    assert moments_at(table, 0.1) == pytest.approx(drawn)
    assert moments_at(table, 50.0) == pytest.approx(table[table[:, 0] == 4, 1:])
    assert table[: len(table) // 2, 1].tolist() == [4, 6, 9, 15]
    images, real = [], p_value.find_posterior
    counted = lambda **keys: images.append(len(keys["landmarks"])) or real(**keys)  # noqa: E731
    monkeypatch.setattr(p_value, "find_posterior", counted)
    between = moments_at(draw_table(prior, (2.0,)), 2.0)
    assert (
        sum(images) < 0.85 * 4 * p_value.DRAWN_IMAGES
    )  # the control variate saves some of each count
    assert moments_at(table, 2.0)[:, 1] == pytest.approx(between[:, 1], abs=0.25)
    assert moments_at(table, 2.0)[:, 2] == pytest.approx(between[:, 2], rel=0.2)


def test_distances_at_the_true_view_have_2p_less_2_degrees_of_freedom():
    prior = Mixture(np.ones(1), planted(5).means[:1], planted(5).covariances[:1])
    w, R, _ = draw(prior)
    shown = np.ones((IMAGES, 5), bool)
    drawn = p_value.Drawn(np.zeros(IMAGES, int), R, w, shown)
    y = p_value.true_distances(prior, drawn)
    assert y.mean() == pytest.approx(2 * 5 - 2, abs=0.5)


def test_without_a_prior_there_is_no_table():
    bare = Dictionary(np.ones((1, 3, 4)), tuple("abcd"), np.ones((3, 4)))
    assert with_p_value_table(bare) is bare


def test_wilson_and_hilferty():
    x = np.linspace(0.5, 60, 40)
    for mean, variance in ((4.5, 3.0), (24.0, 25.0), (76.0, 136.0)):
        true = gammaincc(mean**2 / variance, x * mean / variance)
        each = np.full(len(x), mean)
        assert find_chance_above(x, each, 0 * x + variance) == pytest.approx(
            true, abs=4e-3
        )
