"""Learning: a falling objective, planted atoms, dead atoms, symmetries, the real figure."""

import itertools

import numpy as np
import pytest

from shapefit.dictionary import learning
from shapefit.dictionary.coding import duality_gaps, objectives, sparse_code
from shapefit.dictionary.learning import learn, replace_dead_atoms
from shapefit.dictionary.summary import summarise
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import generalised_procrustes
from shapefit.geometry.rotations import random_rotations

BETA = 0.1


def last(rounds):
    *_, state = rounds
    return state


def summary(shapes, state, beta=BETA):
    parts = [(shapes, state.coefficients, np.ones(len(shapes)))]
    return summarise(parts, state.atoms, beta)


def norms(shapes):
    return np.linalg.norm(shapes, axis=(-2, -1))


@pytest.fixture
def shapes(rng):
    """Noisy mixtures of five forms, centred, of the size of normalised shapes."""
    forms = rng.standard_normal((5, 3, 6))
    mixed = np.tensordot(rng.random((80, 5)) ** 3, forms, axes=1)
    return normalise(mixed + 0.1 * rng.standard_normal(mixed.shape)).points


class TestDescent:
    @pytest.mark.parametrize(("k", "beta"), [(1, 0.1), (8, 0.01), (8, 1.0), (30, 0.1), (80, 0.1)])
    def test_no_half_step_raises_the_objective(self, shapes, k, beta):
        state = last(learn(shapes, k, beta, iterations=30))
        assert (np.diff(state.trace) <= 1e-13 * state.trace[0]).all()

    def test_the_trace_holds_every_half_step(self, shapes):
        states = list(learn(shapes, 8, BETA, iterations=4))
        assert [len(state.trace) for state in states] == [3, 5, 7, 9]
        for earlier, later in itertools.pairwise(states):
            np.testing.assert_array_equal(later.trace[: len(earlier.trace)], earlier.trace)
        for state in states:
            total = objectives(shapes, state.atoms, BETA, state.coefficients).sum()
            assert state.trace[-1] == pytest.approx(total, rel=1e-14)
        assert states[-1].trace[-1] < 0.8 * states[0].trace[0]

    def test_the_trace_starts_at_evenly_spaced_shapes(self, shapes):
        state = next(learn(shapes, 5, BETA, iterations=1))
        start = shapes[[0, 20, 40, 59, 79]]
        start = start / norms(start)[:, None, None]
        first = objectives(shapes, start, BETA, sparse_code(shapes, start, BETA)).sum()
        assert state.trace[0] == pytest.approx(first, rel=1e-14)

    def test_coefficients_are_optimal_for_the_atoms(self, shapes):
        state = last(learn(shapes, 8, BETA, iterations=5))
        gaps = duality_gaps(shapes, state.atoms, BETA, state.coefficients)
        assert (gaps <= 1e-9).all()

    def test_runs_every_round_it_is_given(self, shapes):
        assert len(list(learn(shapes, 8, BETA, iterations=7))) == 7

    def test_ends_where_nothing_falls_any_more(self, shapes):
        # Beyond every overlap all coefficients are 0 and no step can change that.
        assert len(list(learn(shapes, 8, 100.0, iterations=50))) == 1


def test_atoms_have_norm_1_at_most(shapes):
    state = last(learn(shapes, 8, BETA, iterations=5))
    assert norms(state.atoms).max() == pytest.approx(1, rel=1e-12)


class TestPlanted:
    def test_finds_the_atoms_that_made_the_shapes(self, rng):
        # 2 of 6 atoms a shape. Evenly spaced pure shapes start it near each atom.
        atoms = rng.standard_normal((6, 3, 8))
        atoms -= atoms.mean(axis=-1, keepdims=True)
        atoms /= norms(atoms)[:, None, None]
        C = np.zeros((600, 6))
        for row in C:
            row[rng.choice(6, 2, replace=False)] = rng.uniform(2, 6, 2)
        for i, j in enumerate(np.linspace(0, 599, 6).round().astype(int)):
            C[j] = 0.3
            C[j, i] = 5
        shapes = np.tensordot(C, atoms, axes=1)
        state = last(learn(shapes, 6, 1e-3, iterations=300))
        overlap = np.tensordot(state.atoms, atoms, axes=([1, 2], [1, 2]))
        np.testing.assert_allclose(np.diag(overlap), 1, atol=1e-4)
        np.testing.assert_allclose(state.coefficients, C, atol=0.05)
        assert summary(shapes, state).relative_error < 1e-3

    def test_one_atom_is_the_leading_direction(self, shapes):
        # Without beta and with all overlaps positive, one atom is the first singular vector.
        similar = shapes[0] + 0.2 * shapes
        state = last(learn(similar, 1, 0.0, iterations=200))
        first = np.linalg.svd(similar.reshape(80, -1))[2][0].reshape(3, 6)
        overlap = (state.atoms[0] * first).sum()
        assert abs(overlap) == pytest.approx(1, abs=1e-10)


