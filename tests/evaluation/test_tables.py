"""The written tables, cell by cell."""

import csv
import io
import json

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


def rows_of(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def test_per_image_lists_every_image_the_failed_one_without_error(tmp_path, errors):
    write_per_image(tmp_path / "per_image.csv", errors)
    header, *rows = rows_of(tmp_path / "per_image.csv")
    assert header == ["method", "sequence", "item", "metric", "error", "unit"]
    assert rows[0] == ["convex", "13_01", "a", "similarity", "0.1", "normalised"]
    assert rows[3] == ["convex", "14_01", "d", "similarity", "", "normalised"]
    assert len(rows) == 8


def test_report_csv_has_group_rows_without_sequence(tmp_path, report):
    (tmp_path / "report.csv").write_text(report_tables.write_tables(report)["report.csv"])
    header, *rows = rows_of(tmp_path / "report.csv")
    expected = "method,metric,group,sequence,images,mean,median,p90,unit"
    assert ",".join(header) == expected
    by_place = {(row[0], row[2], row[3]): dict(zip(header, row, strict=True)) for row in rows}
    group = by_place["convex", "Subject 13", ""]
    assert float(group["mean"]) == pytest.approx((0.15 + 0.35) / 2)
    assert (group["images"], group["unit"]) == ("3", "normalised")
    assert float(by_place["convex", "Subject 13", "13_01"]["p90"]) == pytest.approx(0.19)
    failed = by_place["convex", "Subject 14", ""]
    assert (failed["images"], failed["mean"]) == ("0", "")


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


def test_json_counts_and_lists_failures(report):
    document = json.loads(report_tables.report_json(report))
    convex, admm = document["methods"]
    assert (convex["images"], convex["failed"], admm["failed"]) == (4, 1, 0)
    assert convex["failures"] == [{"item": "d", "reason": "no estimate"}]
    failed = next(s for s in document["summaries"] if s["sequence"] == "14_01")
    assert (failed["mean"], failed["failed"]) == (None, 1)


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
