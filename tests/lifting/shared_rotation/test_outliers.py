"""Refinement without the outliers that a robust convex program labels."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from shapefit.convex.problem import Loss
from shapefit.convex.solver import Status, solve_newton
from shapefit.lifting.lift import Program, lift
from tests.lifting.estimators import make_estimator


@pytest.fixture
def scene(make_scene):
    return make_scene(n=20, k=6, p=40, active=2)


@pytest.fixture
def estimator_of(scene):
    """Return the function that makes the estimator of a method."""
    solve = partial(solve_newton, tolerance=1e-6)
    return partial(make_estimator, solve=solve, mean_shape=scene.mean_shape)


@pytest.mark.parametrize("loss", [Loss.ABSOLUTE, Loss.SPARSE_ERROR])
class TestPlantedOutliers:
    """They are labelled and left out: every fifth landmark lies elsewhere."""

    @pytest.fixture
    def is_wrong(self, rng):
        return rng.random((20, 40)).argsort(axis=1) < 8

    @pytest.fixture
    def squared(self, scene, is_wrong, rng):
        """The problem of the squared loss."""
        direction = rng.choice([-1, 1], (20, 2, 40))
        move = 2.0 * direction * is_wrong[:, None]
        return replace(scene, landmarks=scene.landmarks + move).problem(0.02)

    @pytest.fixture
    def robust(self, squared, loss):
        return replace(squared, loss=loss, beta=0.1)

    @pytest.fixture
    def found(self, robust, estimator_of):
        return estimator_of("convex+refine")(robust)

    def test_all_are_labelled(self, found, is_wrong):
        assert found.outliers[is_wrong].all()

    def test_labels_are_those_of_the_convex_program(self, found, robust, estimator_of):
        convex = estimator_of("convex")(robust)
        assert_array_equal(found.outliers, convex.outliers)

    def test_it_converges_without_a_gap(self, found):
        assert set(found.status) == {Status.CONVERGED}
        assert found.relative_gap is None

    def test_the_objective_is_that_of_the_inliers(
        self, found, squared, is_wrong, estimator_of
    ):
        garbage = np.where(is_wrong[:, None], 1e6, squared.landmarks)
        weights = np.where(found.outliers, 0.0, squared.weights)
        inliers = replace(squared, landmarks=garbage, weights=weights)

        alone = estimator_of("convex+refine")(inliers)

        assert_allclose(found.objective, alone.objective, rtol=1e-3)

    def test_little_is_left_of_the_inliers(self, found):
        assert (found.residual < 0.05).all()


def test_labels_that_leave_too_little_are_not_believed(scene, estimator_of):
    """With a beta so small that every landmark is an outlier of the convex program."""
    program = Program(0.02, Loss.SPARSE_ERROR, beta=1e-9)
    method = estimator_of("convex+refine")

    found = lift(scene.landmarks, scene.weights, scene.atoms, program, method)

    assert found.failures == {}
    assert np.isfinite(found.shapes).all()
    assert not found.estimate.outliers.any()
