"""Large tables: beyond what is held, images go to a temporary file as soon as their
rows are complete.
"""

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from shapefit.io import inputs, open_landmarks
from shapefit.records import concatenate
from tests.io.files import load

ITEM_ROWS = list(product(range(40), range(4)))
"""Item and landmark of each row, the rows of an item together."""

ORDERS = {
    "melted": [(item, landmark) for landmark in range(4) for item in range(40)],
    "mixed": [((7 * row) % 40, row // 40) for row in range(160)],
    "one row late": [*(row for row in ITEM_ROWS if row != (2, 3)), (2, 3)],
}
"""The same rows, those of an item not together."""


@pytest.fixture
def hold(monkeypatch):
    """Let so many rows be held in memory."""

    def change(rows: int) -> None:
        monkeypatch.setattr("shapefit.io.csv_file.MAX_IN_MEMORY", rows)

    return change


@pytest.fixture(autouse=True)
def _little_is_held(hold, monkeypatch):
    hold(12)
    monkeypatch.setattr(inputs, "BLOCK_BYTES", 40)


@pytest.fixture
def table(csv_table):
    """Write a table of these items and landmarks, three items a sequence."""

    def write(order) -> Path:
        rows = ["item,landmark,x,y,confidence,sequence"]
        for i, j in order:
            x = i + j / 7
            rows.append(f"i{i},{'abcd'[j]},{x},{i * j},{0.5 + j},s{i // 3}")
        return csv_table("\n".join([*rows, ""]))

    return write


@pytest.fixture
def table_with_gaps(table):
    """A table in which the first two items lack a landmark."""
    return table([row for row in ITEM_ROWS if row not in ((0, 3), (1, 3))])


@pytest.fixture
def whole(hold, table_with_gaps):
    """What the table is when all of it is held."""
    hold(10**6)
    whole = load(table_with_gaps)
    hold(12)
    return whole


def test_batches_are_those_of_a_small_table(table_with_gaps, whole, same):
    with open_landmarks([table_with_gaps]) as source:
        batches = list(source.batches(7))
        assert source.count == 40
        assert source.notes == ()
    same(concatenate(batches), whole)


def test_chosen_items_are_those_of_a_small_table(table_with_gaps, whole, same):
    rows = [1, 2, 30]
    with open_landmarks([table_with_gaps]) as source:
        chosen = list(source.select(np.array(rows), 7))
    same(concatenate(chosen), whole.take(rows))


def test_names_are_those_of_a_small_table(table_with_gaps, whole):
    with open_landmarks([table_with_gaps]) as source:
        names = [item for block in source.item_names() for item in block]
    assert tuple(names) == whole.items


def test_items_are_estimated_by_the_length_of_the_first_lines(table):
    with open_landmarks([table(ITEM_ROWS)], head=True) as source:
        assert source.count < source.estimate
        assert source.estimate == pytest.approx(40, abs=4)


def test_no_fewer_items_are_estimated_than_were_read(csv_table, hold, monkeypatch):
    hold(80)
    monkeypatch.setattr(inputs, "BLOCK_BYTES", 1 << 20)
    long_rows = [f"{'i' * 100_000}{i},a,1,2" for i in range(11)]
    short_rows = [f"i{i},a,1,2" for i in range(11, 99)]
    path = csv_table("\n".join(["item,landmark,x,y", *long_rows, *short_rows, ""]))
    with open_landmarks([path], head=True) as source:
        assert source.count == 99
        assert source.estimate == 99


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("held", [12, 50, 100])
@pytest.mark.parametrize("block_bytes", [40, 1000])
def test_rows_of_an_item_need_not_stand_together(
    table, hold, same, monkeypatch, order, held, block_bytes
):
    monkeypatch.setattr(inputs, "BLOCK_BYTES", block_bytes)
    path = table(ORDERS[order])
    hold(10**6)
    whole = load(path)
    hold(held)
    with open_landmarks([path]) as source:
        batches = list(source.batches(7))
        assert source.count == 40
    same(concatenate(batches), whole)


def test_a_row_twice_is_named_wherever_it_stands(table, problems):
    path = table([*ORDERS["melted"], (3, 1)])
    (line,) = problems(open_landmarks, [path])
    assert "is also on line 45" in line


def test_memory_that_does_not_hold_them_is_stated(table, problems, monkeypatch):
    path = table(ORDERS["melted"])
    monkeypatch.setattr(inputs, "free_memory", lambda: 1000)
    monkeypatch.setattr(inputs, "ALWAYS_FITS", 1000)
    (line,) = problems(open_landmarks, [path])
    assert "of memory, and 1 kB are free; divide the file" in line


def test_of_standard_input_the_rows_of_an_item_must_stand_together(
    table, standard_input, problems
):
    two_landmarks = [(item, landmark) for landmark in (0, 1) for item in range(40)]
    standard_input(table(two_landmarks).read_text())
    (line,) = problems(open_landmarks, [Path("-")])
    assert line.endswith(
        ": the rows of items do not stand together, and the table is large; "
        "name the file itself, or sort its rows by item"
    )
