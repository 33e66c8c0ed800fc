"""How many digits a number gets, and what stands for none."""

from __future__ import annotations

import pytest

from shapefit.evaluation.tables.cells import ABSENT, decimals_of, number

NAN = float("nan")


@pytest.mark.parametrize(
    ("values", "decimals"),
    [
        ([0.26, 9.999], 3),
        ([10.0], 1),
        ([0.2, 345.6], 1),
        ([0.05, NAN], 4),
        ([1.0], 3),
        ([0.1], 3),
        ([0.00123], 5),
        ([0.0], 3),
        ([NAN], 3),
        ([], 3),
    ],
)
def test_the_largest_number_chooses_the_decimals_of_all(values, decimals):
    assert decimals_of(values) == decimals


def test_a_number_that_does_not_exist_is_a_dash():
    found = [number(value, 2) for value in (None, NAN, 0.006, 12.0)]
    assert found == [ABSENT, ABSENT, "0.01", "12.00"]
