"""Tidy tables: what is written."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from shapefit.io import (
    csv_file,
    read_results,
    result_writer,
)
from shapefit.io.csv_cells import read_numbers
from shapefit.records import Landmarks
from tests.io.files import load, save


@pytest.fixture
def result_table(tmp_path, results):
    """A table of results, written in two parts, and its shapes: those of the first
    image have long and short numbers, those of the second are unknown.
    """
    path = tmp_path / "result.csv"
    shapes = results.shapes.copy()
    shapes[0, 0] = (0.1, 1e-7, -123456789.123456789)
    shapes[1] = np.nan
    changed = results.replaced(shapes=shapes)
    with result_writer(path) as writer:
        writer.append(changed.take([0, 1]))
        writer.append(changed.take([2, 3, 4]))
    return path, shapes


def test_rows_of_results(result_table):
    path, _ = result_table
    lines = path.read_text().splitlines()
    assert lines[0] == "item,landmark,x,y,z,sequence"
    assert lines[1] == "image 0,head,0.1,1e-7,-123456789.12345679,a"
    assert lines[5] == "image 1,head,,,,a"
    assert len(lines) == 1 + 5 * 4


def test_results_come_back(result_table):
    path, shapes = result_table
    assert_array_equal(read_results(path).shapes, shapes)


def test_items_without_landmarks_write_a_header(tmp_path):
    path = tmp_path / "none.csv"
    none = Landmarks(np.empty((2, 0, 2)), landmark_names=(), items=("a", "b"))
    save(path, none)
    assert path.read_text() == "item,landmark,x,y\n"


FINITE = st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(FINITE, min_size=2, max_size=2))
@example([-1.2345678901234567e-300] * 2)  # as many digits as there are
def test_numbers_come_back_to_the_last_bit(position):
    written: list[bytes] = []
    writer = csv_file.CsvWriter(written.append)
    writer.append(Landmarks(np.array([[position]]), landmark_names="a", items="b"))
    row = bytes(written[-1]).decode().removesuffix("\n")
    _item, _landmark, *cells = row.split(",")
    values, _ = read_numbers(cells)
    assert values.tobytes() == np.array(position).tobytes()


def test_one_landmark_has_one_row_an_item(tmp_path, same):
    path = tmp_path / "one.csv"
    points = np.arange(10.0, 16).reshape(3, 1, 2)
    images = Landmarks(points, landmark_names=("a",), items=("i", "j", "k"))
    save(path, images)
    same(load(path), images)
