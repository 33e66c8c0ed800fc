"""Problems of an input are listed, at most ten of them."""

import pytest

from shapefit.io.checks import LIMIT, input_problems


@pytest.mark.parametrize("count", [1, LIMIT, LIMIT + 1, LIMIT + 2])
def test_all_problems_are_told_or_counted(count):
    told = [f"line {number}" for number in range(count)]
    left = count - LIMIT
    expected = told[:LIMIT] + [f"... and {left} more"] * (left > 0)
    assert str(input_problems(told)).split("\n") == expected
    assert str(input_problems(told[:LIMIT], count)).split("\n") == expected
