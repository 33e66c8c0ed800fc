"""Objective, time and success of a method, over all of its files."""

import numpy as np
import pytest

from shapefit.evaluation.solving import Run, Solving, sum_up

STATUS = np.array(["optimal", "converged", "iteration limit", "degenerate input"], dtype=object)


def test_each_image_weighs_the_same_whichever_its_file():
    files = [
        Run(4, np.array([1.0, 2.0, 3.0, np.nan]), STATUS, 0.5),
        Run(1, np.array([10.0]), STATUS[:1], 0.25),
    ]
    found = sum_up(files)
    assert found.mean_objective == pytest.approx((1 + 2 + 3 + 10) / 4)
    assert found.milliseconds == pytest.approx(750 / 5)
    assert found.solved == pytest.approx(3 / 5)


@pytest.mark.parametrize("status", ["optimal", "converged"])
def test_both_good_ends_count_as_solved(status):
    assert sum_up([Run(2, status=np.array([status, "numerical failure"]))]).solved == 0.5


def test_what_one_file_does_not_tell_is_unknown_for_the_method():
    whole = Run(1, np.array([1.0]), STATUS[:1], 0.5)
    assert sum_up([whole, Run(1)]) == Solving()
    assert sum_up([whole]) == Solving(1.0, 500.0, 1.0)


def test_without_a_known_objective_there_is_no_mean():
    for objective in (np.nan, np.inf, 1e300):
        run = Run(1, np.array([objective]), STATUS[3:], 0.5)
        assert sum_up([run]) == Solving(None, 500.0, 0.0)


@pytest.mark.parametrize(
    ("milliseconds", "rate"), [(0.25, 4000.0), (80.0, 12.5), (0.0, None), (None, None)]
)
def test_the_rate_is_the_inverse_of_the_time_of_an_image(milliseconds, rate):
    assert Solving(milliseconds=milliseconds).images_per_second == rate
