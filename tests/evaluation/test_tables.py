"""The written tables, cell by cell."""

import csv
import io

import numpy as np
import pytest

from shapefit.evaluation import report as report_tables
from shapefit.evaluation.report import ABSENT, decimals_of, number
from shapefit.evaluation.summaries import ImageErrors
from shapefit.io.csv_file import per_image_header, per_image_rows


def write_per_image(path, errors):
    rows = [bytes(each) for one in errors for each in per_image_rows(one)]
    path.write_bytes(per_image_header() + b"".join(rows))


def write_table(path, columns, rows):
    path.write_text(report_tables.table_text(columns, rows), newline="", encoding="utf-8")


def test_names_and_errors_are_written_as_by_the_library(tmp_path):
    """Names in quotes where they need them, of an image and a sequence without one nothing."""
    names = ("a,b", 'c"d', "e\nf", "g\rh", " i ", "", "ü", "plain")
    values = (0.1 + 0.2, np.nan, 1e-5, 1e16, -0.0, 5e-324, 12.0, 1e-4)
    errors = ImageErrors("m, n", "similarity", "m", names, names[::-1], np.array(values))
    write_per_image(tmp_path / "per_image.csv", [errors, errors])
    rows = [
        ("m, n", sequence, item, "similarity", "" if np.isnan(value) else repr(value), "m")
        for sequence, item, value in zip(names[::-1], names, values, strict=True)
    ]
    lines = []
    for row in [("method", "sequence", "item", "metric", "error", "unit"), *rows, *rows]:
        lines.append(io.StringIO())
        csv.writer(lines[-1]).writerow(row)
    expected = "".join(line.getvalue().removesuffix("\r\n") + "\n" for line in lines)
    assert (tmp_path / "per_image.csv").read_bytes() == expected.encode()


def test_numbers_have_all_their_digits_and_nan_is_empty(tmp_path):
    write_table(tmp_path / "table.csv", "abcd", [(0.1 + 0.2, float("nan"), None, 7)])
    assert (tmp_path / "table.csv").read_bytes() == b"a,b,c,d\n0.30000000000000004,,,7\n"


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
