"""Large shapes: images solved in the span of the atoms are solved, and certified as
they are.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex import span
from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solver import Status, solve_newton
from tests.convex.conftest import assert_certified
from tests.points import centred, transform, with_noise

P = 240
"""Landmarks of an image."""

K = 12
"""Atoms."""

N = 12
"""Images."""


def planted(rng, rank: int | None = None, masks: int = 1):
    """Noisy images of a few atoms each, of which so many sets of landmarks are seen."""
    atoms = rng.normal(size=(K, 3, P))
    if rank is not None:
        atoms = rows_of_rank(rng, 3 * K, rank).reshape(K, 3, P)
    atoms = centred(atoms)
    transforms = rng.normal(size=(N, K, 2, 3))
    transforms *= rng.random((N, K, 1, 1)) < 0.3
    landmarks = with_noise(transform(transforms, atoms), 0.3, rng) + 7.0
    weights = rng.choice([0.0, 0.5, 1.0], p=[0.2, 0.2, 0.6], size=(masks, P))
    mask = np.arange(N) % masks
    return build_problem(landmarks, atoms, 5.0, weights=weights[mask])


def rows_of_rank(rng, count, rank):
    """Draw rows (count, P) that span so many dimensions."""
    return rng.normal(size=(count, rank)) @ rng.normal(size=(rank, P))


@pytest.mark.parametrize(("rank", "masks"), [(None, 1), (None, 3), (9, 1)])
def test_images_of_one_mask_are_reduced_together(rng, rank, masks):
    problem = planted(rng, rank, masks)

    rows = span.find_span(problem)
    parts = list(span.reduce_images(problem, rows))

    dimensions = rank or 3 * K
    with_the_translation = dimensions + 1
    assert len(parts) == masks
    assert {part.basis.shape[1] for part in parts} == {with_the_translation}


@pytest.mark.parametrize(("rank", "masks"), [(None, 1), (None, 3), (9, 1)])
def test_the_optimum_is_that_of_all_landmarks(rng, monkeypatch, rank, masks):
    problem = planted(rng, rank, masks)
    found = solve_newton(problem, tolerance=1e-8)

    monkeypatch.setattr(span, "MIN_LANDMARKS_OF_A_SPAN", P + 1)
    whole = solve_newton(problem, tolerance=1e-8)

    assert set(found.status) == {Status.OPTIMAL}
    assert_allclose(found.objective, whole.objective, rtol=2e-8)
    assert_allclose(found.translation, whole.translation, atol=1e-3)
    assert_allclose(found.dual, whole.dual, atol=1e-2)
    assert_certified(problem, found, 1e-8)


def test_a_squared_loss_has_a_span_and_a_robust_one_has_none(rng):
    problem = planted(rng)
    robust = replace(problem, loss=Loss.SPARSE_ERROR)

    assert span.find_span(problem) is not None
    assert span.find_span(robust) is None


def test_no_images_have_no_span(rng):
    nothing = planted(rng).take(np.arange(0))
    assert span.find_span(nothing) is None


def test_images_with_a_mask_each_are_not_reduced(rng):
    """A basis for each image would cost more than it saves."""
    problem = planted(rng)
    rows = span.find_span(problem)
    each_its_own = replace(problem, weights=rng.random((N, P)))

    (part,) = span.reduce_images(each_its_own, rows)
    solution = solve_newton(each_its_own)

    assert part.basis is None
    assert set(solution.status) == {Status.OPTIMAL}


@pytest.mark.parametrize("rank", [3, 63, 64, 65, 150, 178])
def test_many_atoms_of_a_low_rank_are_reduced_to_it(rng, rank):
    """k = 100 atoms have 300 rows, more than the 240 landmarks."""
    rows = rows_of_rank(rng, 300, rank)

    basis = span.find_row_space(rows, 179)

    assert basis.shape == (P, rank)
    assert_allclose(basis.T @ basis, np.eye(rank), atol=1e-12)
    assert_allclose(rows @ basis @ basis.T, rows, atol=1e-10)


@pytest.mark.parametrize(("count", "rank"), [(300, 240), (300, 180), (150, 150)])
def test_no_span_is_returned_that_is_no_smaller(rng, count, rank):
    rows = rows_of_rank(rng, count, rank)
    assert span.find_row_space(rows, rank - 1) is None


def test_a_row_that_is_small_is_not_lost(rng):
    rows = rows_of_rank(rng, 300, 20)
    rows[7] = with_noise(rows[7], 1e-7, rng)

    basis = span.find_row_space(rows, 100)

    assert basis.shape == (P, 21)
    assert_allclose(rows @ basis @ basis.T, rows, atol=1e-11)


@pytest.mark.parametrize("size", [1e-160, 1e160])
def test_the_span_does_not_depend_on_the_size_of_atoms(rng, size):
    rows = rows_of_rank(rng, 300, 20)
    basis = span.find_row_space(size * rows, 100)
    assert basis.shape == (P, 20)


@pytest.mark.parametrize("size", [1e-8, 1.0, 1e8])
def test_independence_does_not_depend_on_the_size_of_rows(rng, size):
    independent = size * rng.normal(size=(20, P))
    one_too_many = size * rows_of_rank(rng, 20, 19)
    assert span.are_independent(independent)
    assert not span.are_independent(one_too_many)


def test_a_basis_reduces_what_is_weighted_and_centred(rng):
    """Nothing of the atoms is lost, and nothing of the translation is left."""
    rows = rng.normal(size=(9, P))
    weights = rng.choice([0.0, 0.5, 1.0], size=P)

    basis = span.find_basis(span.orthonormalise(rows), weights)

    share = weights**2 / (weights**2).sum()
    seen = weights * (rows - (rows @ share)[:, None])
    assert basis.shape == (P, 10)
    assert_allclose(basis.T @ basis, np.eye(10) - 0.1, atol=1e-12)
    assert_allclose(seen @ basis @ basis.T, seen, atol=1e-10)
    assert_allclose(weights @ basis, 0, atol=1e-12)


def test_atoms_that_are_zero_span_nothing():
    basis = span.find_row_space(np.zeros((300, P)), 100)
    assert basis.shape == (P, 0)


def test_no_bit_depends_on_how_images_are_batched(rng):
    """Images of one mask, then of three, then one image again and again."""
    one = planted(rng, masks=1)
    other = planted(rng, masks=3)
    one_mask_rows = np.zeros(64, int)
    three_masks_rows = np.r_[np.arange(64) % N, np.ones(30, int)]
    weights = np.r_[one.weights[one_mask_rows], other.weights[three_masks_rows]]
    landmarks = np.r_[one.landmarks[one_mask_rows], other.landmarks[three_masks_rows]]
    problem = build_problem(landmarks, one.atoms, 5.0, weights=weights)

    whole = solve_newton(problem)
    batches = np.split(np.arange(158), [64, 128])
    parts = [solve_newton(problem.take(batch)) for batch in batches]

    for name in ("objective", "dual", "iterations"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        assert_array_equal(getattr(whole, name), joined)
