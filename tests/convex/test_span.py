"""Large shapes: images solved in the span of the atoms are solved, and certified as
they are.
"""

from dataclasses import replace

import numpy as np
import pytest

from shapefit.convex import span
from shapefit.convex.problem import Loss, build_problem
from shapefit.convex.solver import Status, solve_newton
from tests.convex.conftest import assert_certified

P, K, N = 240, 12, 12


def planted(rng, rank: int | None = None, masks: int = 1):
    """Noisy images of a few atoms each, of which so many sets of landmarks are seen."""
    atoms = rng.normal(size=(K, 3, P))
    if rank is not None:
        atoms = (rng.normal(size=(3 * K, rank)) @ rng.normal(size=(rank, P))).reshape(
            K, 3, P
        )
    atoms -= atoms.mean(axis=2, keepdims=True)
    blocks = rng.normal(size=(N, K, 2, 3)) * (rng.random((N, K, 1, 1)) < 0.3)
    w = np.einsum("nkab,kbp->nap", blocks, atoms) + 0.3 * rng.normal(size=(N, 2, P))
    weights = rng.choice([0.0, 0.5, 1.0], p=[0.2, 0.2, 0.6], size=(masks, P))
    return build_problem(w + 7.0, atoms, 5.0, weights=weights[np.arange(N) % masks])


@pytest.mark.parametrize(("rank", "masks"), [(None, 1), (None, 3), (9, 1)])
def test_the_optimum_is_that_of_all_landmarks(rng, monkeypatch, rank, masks):
    problem = planted(rng, rank, masks)
    found = solve_newton(problem, tolerance=1e-8)
    rows = span.find_span(problem)
    assert rows is not None
    parts = list(span.reduce_images(problem, rows))
    assert len(parts) == masks
    assert {part.basis.shape[1] for part in parts} == {(rank or 3 * K) + 1}
    monkeypatch.setattr(span, "MIN_LANDMARKS_OF_A_SPAN", P + 1)
    whole = solve_newton(problem, tolerance=1e-8)
    assert set(found.status) == {Status.OPTIMAL}
    np.testing.assert_allclose(found.objective, whole.objective, rtol=2e-8)
    np.testing.assert_allclose(found.translation, whole.translation, atol=1e-3)
    np.testing.assert_allclose(found.dual, whole.dual, atol=1e-2)
    assert_certified(problem, found, 1e-8)


def test_only_what_is_exact_and_pays(rng):
    problem = planted(rng)
    rows = span.find_span(problem)
    assert rows is not None
    assert span.find_span(replace(problem, loss=Loss.SPARSE_ERROR)) is None
    each_its_own = replace(problem, weights=rng.random((N, P)))
    (part,) = span.reduce_images(each_its_own, rows)
    assert part.basis is None
    assert set(solve_newton(each_its_own).status) == {Status.OPTIMAL}
    assert span.find_span(problem.take(np.arange(0))) is None


@pytest.mark.parametrize("rank", [3, 63, 64, 65, 150, 178])
def test_many_atoms_of_a_low_rank_are_reduced_to_it(rng, rank):
    """k = 100 atoms have 300 rows, more than the 240 landmarks."""
    rows = rng.normal(size=(300, rank)) @ rng.normal(size=(rank, P))
    found = span.find_row_space(rows, 179)
    assert found.shape == (P, rank)
    np.testing.assert_allclose(found.T @ found, np.eye(rank), atol=1e-12)
    np.testing.assert_allclose(rows @ found @ found.T, rows, atol=1e-10)


@pytest.mark.parametrize(("count", "rank"), [(300, 240), (300, 180), (150, 150)])
def test_no_span_is_returned_that_is_no_smaller(rng, count, rank):
    rows = rng.normal(size=(count, rank)) @ rng.normal(size=(rank, P))
    assert span.find_row_space(rows, rank - 1) is None


def test_a_row_that_is_small_is_not_lost(rng):
    rows = rng.normal(size=(300, 20)) @ rng.normal(size=(20, P))
    rows[7] += 1e-7 * rng.normal(size=P)
    found = span.find_row_space(rows, 100)
    assert found.shape == (P, 21)
    np.testing.assert_allclose(rows @ found @ found.T, rows, atol=1e-11)


@pytest.mark.parametrize("size", [1e-160, 1e160])
def test_the_span_does_not_depend_on_the_size_of_atoms(rng, size):
    rows = rng.normal(size=(300, 20)) @ rng.normal(size=(20, P))
    assert span.find_row_space(size * rows, 100).shape == (P, 20)


def test_atoms_that_are_zero_span_nothing():
    assert span.find_row_space(np.zeros((300, P)), 100).shape == (P, 0)


def test_no_bit_depends_on_how_images_are_batched(rng):
    one, other = planted(rng, masks=1), planted(rng, masks=3)
    rows = np.r_[np.zeros(64, int), np.arange(64) % N, np.ones(30, int)]
    atoms, weights = one.atoms, np.r_[one.weights[rows[:64]], other.weights[rows[64:]]]
    w = np.r_[one.landmarks[rows[:64]], other.landmarks[rows[64:]]]
    many = build_problem(w, atoms, 5.0, weights=weights)
    whole = solve_newton(many)
    parts = [
        solve_newton(many.take(np.arange(*ends)))
        for ends in ((0, 64), (64, 128), (128, 158))
    ]
    for name in ("objective", "dual", "iterations"):
        apart = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(getattr(whole, name), apart)
