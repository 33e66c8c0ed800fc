"""Rows of CSV that the core writes, held to the csv module and to `repr`."""

import csv
import math
from io import StringIO

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from shapefit.io.csv_rows import csv_cell, format_rows

TEXTS = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12)
EXTREMES = [0.0, -0.0, 1e16, 1e-4, 9.999e-5, 5e-324, 1.7976931348623157e308, 1 / 3]


@given(
    first=TEXTS,
    last=TEXTS,
    numbers=st.lists(st.floats(allow_nan=True), min_size=1, max_size=9),
)
@example(first="a,b", last='say "so"', numbers=EXTREMES)
@example(first="a\nb", last="é", numbers=[math.nan, math.inf, -math.inf])
def test_the_csv_module_reads_what_was_written(first, last, numbers):
    texts = [csv_cell(first), csv_cell(last)]
    cells = np.tile([0, 1], (len(numbers), 1))
    column = np.array(numbers)[:, None]
    rows = format_rows(texts, cells, column, leading=1, as_python=True)

    shown = ["" if math.isnan(number) else repr(number) for number in numbers]
    read = [*csv.reader(StringIO(bytes(rows).decode(), newline=""))]
    assert read == [[first, number, last] for number in shown]


@given(st.lists(st.floats(allow_nan=False), min_size=1, max_size=9))
def test_numbers_of_json_read_back_to_the_same_float(numbers):
    texts = [csv_cell("a")]
    cells = np.zeros((1, 1), np.int64)
    rows = format_rows(texts, cells, np.array([numbers]), leading=1)
    (row,) = csv.reader(StringIO(bytes(rows).decode()))
    finite = [number for number in numbers if math.isfinite(number)]
    assert [float(cell) for cell in row[1:] if cell] == finite
