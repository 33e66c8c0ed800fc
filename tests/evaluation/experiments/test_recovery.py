"""Planted instances are what they say, and the program finds what an independent solver finds."""

import numpy as np
import pytest
from scipy.stats import kstest

from shapefit.convex.solution import Status
from shapefit.evaluation.experiments.recovery import Instance, plant, recover

CLOSE = {"tolerance": 1e-8, "max_iterations": 10000}


def instance(p, z, seed, k=50):
    return plant(k, p, z, np.random.default_rng(seed))


def error(instance, *, free_translation=False):
    attempt = recover(instance, free_translation=free_translation, **CLOSE)
    assert attempt.status is Status.OPTIMAL
    return attempt.error


def sizes(instance):
    return np.linalg.norm(instance.transforms, ord=2, axis=(1, 2))


@pytest.mark.parametrize(("k", "p", "z"), [(50, 20, 5), (3, 4, 3), (7, 1, 1)])
def test_landmarks_are_the_sum_of_turned_atoms(k, p, z):
    planted = instance(p, z, 1, k)
    W = sum(M @ B for M, B in zip(planted.transforms, planted.atoms, strict=True))
    assert planted.atoms.shape == (k, 3, p)
    np.testing.assert_allclose(planted.landmarks, W, atol=1e-12)


def test_z_transforms_are_multiples_of_two_rows_of_a_rotation_and_the_others_zero():
    planted = instance(20, 5, 2)
    c = sizes(planted)
    assert np.count_nonzero(c) == 5
    assert ((c >= 0) & (c < 1)).all()
    gram = planted.transforms @ planted.transforms.swapaxes(1, 2)
    np.testing.assert_allclose(gram, c[:, None, None] ** 2 * np.eye(2), atol=1e-12)


def test_draws_have_the_distributions_of_the_paper():
    many = [instance(5, 10, seed) for seed in range(100)]
    atoms = np.concatenate([one.atoms.ravel() for one in many])
    coefficients = np.concatenate([sizes(one)[sizes(one) > 0] for one in many])
    places = np.concatenate([np.flatnonzero(sizes(one)) for one in many])
    assert kstest(atoms, "norm").pvalue > 1e-3
    assert kstest(coefficients, "uniform").pvalue > 1e-3
    assert set(places) == set(range(50))
    # A coordinate of a random direction is uniform on [-1, 1] (Archimedes).
    entries = np.concatenate([M[:, 0, 2] / c for M, c in ((o.transforms, sizes(o)) for o in many)
                              for M, c in [(M[c > 0], c[c > 0])]])  # fmt: skip
    assert kstest((entries + 1) / 2, "uniform").pvalue > 1e-3


def test_a_seed_gives_one_instance():
    first, same, other = (instance(10, 2, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.landmarks, same.landmarks)
    assert not np.allclose(first.landmarks, other.landmarks)


@pytest.mark.parametrize("free_translation", [True, False])
def test_one_atom_seen_by_many_landmarks_always_comes_back(free_translation):
    for seed in range(20):
        assert error(instance(25, 1, seed), free_translation=free_translation) < 1e-5


@pytest.mark.parametrize("free_translation", [True, False])
def test_ten_atoms_seen_by_few_landmarks_never_come_back(free_translation):
    for seed in range(20):
        assert error(instance(10, 10, seed), free_translation=free_translation) > 0.1


def judge(planted, *, free_translation):
    """The error of the same program solved by Clarabel."""
    import cvxpy as cp

    M = [cp.Variable((2, 3)) for _ in planted.atoms]
    T = cp.Variable((2, 1)) if free_translation else np.zeros((2, 1))
    ones = np.ones((1, planted.landmarks.shape[1]))
    W = sum(m @ B for m, B in zip(M, planted.atoms, strict=True)) + T @ ones
    program = cp.Problem(cp.Minimize(sum(map(cp.sigma_max, M))), [planted.landmarks == W])
    program.solve(solver=cp.CLARABEL)
    found = np.stack([m.value for m in M])
    return np.linalg.norm(found - planted.transforms) / np.linalg.norm(planted.transforms)


@pytest.mark.slow
@pytest.mark.parametrize("free_translation", [True, False])
@pytest.mark.parametrize(("z", "recovered"), [(1, True), (3, False)])
def test_an_independent_solver_finds_the_same(z, recovered, free_translation):
    planted = instance(8, z, 8, k=12)  # of a single optimum, with T and without
    theirs = judge(planted, free_translation=free_translation)
    assert (theirs < 1e-3) == recovered
    assert error(planted, free_translation=free_translation) == pytest.approx(
        theirs, rel=1e-3, abs=1e-5
    )


def test_a_free_translation_is_centring():
    planted = instance(12, 4, 6)
    centred = Instance(
        planted.landmarks - planted.landmarks.mean(axis=1, keepdims=True),
        planted.atoms - planted.atoms.mean(axis=2, keepdims=True),
        planted.transforms,
    )
    free = error(planted, free_translation=True)
    assert free > 1e-3
    assert error(centred, free_translation=False) == pytest.approx(free, rel=1e-4)
    assert error(planted, free_translation=False) != pytest.approx(free, rel=1e-2)


def test_only_a_free_translation_forgives_a_shift():
    planted = instance(25, 2, 7)
    shifted = Instance(
        planted.landmarks + np.array([[3.0], [-1.0]]), planted.atoms, planted.transforms
    )
    assert error(shifted, free_translation=True) < 1e-5
    assert error(shifted, free_translation=False) > 0.1


def test_a_solver_that_is_stopped_says_so():
    attempt = recover(instance(40, 9, 8), free_translation=True, tolerance=1e-6, max_iterations=1)
    assert attempt.status is Status.ITERATION_LIMIT
    assert attempt.iterations == 1
    assert attempt.error > 1e-3
