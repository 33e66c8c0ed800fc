"""Objective, time and success of a method, over all of its images."""

import numpy as np
import pytest

from shapefit.evaluation.solving import Run, Solving, count_solved, sum_up


def test_each_image_weighs_the_same():
    found = sum_up(Run(5, np.array([1.0, 2.0, 3.0, np.nan, 10.0]), 3, 0.75))
    assert found.mean_objective == pytest.approx((1 + 2 + 3 + 10) / 4)
    assert found.milliseconds == pytest.approx(750 / 5)
    assert found.solved == pytest.approx(3 / 5)


@pytest.mark.parametrize("status", ["optimal", "converged"])
def test_both_good_ends_count_as_solved(status):
    assert count_solved(np.array([status, "numerical failure"])) == 1


def test_what_is_not_told_is_unknown():
    assert sum_up(Run(1)) == Solving()
    assert sum_up(Run(1, np.array([1.0]), 1, 0.5)) == Solving(1.0, 500.0, 1.0)


def test_without_a_known_objective_there_is_no_mean():
    for objective in (np.nan, np.inf, 1e300):
        run = Run(1, np.array([objective]), 0, 0.5)
        assert sum_up(run) == Solving(None, 500.0, 0.0)


@pytest.mark.parametrize(
    ("milliseconds", "rate"), [(0.25, 4000.0), (80.0, 12.5), (0.0, None), (None, None)]
)
def test_the_rate_is_the_inverse_of_the_time_of_an_image(milliseconds, rate):
    assert Solving(milliseconds=milliseconds).images_per_second == rate
