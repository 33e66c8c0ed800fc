"""No image counts as fitted whose shape is not finite, whatever its status says."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from shapefit.convex.solver import Status, solve_newton
from shapefit.lifting.lift import NOT_FINITE, Program, fail_nonfinite, lift
from shapefit.lifting.methods import Settings, choose_method


@pytest.fixture
def lifting(make_scene):
    scene = make_scene(n=5)
    scene.weights[3] = 0.0
    settings = Settings(solve=partial(solve_newton), mean_shape=scene.mean_shape)
    method = choose_method("convex", settings)
    return lift(scene.landmarks, scene.weights, scene.atoms, Program(lam=0.1), method)


def test_what_is_finite_stays(lifting):
    assert fail_nonfinite(lifting) is lifting


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_one_coordinate_that_is_not_finite_fails_its_image(lifting, value):
    shapes = lifting.shapes.copy()
    shapes[1, 2, 4] = value
    found = fail_nonfinite(replace(lifting, shapes=shapes))
    assert found.failures == {1: NOT_FINITE, 3: "all landmarks are hidden"}
    optimal = Status.OPTIMAL
    assert found.estimate.status == (
        optimal, Status.NUMERICAL_FAILURE, optimal, Status.DEGENERATE, optimal,
    )  # fmt: skip
    for name in ("shapes", "landmarks_fitted", "translation", "scale"):
        after, before = getattr(found, name), getattr(lifting, name)
        assert np.isnan(after[1]).all()
        others = [0, 2, 3, 4]
        np.testing.assert_array_equal(after[others], before[others])
