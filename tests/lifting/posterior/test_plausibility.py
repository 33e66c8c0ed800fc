"""The p-value of an image: uniform where the model holds, 0 where nothing is believed."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import gamma

import shapefit
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import build_problem
from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.rotations import random_rotations
from shapefit.lifting.methods import PosteriorOptions, Settings
from shapefit.lifting.posterior.method import lift_to_posterior
from shapefit.lifting.posterior.plausibility import Model, exceeds, find_plausibility
from shapefit.lifting.posterior.posterior import Gross

IMAGES, MISFIT, CHANCE, DENSITY = 1600, 0.006, 0.02, 0.05


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


def find(prior: Mixture, chance: float = 0.0, hidden: int = 0):
    """Plausibility and beliefs of images of the model, as the method finds them from any start."""
    rng, p = np.random.default_rng(7), prior.means.shape[2]
    k = rng.choice(len(prior), size=IMAGES, p=prior.weights)
    roots = np.linalg.cholesky(prior.covariances)[k]
    x = prior.means[k] + (roots @ rng.normal(size=(IMAGES, 3 * p, 1))).reshape(-1, 3, p)
    w = (random_rotations(IMAGES, rng) @ x)[:, :2]
    w += np.sqrt(MISFIT) * rng.normal(size=(IMAGES, 2, p))
    side = DENSITY**-0.5
    gross = rng.random((IMAGES, p)) < chance
    w = np.where(gross[:, None], rng.uniform(-side / 2, side / 2, w.shape), w)
    weights = (rng.random((IMAGES, p)).argsort(axis=1) >= hidden).astype(float)
    problem = build_problem(w, prior.means, np.full(IMAGES, 0.1), weights=weights)
    options = PosteriorOptions(misfit=MISFIT, gross_chance=CHANCE, gross_density=DENSITY)
    settings = Settings(
        solve=solve_newton,
        mean_shape=prior.weights @ prior.means.reshape(len(prior), -1),
        needs={"prior": prior},
        options=options,
    )
    settings = replace(settings, mean_shape=settings.mean_shape.reshape(3, p))
    return lift_to_posterior(problem, settings).further["plausibility"]


def assert_uniform(p):
    """Within four standard errors of these images and of those that the method draws."""
    for chance in (0.05, 0.5):
        error = np.sqrt(chance * (1 - chance) * (1 / IMAGES + 1 / 400))
        assert (p < chance).mean() == pytest.approx(chance, abs=4 * error)


@pytest.mark.parametrize("draw", [people, planted])
@pytest.mark.parametrize("count", [5, 8, 15])
def test_images_of_the_model_have_uniform_values(draw, count):
    assert_uniform(find(draw(count)))


def test_many_landmarks():
    assert_uniform(find(planted(41)))


def test_what_is_gross_does_not_count_among_the_others():
    """Landmarks that fall anywhere, one of fifty: a few images are found in a wrong view for it."""
    p = find(people(15), chance=0.02)
    assert (p < 0.05).mean() < 0.11
    assert (p < 0.5).mean() == pytest.approx(0.5, abs=0.06)


@pytest.mark.parametrize("seen", [8, 11])
def test_hidden_landmarks_have_no_degrees_of_freedom(seen):
    assert_uniform(find(people(15), hidden=15 - seen))


def test_the_number_believed_decides_where_nothing_else_can():
    model = Model(planted(15), MISFIT, Gross(CHANCE, DENSITY))
    surprise = np.array([7.0, np.nan, 1.0, 1.0, 1.0, 1.0])
    seen = np.array([3, 12, 4, 12, 12, 12])
    believed = np.array([3.0, 0.0, 2.9, 7.9, 8.1, 12.0])
    p = find_plausibility(surprise, seen, believed, model)
    assert np.isnan(p[:2]).all()
    assert p[2:4].tolist() == [0, 0]
    assert (p[4:] > 0.9).all()


def test_a_body_that_is_not_there_is_implausible():
    model = Model(planted(15), MISFIT, Gross(CHANCE, DENSITY))
    assert find_plausibility(np.array([80.0]), np.array([15]), np.array([15.0]), model)[0] < 1e-4


def test_wilson_and_hilferty():
    x = np.linspace(0.5, 60, 40)
    for mean, variance in ((4.5, 3.0), (24.0, 25.0), (76.0, 136.0)):
        true = gamma.sf(x, mean**2 / variance, scale=variance / mean)
        each = np.full(len(x), mean)
        assert exceeds(x, each, 0 * x + variance) == pytest.approx(true, abs=4e-3)
