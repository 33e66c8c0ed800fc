"""convex+refine with a robust loss: outliers of the convex program, and a fit without them."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from shapefit.convex.problem import Loss
from shapefit.convex.solver import Status, solve_newton
from shapefit.lifting.lift import Program, lift
from shapefit.lifting.methods import Settings, choose_method

ROBUST = (Loss.ABSOLUTE, Loss.SPARSE_ERROR)


@pytest.fixture
def scene(make_scene):
    return make_scene(n=20, k=6, p=40, active=2)


@pytest.fixture
def settings(scene):
    return Settings(solve=partial(solve_newton, tolerance=1e-6), mean_shape=scene.mean_shape)


@pytest.fixture
def corrupted(scene, rng):
    """A problem with every fifth landmark of each image elsewhere, and which those are."""
    wrong = rng.random((20, 40)).argsort(axis=1) < 8
    move = np.where(wrong[:, None], rng.choice([-1, 1], (20, 2, 40)) * 2.0, 0.0)
    return replace(scene, landmarks=scene.landmarks + move).problem(0.02), wrong


@pytest.mark.parametrize("loss", ROBUST)
def test_planted_outliers_are_labelled_and_left_out(loss, corrupted, settings):
    problem, wrong = corrupted
    robust = choose_method("convex+refine", settings)(replace(problem, loss=loss, beta=0.1))
    assert set(robust.status) == {Status.CONVERGED}
    assert robust.relative_gap is None
    assert robust.outliers[wrong].all()
    labels = choose_method("convex", settings)(replace(problem, loss=loss, beta=0.1)).outliers
    np.testing.assert_array_equal(robust.outliers, labels)

    garbage = np.where(wrong[:, None], 1e6, problem.landmarks)
    inliers = replace(
        problem, landmarks=garbage, weights=np.where(robust.outliers, 0.0, problem.weights)
    )
    alone = choose_method("convex+refine", settings)(inliers)
    np.testing.assert_allclose(robust.objective, alone.objective, rtol=1e-3)
    assert (robust.residual < 0.05).all()


def test_labels_that_leave_too_little_are_not_believed(scene, settings):
    """With a beta so small that every landmark is an outlier of the convex program."""
    program = Program(0.02, Loss.SPARSE_ERROR, beta=1e-9)
    method = choose_method("convex+refine", settings)
    found = lift(scene.landmarks, scene.weights, scene.atoms, program, method)
    assert found.failures == {}
    assert np.isfinite(found.shapes).all()
    assert not found.estimate.outliers.any()
