"""The table of methods: what each promises beside the others, on made and on real
images.
"""

from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.problem import Loss
from shapefit.convex.solver import Status, solve_newton
from shapefit.convex.transforms import Transforms
from shapefit.lifting.lift import Program, lift
from tests.lifting.estimators import make_estimator
from tests.points import mix, norms, transform

RIGID = ("convex+refine", "alternate")
"""Methods whose images have one rotation for all atoms."""

NAMES = ("convex", *RIGID, "mean-shape")
"""Matching pursuit has bases and tests of its own: test_matching_pursuit.py."""


@pytest.fixture
def scene(make_scene):
    return make_scene(n=25, k=15, noise=0.3, weighted=True, hidden=0.15)


@pytest.fixture
def estimator_of(scene):
    """Return the function that makes the estimator of a method, with options."""

    def estimator_of(name, **options):
        settings = {
            "solve": partial(solve_newton, tolerance=1e-7),
            "mean_shape": scene.mean_shape,
        }
        return make_estimator(name, **settings | options)

    return estimator_of


def residual_of(found, problem):
    """Return what an estimate leaves of the landmarks (n, 2, p), unweighted."""
    fitted = found.shapes[:, :2] + found.translation[..., None]
    return problem.landmarks - fitted


@pytest.mark.parametrize("name", RIGID)
@pytest.mark.parametrize("signed", [False, True])
class TestOneRotation:
    """An estimate of one rotation agrees with itself: all follows from c, R and T."""

    LAMBDA = 0.1

    @pytest.fixture
    def problem(self, scene):
        return scene.problem(self.LAMBDA)

    @pytest.fixture
    def found(self, name, signed, problem, estimator_of):
        return estimator_of(name, signed=signed)(problem)

    def test_shapes(self, found, problem):
        expected = found.rotation @ mix(found.coefficients, problem.atoms)
        assert_allclose(found.shapes, expected, atol=1e-12)

    def test_transforms(self, found, problem):
        landmarks = transform(found.transforms.dense(), problem.atoms)
        assert_allclose(landmarks, found.shapes[:, :2], atol=1e-12)

    def test_active_atoms(self, found):
        is_active = np.abs(found.coefficients) > 1e-6
        assert_array_equal(found.active_atoms, is_active.sum(axis=1))

    def test_objective(self, found, problem):
        residual = problem.weights[:, None] * residual_of(found, problem)
        loss = 0.5 * norms(residual) ** 2
        norm = np.abs(found.coefficients).sum(axis=1)
        assert_allclose(found.objective, loss + self.LAMBDA * norm, rtol=1e-12)

    def test_only_signed_coefficients_are_negative(self, found, signed):
        assert (found.coefficients < 0).any() == signed


