"""Cells that the core reads are those that Python reads, to the bit."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from shapefit.io.csv_cells import ListedCells, split_cells

NUMBERS = st.floats().map(repr)
LIKE_NUMBERS = st.text(st.sampled_from("00123456789..--+eE infatyx_ü\t"), max_size=9)
TEXTS = st.text(st.sampled_from("aab01ü -"), min_size=1, max_size=2)


def both(texts):
    """Return the same cells split by the core and listed, behind a column of texts."""
    text = "".join(f"a,{cell}\n" for cell in texts)
    split = split_cells(text, ["left", "right"], 1)
    lines = np.arange(1, len(texts) + 1)
    return split, ListedCells(lines, {"left": ["a"] * len(texts), "right": texts})


@given(st.lists(NUMBERS | LIKE_NUMBERS, min_size=1, max_size=8))
@example(["1e400", "-1e-400", "5e-324", "0x1", "1d5", "1.", ".5", "-.5e1", "-", ""])
@example(["-nan1", "infinity", "nan(1)", "1_0", "+1", "+-1", "00012", "1e", "1e+"])
@settings(max_examples=500)
def test_numbers_are_the_same(texts):
    split, listed = both(texts)
    found, strange = split.numbers("right")
    expected, strange_listed = listed.numbers("right")
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(np.signbit(found), np.signbit(expected))
    np.testing.assert_array_equal(strange, strange_listed)


@given(st.lists(TEXTS, min_size=1, max_size=30))
@example(["a", "b", "c", "a", "b", "c", "a", "c", "b"])
@example(["a", "a", "a", "b", "b", "a"])
def test_texts_are_numbered_as_they_come(texts):
    split, listed = both(texts)
    numbers, names = split.texts("right")
    assert [names[number] for number in numbers] == texts
    expected_numbers, expected_names = listed.texts("right")
    assert (numbers.tolist(), names) == (expected_numbers.tolist(), expected_names)


@pytest.mark.parametrize("size", [1, 7, 8, 9, 64])
def test_texts_of_any_size_are_read_to_their_end(size):
    split, _ = both(["x" * size])
    assert split.cell("right", 0) == "x" * size
    assert split.texts("right")[1] == ["x" * size]
