"""Rounds over shapes in batches: the same as in memory, falling, planted atoms, dead atoms."""

import numpy as np
import pytest

from shapefit.dictionary import batches as batches_module
from shapefit.dictionary.batches import Coded, code_all, improve, worst_of_all
from shapefit.dictionary.coding import objectives, sparse_code
from shapefit.dictionary.learning import evenly, learn, of_norm_one, replace_dead_atoms
from shapefit.geometry.normalisation import normalise

BETA = 0.1


@pytest.fixture
def shapes(rng):
    """Noisy mixtures of five forms, centred, of the size of normalised shapes."""
    forms = rng.standard_normal((5, 3, 6))
    mixed = np.tensordot(rng.random((300, 5)) ** 3, forms, axes=1)
    return normalise(mixed + 0.1 * rng.standard_normal(mixed.shape)).points


def total(shapes, atoms, beta=BETA):
    return objectives(shapes, atoms, beta, sparse_code(shapes, atoms, beta)).sum()


def last(rounds):
    *_, state = rounds
    return state


@pytest.mark.parametrize("number", [1, 4, 29])
@pytest.mark.parametrize(("k", "beta"), [(1, 0.1), (8, 0.01), (8, 1.0), (30, 0.1)])
def test_no_half_step_raises_the_objective(shapes, number, k, beta):
    start = of_norm_one(shapes[evenly(300, k)])
    state = last(improve(np.array_split(shapes, number), start, beta, iterations=10))
    assert (np.diff(state.trace) <= 1e-12 * state.trace[0]).all()


def test_the_trace_is_the_objective_of_all_shapes(shapes):
    batches, start = np.array_split(shapes, 7), of_norm_one(shapes[:8])
    states = list(improve(batches, start, BETA, iterations=3))
    assert states[0].trace[0] == pytest.approx(total(shapes, start), rel=1e-12)
    for state in states:
        assert state.trace[-1] == pytest.approx(total(shapes, state.atoms), rel=1e-12)
    assert [len(state.trace) for state in states] == [3, 5, 7]


def test_rounds_are_those_of_learning_in_memory(shapes):
    start = of_norm_one(shapes[evenly(300, 8)])
    batches = np.array_split(shapes, 7)
    in_memory = list(learn(shapes, 8, BETA, iterations=4))
    for state, expected in zip(improve(batches, start, BETA, iterations=4), in_memory, strict=True):
        np.testing.assert_allclose(state.atoms, expected.atoms, atol=1e-9)
        np.testing.assert_allclose(state.trace, expected.trace, rtol=1e-12)


def test_equal_batches_give_equal_bits(shapes):
    first, second = (
        last(improve(np.array_split(shapes, 7), of_norm_one(shapes[:8]), BETA, iterations=3))
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.atoms, second.atoms)
    np.testing.assert_array_equal(first.trace, second.trace)


def test_finds_the_atoms_that_made_the_shapes(rng, monkeypatch):
    # 2 of 6 atoms a shape. Evenly spaced pure shapes start it near each atom.
    monkeypatch.setattr(batches_module, "SETTLED", 0.0)
    atoms = of_norm_one(rng.standard_normal((6, 3, 8)))
    C = np.zeros((600, 6))
    for row in C:
        row[rng.choice(6, 2, replace=False)] = rng.uniform(2, 6, 2)
    C[evenly(600, 6)] = 0.3 + 4.7 * np.eye(6)
    shapes = np.tensordot(C, atoms, axes=1)
    start = of_norm_one(shapes[evenly(600, 6)])

    def apart(found):
        return 1 - np.diag(np.tensordot(found, atoms, axes=([1, 2], [1, 2])))

    assert apart(start).min() > 1e-3
    found = last(improve(np.array_split(shapes, 20), start, 1e-3, iterations=300))
    assert apart(found.atoms).max() < 1e-4


class TestEnd:
    def test_at_the_rounds_that_it_is_given(self, shapes):
        start = of_norm_one(shapes[:8])
        assert len(list(improve([shapes], start, BETA, iterations=2))) == 2

    def test_where_the_objective_hardly_falls(self, shapes):
        state = last(improve([shapes], of_norm_one(shapes[:8]), BETA, iterations=500))
        rounds = state.trace[2::2] / state.trace[:-2:2]
        assert (rounds[:-1] <= 0.999).all()
        assert rounds[-1] > 0.999

    def test_where_nothing_can_fall(self, shapes):
        # Beyond every overlap all coefficients are 0 and no step can change that.
        assert len(list(improve([shapes], of_norm_one(shapes[:8]), 100.0, iterations=50))) == 1


class TestDeadAtoms:
    def test_one_round_brings_them_to_life(self, shapes):
        start = np.repeat(of_norm_one(shapes[:1]), 8, axis=0)
        batches = np.array_split(shapes, 7)
        (before,) = code_all(batches, [start], BETA)
        assert (np.diag(before.products.overlaps) > 0).sum() == 1
        state = next(improve(batches, start, BETA, iterations=1))
        assert (sparse_code(shapes, state.atoms, BETA).max(axis=0) > 0).all()
        assert (np.diff(state.trace) < 0).all()

    def test_one_batch_gives_the_shapes_of_learning_in_memory(self, shapes):
        start = of_norm_one(shapes[:3])
        C = sparse_code(shapes, start, BETA)
        unused = np.concatenate([start, start[:2]])
        none = np.concatenate([C, np.zeros((300, 2))], axis=1)
        expected = replace_dead_atoms(shapes, none, unused)[3:]
        np.testing.assert_allclose(worst_of_all([shapes], start, BETA, 2), expected, atol=1e-12)

    @pytest.mark.parametrize("place", [0, 150, 299])
    def test_the_worst_of_all_batches_comes_first(self, shapes, place):
        odd = shapes.copy()
        odd[place] *= 5
        found = worst_of_all(np.array_split(odd, 7), of_norm_one(shapes[10:12]), BETA, 2)
        np.testing.assert_allclose(found[0], of_norm_one(odd[place]))


def test_sums_give_the_objective_of_any_atoms(shapes, rng):
    (coded,) = code_all(np.array_split(shapes, 3), [of_norm_one(shapes[:4])], BETA)
    C = sparse_code(shapes, of_norm_one(shapes[:4]), BETA)
    other = rng.standard_normal((4, 3, 6))
    assert isinstance(coded, Coded)
    expected = objectives(shapes, other, BETA, C).sum()
    assert coded.objective(other, BETA) == pytest.approx(expected, rel=1e-12)
