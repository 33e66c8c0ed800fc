"""Cells that the core reads are those that Python reads, to the bit."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal, assert_equal

from shapefit.io.csv_cells import ListedCells, parse_rows, read_numbers, split_cells

NUMBERS = st.floats().map(repr)
LIKE_NUMBERS = st.text(st.sampled_from("00123456789..--+eE infatyx_ü\t"), max_size=9)
TEXTS = st.text(st.sampled_from("aab01ü€Ê -"), min_size=1, max_size=2)
"""€ and Ê in UTF-8 have the bytes of a comma and of a line end with a high bit."""


def both(texts):
    """Return the same cells split by the core and listed, behind a column of texts."""
    text = "".join(f"a,{cell}\n" for cell in texts)
    split = split_cells(text.encode(), ["left", "right"], 1)
    lines = np.arange(1, len(texts) + 1)
    listed = ListedCells(lines, {"left": ["a"] * len(texts), "right": texts})
    return split, listed


@given(st.lists(NUMBERS | LIKE_NUMBERS, min_size=1, max_size=8))
@example(["1e400", "-1e-400", "5e-324", "0x1", "1d5", "1.", ".5", "-.5e1", "-", ""])
@example(["-nan1", "infinity", "nan(1)", "1_0", "+1", "+-1", "00012", "1e", "1e+"])
@settings(max_examples=500)
def test_numbers_are_the_same(texts):
    split, listed = both(texts)
    values, strange = split.numbers("right")
    expected, expected_strange = listed.numbers("right")
    assert_array_equal(values, expected)
    assert_array_equal(np.signbit(values), np.signbit(expected))
    assert_array_equal(strange, expected_strange)


@given(st.lists(TEXTS, min_size=1, max_size=30))
@example(["a", "b", "c", "a", "b", "c", "a", "c", "b"])
@example(["a", "a", "a", "b", "b", "a"])
def test_texts_are_numbered_as_they_come(texts):
    split, listed = both(texts)
    numbers, names = split.unique_texts("right")
    expected_numbers, expected_names = listed.unique_texts("right")
    assert [names[number] for number in numbers] == texts
    assert names == expected_names
    assert_array_equal(numbers, expected_numbers)
    assert split.unique_texts("left")[1] == ["a"]


@pytest.mark.parametrize("size", [1, 7, 8, 9, 64])
def test_texts_of_any_size_are_read_to_their_end(size):
    text = "x" * size
    split, _ = both([text])
    _, names = split.unique_texts("right")
    assert split.cell("right", 0) == text
    assert names == [text]


@given(st.text(st.sampled_from('aaa,,,\n\n"\r'), min_size=1, max_size=12))
@example("a,a,a\na")
@settings(max_examples=300)
def test_what_is_split_is_never_read_in_another_way(text):
    cells = split_cells(text.encode(), ["left", "right"], 1)
    if cells is None:
        return  # the core leaves it to Python
    rows = [row for _, row in parse_rows([text], 1, "name")]
    assert len(cells.lines) == len(rows)
    for number, row in enumerate(rows):
        assert [cells.cell(column, number) for column in ("left", "right")] == row


@given(st.lists(st.text(st.sampled_from("ab \t\v\x1c\xa0ü"), max_size=6), min_size=1))
@example(["  ", " a b\t", "\va\x1f"])
@example(["\xa0a"])
@settings(max_examples=300)
def test_spaces_around_cells_are_removed_as_python_does(texts):
    text = "".join(f" a ,{cell}, b\n" for cell in texts)
    columns = ["left", "middle", "right"]
    cells = split_cells(text.encode(), columns, 1, spaced=True)
    assert (cells is None) == (not text.isascii())
    if cells is None:
        return  # Python removes them
    stripped = [cell.strip() for cell in texts]
    numbers, names = cells.unique_texts("middle")
    assert [names[number] for number in numbers] == stripped
    assert [cells.cell("middle", row) for row in range(len(texts))] == stripped
    assert cells.unique_texts("left")[1] == ["a"]
    assert cells.unique_texts("right")[1] == ["b"]


@given(st.lists(NUMBERS | LIKE_NUMBERS, min_size=1, max_size=8))
def test_numbers_between_spaces_are_the_same(texts):
    text = "".join(f"a , {cell}\t\n" for cell in texts)
    cells = split_cells(text.encode(), ["left", "right"], 1, spaced=True)
    if cells is None:
        return  # texts beyond ASCII are left to Python
    values, invalid = cells.numbers("right")
    expected, expected_invalid = read_numbers([cell.strip() for cell in texts])
    assert_array_equal(values, expected)
    assert_array_equal(invalid, expected_invalid)


PYTHON_NUMBERS = [
    "1",
    "-0.0",
    "+1",
    "1.",
    ".5",
    "007",
    "1e5",
    "1E+5",
    " 1\t",
    "inf",
    "-Infinity",
    "1e400",
    "5e-324",
    "1.7976931348623157e308",
    "18446744073709551617",
    "0.1000000000000000055511151231257827",
    "",
    " ",
    "nan",
    "NaN",
    "-nan",
]
"""What `float` reads, and empty cells, which are unknown."""


@pytest.mark.parametrize("text", PYTHON_NUMBERS)
def test_numbers_are_those_of_python(text):
    expected = float(text.strip() or "nan")
    for cells in ([text], [text, "2"], ["", text]):
        values, strange = read_numbers(cells)
        value = values[cells.index(text)]
        assert not strange.any()
        assert_equal(value, expected)


NO_NUMBERS = [
    "one",
    "1_000",
    "１",
    "null",
    "true",
    "[1]",
    "1,2",
    "{}",
    '"1"',
    "1 2",
    "0x10",
    "1d5",
    "--1",
]
"""Cells that one reader or another would take for numbers."""


@pytest.mark.parametrize("text", NO_NUMBERS)
def test_what_is_no_number_is_strange(text):
    for cells in ([text], ["1", text, ""], ["", text]):
        _, strange = read_numbers(cells)
        strange_cells = [cells[row] for row in np.flatnonzero(strange)]
        assert strange_cells == [text]