class TestSymmetry:
    def test_atoms_turn_with_the_shapes(self, shapes, rng):
        R = random_rotations(1, rng)[0]
        before, after = (last(learn(s, 8, BETA, iterations=5)) for s in (shapes, R @ shapes))
        np.testing.assert_allclose(after.atoms, R @ before.atoms, atol=1e-9)
        np.testing.assert_allclose(after.coefficients, before.coefficients, atol=1e-8)

    def test_atoms_follow_the_order_of_the_landmarks(self, shapes, rng):
        order = rng.permutation(6)
        before, after = (
            last(learn(s, 8, BETA, iterations=5)) for s in (shapes, shapes[..., order])
        )
        np.testing.assert_allclose(after.atoms, before.atoms[..., order], atol=1e-9)

    def test_centred_shapes_give_centred_atoms(self, shapes):
        state = last(learn(shapes, 8, BETA, iterations=10))
        np.testing.assert_allclose(state.atoms.mean(axis=-1), 0, atol=1e-13)

    def test_the_same_shapes_give_the_same_atoms(self, shapes):
        first, second = (last(learn(shapes, 8, BETA, iterations=5)) for _ in range(2))
        np.testing.assert_array_equal(first.atoms, second.atoms)
        np.testing.assert_array_equal(first.coefficients, second.coefficients)


class TestDeadAtoms:
    def test_the_worst_shape_takes_the_place(self, shapes):
        atoms = shapes[:3] / norms(shapes[:3])[:, None, None]
        C = np.zeros((80, 3))
        C[:, [0, 2]] = sparse_code(shapes, atoms[[0, 2]], BETA)
        replaced = replace_dead_atoms(shapes, C, atoms)
        worst = norms(shapes - np.tensordot(C, atoms, axes=1)).argmax()
        np.testing.assert_allclose(replaced[1], shapes[worst] / norms(shapes[worst]))
        np.testing.assert_array_equal(replaced[[0, 2]], atoms[[0, 2]])
        after = objectives(shapes, replaced, BETA, C)
        np.testing.assert_array_equal(after, objectives(shapes, atoms, BETA, C))

    def test_two_dead_atoms_do_not_become_neighbours(self, rng):
        # The two worst shapes are nearly one; the second dead atom gets the other odd shape.
        common, odd, other = rng.standard_normal((3, 3, 5))
        shapes = np.array([common, common, 9 * odd, 9 * odd + 1e-3 * other, 5 * other])
        atoms = np.array([common, odd, odd])
        C = np.zeros((5, 3))
        C[:2, 0] = 1
        replaced = replace_dead_atoms(shapes, C, atoms)
        np.testing.assert_allclose(replaced[1], odd / norms(odd), atol=1e-3)
        np.testing.assert_allclose(replaced[2], other / norms(other))

    def test_an_atom_takes_up_nothing_of_shapes_that_point_away_from_it(self, rng):
        # Coefficients are not negative: the mirrored shape stays as bad as it was, and is next.
        shape, other = rng.standard_normal((2, 3, 5))
        other *= 0.5 * norms(shape) / norms(other)
        shapes, atoms = np.array([shape, -0.9 * shape, other]), np.ones((2, 3, 5))
        replaced = replace_dead_atoms(shapes, np.zeros((3, 2)), atoms)
        unit = shape / norms(shape)
        np.testing.assert_allclose(replaced, [unit, -unit], atol=1e-15)

    def test_atoms_in_use_stay(self, shapes):
        C = np.ones((80, 3))
        np.testing.assert_array_equal(replace_dead_atoms(shapes, C, shapes[:3]), shapes[:3])

    def test_one_round_brings_them_to_life(self, shapes):
        # All 8 shapes that learning starts from are the same one.
        shapes[np.linspace(0, 79, 8).round().astype(int)] = shapes[0]
        start = np.repeat(shapes[:1] / norms(shapes[0]), 8, axis=0)
        first = sparse_code(shapes, start, BETA)
        assert (first.max(axis=0) == 0).sum() == 7
        state = next(learn(shapes, 8, BETA, iterations=1))
        assert summary(shapes, state).dead_atoms == 0
        assert (np.diff(state.trace) < 0).all()


@pytest.mark.parametrize("k", [0, 81])
def test_more_atoms_than_shapes_are_refused(shapes, k):
    with pytest.raises(ValueError, match="k must be"):
        next(learn(shapes, k, BETA, iterations=1))


def test_reaching_beyond_the_update_pays(shapes, monkeypatch):
    overrelaxed = last(learn(shapes, 8, BETA, iterations=10))
    monkeypatch.setattr(learning, "REACH", 0.0)
    plain = last(learn(shapes, 8, BETA, iterations=10))
    assert overrelaxed.trace[-1] < plain.trace[-1]


def test_a_reach_that_does_not_pay_falls_back_on_the_update(shapes, monkeypatch):
    monkeypatch.setattr(learning, "REACH", 0.0)
    plain = last(learn(shapes, 8, BETA, iterations=1))
    monkeypatch.setattr(learning, "REACH", 1e6)
    fallen_back = last(learn(shapes, 8, BETA, iterations=1))
    np.testing.assert_array_equal(fallen_back.atoms, plain.atoms)


@pytest.mark.real_data
def test_motion_capture_is_reconstructed_with_few_atoms(real_data):
    """k = 64, beta = 0.1, 15 rounds: at most 3% relative error with at most 14 active atoms."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(real_data / "mocap" / "subject86_24fps.h5") as file:
        shapes = file["shapes"][::3].swapaxes(1, 2).astype(float)
    assert len(shapes) == 3356
    shapes = generalised_procrustes(normalise(shapes).points).shapes
    state = last(learn(shapes, 64, 0.1, iterations=15))
    found = summary(shapes, state)
    assert found.relative_error <= 0.030
    assert found.active_atoms <= 14
    assert found.dead_atoms == 0
    assert (np.diff(state.trace) < 0).all()
    objective = objectives(shapes, state.atoms, 0.1, state.coefficients)
    gaps = duality_gaps(shapes, state.atoms, 0.1, state.coefficients)
    assert (gaps <= 1e-10 * objective).all()
