"""The verdict of `make bench`: what makes it fail."""

import pytest

from benchmarks.bench import Table
from benchmarks.cases import Row, Turn, compare


@pytest.mark.parametrize(
    ("row", "fault"),
    [
        (Row("case", "", "", 4.1), None),
        (Row("case", "", "", 3.9), "3.90 is under 4.00"),
        (Row("other", "", "", 0.95), None),
        (Row("other", "", "", 0.85), "0.85 is under 0.90"),
        (Row("case", "", "", 9.0, 0.999, 0.999, certified=True), "99.90%"),
        (Row("case", "", "", 9.0, 0.999, 0.999), None),
        (Row("case", "", "", 9.0, 0.9, 0.8), "80.00%"),
        (Row("case", "", "", 9.0, change=0.1, certified=True), "sum"),
        (Row("case", "", "", 9.0, change=0.1), None),
    ],
)
def test_a_fault_of_a_case_is_told(row, fault):
    table = Table({"case": 4.0})
    table.add(row)
    assert [fault in text for text in table.faults] == ([True] if fault else [])


def test_the_ratio_is_the_median_of_neighbouring_turns():
    before = iter([Turn(6.0), Turn(8.0), Turn(90.0)])
    now = iter([Turn(2.0), Turn(2.0), Turn(9.0)])
    row = compare("case", (lambda: next(before), lambda: next(now)), 3)
    assert (row.ratio, row.before, row.now) == (4.0, "8 s", "2 s")
