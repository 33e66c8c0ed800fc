"""How sure a prior may be: planted training sets too small and large enough, folds, densities."""

import numpy as np
import pytest

from shapefit.dictionary.left_out import (
    AS_LEARNED,
    FLOORS,
    FOLDS,
    SHRINKAGES,
    WIDTHS,
    Sureness,
    choose_sureness,
    find_folds,
    log_densities,
)
from shapefit.dictionary.mixture import Mixture, learn_mixture, widen

TRIED = (SHRINKAGES, FLOORS, WIDTHS)
P = 6


def draw(n: int, seed: int):
    """Shapes (n, 3, P) from one Gaussian whose deviations fall from 1 to .05."""
    rng = np.random.default_rng(0)
    axes = np.linalg.qr(rng.normal(size=(3 * P, 3 * P)))[0]
    deviations = np.geomspace(1.0, 0.05, 3 * P)
    z = np.random.default_rng(seed).normal(size=(n, 3 * P)) * deviations
    return (z @ axes.T).reshape(n, 3, P)


def learned(shapes, components=1):
    s, g, _ = AS_LEARNED
    return learn_mixture(shapes, components, shrinkage=s, floor=g).mixture


def choose(shapes, folds, components=1):
    tried = (SHRINKAGES[: 1 if components == 1 else None], FLOORS, WIDTHS)
    ones = np.ones(len(shapes))
    return choose_sureness(shapes, ones, folds, learned(shapes, components), tried)


def test_a_prior_of_few_shapes_is_made_less_sure_than_it_believes():
    """Fresh shapes lie where it says they do: their mean square distance is 1 a coordinate."""
    few, fresh = draw(24, 1), draw(400, 2)
    found = choose(few, find_folds(few, None))
    s, g, f = found.sureness
    assert f > 1
    assert found.folds == FOLDS
    assert found.gain > 1
    priors = (learned(few), widen(learn_mixture(few, 1, shrinkage=s, floor=g).mixture, f))
    distances = []
    for prior in priors:
        apart = (fresh - prior.means[0]).reshape(len(fresh), -1)
        distances.append(
            float((apart * np.linalg.solve(prior.covariances[0], apart.T).T).sum(axis=1).mean())
        )
    assert distances[0] > 1.4 * 3 * P  # too sure
    assert distances[1] < 1.1 * 3 * P


@pytest.mark.parametrize("components", [1, 4])
def test_a_prior_of_many_shapes_stays_as_learned(components):
    many = draw(4000, 3)
    names = tuple(f"take {i // 250}" for i in range(4000))
    found = choose(many, find_folds(many, names), components)
    assert found.sureness == AS_LEARNED
    assert (found.folds, found.gain) == (FOLDS, 0.0)


def test_sequences_are_left_out_whole_and_what_was_given_stays():
    shapes = draw(60, 4)
    names = tuple(f"take {i // 20}" for i in range(60))
    folds = find_folds(shapes, names)
    assert len(set(zip(names, folds.tolist(), strict=True))) == len(set(folds.tolist())) == 3
    many = find_folds(draw(400, 4), tuple(f"take {i // 10}" for i in range(400)))
    assert (np.bincount(many) == 50).all()
    assert (np.diff(many) >= 0).all()
    given = choose_sureness(
        shapes, np.ones(60), folds, learned(shapes), ((0.1,), (0.005,), (1.0, 8.0))
    )
    assert given.sureness[:2] == (0.1, 0.005)


def test_without_two_folds_nothing_is_chosen():
    shapes = draw(20, 5)
    assert choose(shapes, np.zeros(20, int)) == (Sureness(*AS_LEARNED), 0, 0.0)


def test_densities_are_those_of_the_mixture_of_shapes_without_their_middle():
    rng = np.random.default_rng(6)
    roots = rng.normal(size=(2, 9, 9))
    mixture = Mixture(
        np.array([0.3, 0.7]), rng.normal(size=(2, 3, 3)), roots @ roots.swapaxes(1, 2)
    )
    X, noise = rng.normal(size=(5, 9)), 0.2
    found = log_densities(X, mixture, [(1.0, 0.1), (2.0, 0.3)], noise)
    basis = np.kron(np.eye(3), np.array([[1, 1], [-1, 1], [0, -2]]) / np.sqrt([2, 6]))
    for column, (f, v) in enumerate([(1.0, 0.1), (2.0, 0.3)]):
        expected = np.zeros(5)
        for weight, mean, C in zip(
            mixture.weights, mixture.means, mixture.covariances, strict=True
        ):
            own = f * basis.T @ C @ basis + v * np.eye(6)
            y = (X - mean.ravel()) @ basis
            square = np.einsum("ni,ij,nj->n", y, np.linalg.inv(own), y)
            trace = noise * np.trace(np.linalg.inv(own))
            size = np.linalg.slogdet(2 * np.pi * own)[1]
            expected += weight * np.exp(-0.5 * (square + trace + size))
        np.testing.assert_allclose(found[:, column], np.log(expected), rtol=1e-9)
    moved = X + np.repeat([3.0, -1.0, 2.0], 3)
    np.testing.assert_allclose(log_densities(moved, mixture, [(1.0, 0.1)], noise), found[:, :1])
