"""Problems are listed, or counted where they are many."""

import pytest

from shapefit.io.checks import LIMIT, input_problems


@pytest.mark.parametrize("count", [LIMIT, LIMIT + 2])
def test_all_problems_are_listed_or_counted(count):
    lines = [f"line {number}" for number in range(count)]
    expected = lines[:LIMIT]
    if count > LIMIT:
        expected = [*expected, f"... and {count - LIMIT} more"]
    assert str(input_problems(lines)).split("\n") == expected
    assert str(input_problems(lines[:LIMIT], count)).split("\n") == expected