@pytest.mark.parametrize("signed", [False, True])
def test_refinement_is_bounded_by_the_convex_program(scene, estimator_of, signed):
    problem = scene.problem(0.1)
    convex = estimator_of("convex")(problem)

    found = estimator_of("convex+refine", signed=signed)(problem)

    bound = found.objective * (1 - found.relative_gap)
    bound_of_convex = convex.objective * (1 - convex.relative_gap)
    assert (found.relative_gap >= -1e-12).all()
    assert found.relative_gap.max() > 1e-3
    assert_allclose(bound, bound_of_convex, rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_a_hidden_image_is_degenerate(name, scene, estimator_of):
    scene.weights[4] = 0.0
    found = estimator_of(name)(scene.problem(0.1))
    assert found.status[4] is Status.DEGENERATE


@pytest.mark.parametrize("name", [name for name in NAMES if name != "mean-shape"])
def test_a_large_lambda_leaves_no_atom(name, scene, estimator_of):
    found = estimator_of(name)(scene.problem(1e4))
    assert_array_equal(found.coefficients, 0.0)
    assert_array_equal(found.shapes, 0.0)
    assert np.isnan(found.rotation).all()
    assert not found.transforms.count.any()


@pytest.mark.parametrize("name", NAMES)
def test_images_without_atoms_are_lifted_beside_a_hidden_one(name, scene, estimator_of):
    scene.weights[4] = 0.0
    program = Program(1e4)

    lifting = lift(
        scene.landmarks, scene.weights, scene.atoms, program, estimator_of(name)
    )

    others = np.delete(lifting.shapes, 4, axis=0)
    assert lifting.failures == {4: "all landmarks are hidden"}
    assert np.isnan(lifting.shapes[4]).all()
    assert np.isfinite(others).all()


class TestImagesWithoutAnAtom:
    """They alone begin again: transforms of some have the wrong sign, one image is
    hidden, and one lets no atom in at all.
    """

    WRONG = np.array([2, 11, 20])
    WITHOUT_ATOMS = 4
    HIDDEN = 7

    @pytest.fixture
    def problem(self, scene):
        scene.weights[self.HIDDEN] = 0.0
        lam = np.full(25, 0.05)
        lam[self.WITHOUT_ATOMS] = 1e4
        return replace(scene.problem(0.05), lam=lam)

    def solve_wrongly(self, problem):
        solution = solve_newton(problem)
        transforms = solution.transforms.dense()
        transforms[self.WRONG] *= -1
        return solution._replace(transforms=Transforms.of(transforms))

    @pytest.fixture
    def refined(self, problem, estimator_of):
        return estimator_of("convex+refine", solve=self.solve_wrongly)(problem)

    def test_the_others_are_as_they_were(self, problem, estimator_of, refined):
        others = np.setdiff1d(np.arange(25), [*self.WRONG, self.WITHOUT_ATOMS])
        plain = estimator_of("convex+refine", solve=solve_newton)(problem)
        for field in fields(refined):
            found = getattr(refined, field.name)
            expected = getattr(plain, field.name)
            if isinstance(found, np.ndarray):
                assert_array_equal(found[others], expected[others], field.name)

    def test_all_but_the_hidden_one_converge(self, refined):
        status = list(refined.status)
        assert status.pop(self.HIDDEN) is Status.DEGENERATE
        assert {*status} == {Status.CONVERGED}

    def test_those_that_let_no_atom_in_stay_without(self, refined):
        without = [self.WITHOUT_ATOMS, self.HIDDEN]
        assert not refined.coefficients[without].any()

    def test_those_with_the_wrong_sign_are_as_from_the_mean_shape(
        self, problem, estimator_of, refined
    ):
        wrong = self.WRONG
        alone = estimator_of("alternate")(problem.take(wrong))
        assert refined.coefficients[wrong].any(axis=1).all()
        assert_allclose(refined.coefficients[wrong], alone.coefficients, atol=1e-9)
        assert_allclose(refined.shapes[wrong], alone.shapes, atol=1e-9)
        assert_allclose(refined.residual[wrong], alone.residual, rtol=1e-9)
        assert (refined.iterations[wrong] > alone.iterations).all()


@pytest.mark.parametrize("loss", [Loss.ABSOLUTE, Loss.SPARSE_ERROR])
def test_outliers_are_the_landmarks_whose_weighted_residual_exceeds_beta(
    loss, scene, estimator_of
):
    problem = replace(scene.problem(1.0), loss=loss, beta=0.1)

    found = estimator_of("convex")(problem)

    residual = np.abs(residual_of(found, problem))
    weighted = problem.weights[:, None] * residual
    is_beyond = (weighted > 0.1).any(axis=1)
    is_beyond_unweighted = (residual > 0.1).any(axis=1)
    assert_array_equal(found.outliers, is_beyond)
    assert (is_beyond != is_beyond_unweighted).any()
    assert 0.05 < is_beyond.mean() < 0.95


@pytest.mark.parametrize("loss", [Loss.SQUARED, Loss.ABSOLUTE])
def test_a_failure_of_the_convex_solver_is_not_forgotten(loss, scene, estimator_of):
    """One image fails; another is at the limit of iterations, and is refined."""

    def solve(problem):
        solution = solve_newton(problem, tolerance=1e-7)
        status = list(solution.status)
        status[3] = Status.NUMERICAL_FAILURE
        status[5] = Status.ITERATION_LIMIT
        return solution._replace(status=tuple(status))

    problem = replace(scene.problem(0.1), loss=loss)

    found = estimator_of("convex+refine", solve=solve)(problem)

    status = list(found.status)
    assert status.pop(3) is Status.NUMERICAL_FAILURE
    assert {*status} == {Status.CONVERGED}
