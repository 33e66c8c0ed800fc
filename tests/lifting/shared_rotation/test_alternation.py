"""Alternation between coefficients and one rotation: it falls, ends where neither step
can gain, and finds what was planted.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.solver import Status
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.lifting.estimate import fit_translation
from shapefit.lifting.shared_rotation import alternate
from tests.points import draw_rotations, mix, norms, transpose

signs = pytest.mark.parametrize("signed", [False, True])


def nearby(rotation, angle=0.3):
    """Return one start (n, 1, 3, 3) for each image, an angle away."""
    (turn,) = rotation_about(np.array([1.0, -1.0, 0.5]), np.array([angle]))
    return (rotation @ turn)[:, None]


def rows_of(found):
    """Return Rbar (n, 2, 3), 0 where there is no rotation."""
    return np.nan_to_num(found.rotation[:, :2])


def weighted_residual(problem, found):
    """Return omega o (W - Rbar sum c_i B_i - T) (n, 2, p)."""
    projected = rows_of(found) @ mix(found.coefficients, problem.atoms)
    T = fit_translation(problem, projected).translation[..., None]
    return problem.weights[:, None] * (problem.landmarks - projected - T)


def objective_of(problem, found):
    loss = 0.5 * norms(weighted_residual(problem, found)) ** 2
    norm = np.abs(found.coefficients).sum(axis=1)
    return loss + problem.lam * norm


@signs
def test_the_objective_never_rises(make_scene, signed):
    """From one round to the next: what fewer rounds end with is never below what more
    end with.
    """
    scene = make_scene(n=12, k=20, noise=0.3)
    problem = scene.problem(0.1)
    starts = nearby(scene.rotation, 1.0)

    def objective_after(rounds):
        found = alternate(
            problem, starts, signed=signed, tolerance=0, max_rounds=rounds
        )
        return objective_of(problem, found)

    rounds = (1, 2, 3, 5, 9, 17, 33)
    objectives = np.stack([objective_after(count) for count in rounds])

    before, after = objectives[:-1], objectives[1:]
    assert (after <= before * (1 + 1e-13)).all()


@signs
class TestRest:
    """It ends where neither step can gain: with weights and a translation."""

    LAMBDA = 0.05

    @pytest.fixture
    def scene(self, make_scene):
        return make_scene(n=20, k=20, noise=0.2, weighted=True, hidden=0.2)

    @pytest.fixture
    def problem(self, scene):
        return scene.problem(self.LAMBDA)

    @pytest.fixture
    def found(self, scene, problem, signed):
        starts = nearby(scene.rotation)
        return alternate(
            problem, starts, signed=signed, tolerance=0.0, max_rounds=20_000
        )

    @pytest.fixture
    def pull(self, problem, found):
        """The slope of the loss along the landmarks that are fitted."""
        return problem.weights[:, None] * weighted_residual(problem, found)

    def test_the_translation_is_optimal(self, pull):
        assert np.abs(pull.sum(axis=2)).max() < 1e-12

    def test_coefficients_are_optimal_for_the_rotation(
        self, problem, found, pull, signed
    ):
        """KKT."""
        c = found.coefficients
        slope = np.einsum("nap,nab,kbp->nk", pull, rows_of(found), problem.atoms)
        largest = np.abs(slope) if signed else slope
        is_used = c != 0
        assert largest.max() < self.LAMBDA * (1 + 1e-5)
        assert_allclose(slope[is_used], self.LAMBDA * np.sign(c[is_used]), rtol=1e-5)

    def test_only_signed_coefficients_are_negative(self, found, signed):
        if not signed:
            assert (found.coefficients >= 0).all()

    def test_the_riemannian_gradient_in_the_rotation_vanishes(
        self, problem, found, pull
    ):
        shapes = mix(found.coefficients, problem.atoms)
        rows = rows_of(found)
        slope = -pull @ transpose(shapes)
        inner = rows @ transpose(slope)
        symmetric = 0.5 * (inner + transpose(inner))
        gradient = slope - symmetric @ rows
        largest = norms(shapes).max()
        assert np.abs(gradient).max() < 1e-9 * largest**2


@pytest.mark.parametrize("weighted", [False, True])
def test_planted_rotations_and_coefficients_come_back(make_scene, weighted):
    """As lambda goes to 0 the planted model is the minimum."""
    scene = make_scene(n=20, k=5, active=3, weighted=weighted, hidden=0.2)
    starts = nearby(scene.rotation, 0.1)

    found = alternate(scene.problem(1e-7), starts, tolerance=1e-12, max_rounds=5000)

    assert set(found.status) == {Status.CONVERGED}
    assert_allclose(found.coefficients, scene.coefficients, atol=1e-3)
    assert_allclose(found.rotation, scene.rotation, atol=1e-3)


class TestStarts:
    """Five random ones for each image."""

    @pytest.fixture
    def problem(self, make_scene):
        return make_scene(n=15, k=15, noise=0.3).problem(0.1)

    @pytest.fixture
    def starts(self, problem, rng):
        return np.stack([random_rotations(5, rng) for _ in range(15)])

    @pytest.fixture
    def alone(self, problem, starts):
        """What is found from each start by itself."""
        return [alternate(problem, starts[:, [start]]) for start in range(5)]

    def test_the_best_one_counts(self, problem, starts, alone):
        found = alternate(problem, starts)
        objectives = [objective_of(problem, each) for each in alone]
        least = np.min(objectives, axis=0)
        assert_allclose(objective_of(problem, found), least, rtol=1e-12)

    def test_rounds_of_all_are_counted(self, problem, starts, alone):
        found = alternate(problem, starts)
        expected = np.sum([each.rounds for each in alone], axis=0)
        assert_array_equal(found.rounds, expected)


@pytest.fixture
def scene(make_scene):
    return make_scene(n=4, noise=0.3)


def test_an_image_of_one_landmark_is_degenerate_and_the_others_converge(scene):
    scene.weights[2, 1:] = 0.0

    found = alternate(scene.problem(0.1), nearby(scene.rotation))

    status = list(found.status)
    assert status.pop(2) is Status.DEGENERATE
    assert {*status} == {Status.CONVERGED}
    assert np.isnan(found.rotation[2]).all()


def test_an_image_at_the_limit_of_rounds_says_so(scene):
    starts = nearby(scene.rotation)
    found = alternate(scene.problem(0.1), starts, tolerance=0.0, max_rounds=2)
    assert found.status[0] is Status.ITERATION_LIMIT
    assert found.rounds[0] == 2


def test_an_image_whose_atoms_underflow_is_a_failure(make_scene, rng):
    problem = make_scene(n=2).problem(0.2)
    tiny = replace(problem, atoms=1e-165 * problem.atoms, lam=1e-165 * problem.lam)
    starts = draw_rotations(2, 2, rng)

    found = alternate(tiny, starts)

    assert set(found.status) == {Status.NUMERICAL_FAILURE}
