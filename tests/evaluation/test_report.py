"""Sums over sequences, groups and landmarks by hand; the tables and the few lines."""

import csv
import io

import numpy as np
import pytest

from shapefit.evaluation.report import (
    ABSENT,
    decimals_of,
    format_number,
    group_sequences,
    parts_csv,
    report_csv,
    short_lines,
    summarise_errors,
    summarise_parts,
)
from shapefit.evaluation.units import shown_unit

NAN = float("nan")
INF = float("inf")
QUANTITY = ("similarity", "m")


def summarise(groups, **sequences):
    """Group -> sequence (None for the group) -> its summary, of errors by sequence.

    Images of a sequence lie apart.
    """
    names = [name for name, errors in sequences.items() for _ in errors]
    errors = [error for errors in sequences.values() for error in errors]
    places = np.arange(len(names))
    order = np.concatenate([places[::2], places[1::2]])
    shuffled_names = [names[i] for i in order]
    shuffled_errors = np.array(errors, dtype=float)[order]

    found = {}
    for row in summarise_errors(
        "convex", shuffled_names, {QUANTITY: shuffled_errors}, groups
    ):
        found.setdefault(row.group, {})[row.sequence] = row
    return found


class TestSumsOverSequences:
    A = tuple(range(11))
    B = (20, 20, 50)

    @pytest.fixture
    def groups(self):
        groups = {"all": ("a", "b", "elsewhere"), "none": ("elsewhere",)}
        return summarise(groups, a=self.A, b=self.B)

    def test_there_is_a_row_for_each_group_and_sequence_with_images(self, groups):
        assert [*groups] == ["all"]
        assert [*groups["all"]] == [None, "a", "b"]

    @pytest.mark.parametrize(
        ("sequence", "mean", "median", "p90"), [("a", 5, 5, 9), ("b", 30, 20, 44)]
    )
    def test_those_of_a_sequence_are_over_its_images(
        self, groups, sequence, mean, median, p90
    ):
        row = groups["all"][sequence]
        assert row.mean == pytest.approx(mean)
        assert row.median == pytest.approx(median)
        assert row.p90 == pytest.approx(p90)

    def test_those_of_a_group_are_means_over_its_sequences(self, groups):
        row = groups["all"][None]
        assert row.mean == pytest.approx((5 + 30) / 2)
        assert row.median == pytest.approx((5 + 20) / 2)
        assert row.p90 == pytest.approx((9 + 44) / 2)

    def test_images_of_a_group_are_counted(self, groups):
        row = groups["all"][None]
        assert row.images == 14
        assert row.failed == 0


class TestErrorsThatAreNoNumber:
    @pytest.fixture
    def rows(self):
        """A sequence with a failed image, one of failed images, one of infinite
        errors.
        """
        groups = {"all": ("a", "b", "c")}
        return summarise(groups, a=[1, NAN, 3], b=[NAN, NAN], c=[INF, INF])["all"]

    def test_failed_images_are_counted_and_infinite_errors_are_not(self, rows):
        counts = {name: (row.images, row.failed) for name, row in rows.items()}
        assert counts == {None: (2, 3), "a": (2, 1), "b": (0, 2)}

    def test_means_are_those_of_the_others(self, rows):
        assert rows[None].mean == 2
        assert rows["a"].mean == 2

    def test_a_sequence_of_failed_images_has_none(self, rows):
        failed = rows["b"]
        assert np.isnan([failed.mean, failed.median, failed.p90]).all()


@pytest.mark.parametrize("count", [1, 2, 3, 10, 11, 500])
def test_median_and_nine_in_ten_are_percentiles(rng, count):
    errors = rng.gamma(2, size=count)
    row = summarise({"all": ("a",)}, a=errors)["all"]["a"]
    assert row.median == pytest.approx(np.percentile(errors, 50))
    assert row.p90 == pytest.approx(np.percentile(errors, 90))


def test_groups_take_their_sequences_by_glob_in_order_of_appearance():
    names = ["14_02", "13_01", "14_01", "13_01"]
    globs = {"thirteen": "13_*", "fourteen": "14_*", "none": "15_*"}
    expected = {"thirteen": ("13_01",), "fourteen": ("14_02", "14_01"), "none": ()}
    assert group_sequences(globs, names) == expected


ERRORS = {
    "convex": {
        ("similarity", "normalised"): [0.1, 0.2, 0.6, NAN],
        ("similarity", "m"): [0.1, 0.2, 0.6, NAN],
        ("expected", "normalised"): [0.2, 0.2, 0.2, NAN],
        ("rotation", "deg"): [1.0, 3.0, 50.0, NAN],
    },
    "Ora|cle": {("similarity", "normalised"): [0.05] * 4},
}
"""Method -> metric and unit -> errors of four images, the last of another sequence."""

SEQUENCES = ("s", "s", "s", "t")


def summaries_of(groups):
    for method, errors in ERRORS.items():
        arrays = {quantity: np.array(values) for quantity, values in errors.items()}
        yield from summarise_errors(method, SEQUENCES, arrays, groups)


def make_report(groups, failures=1):
    failed = [{"item": f"<b>item{i}", "reason": "no shape"} for i in range(failures)]
    convex = {"name": "convex", "images": 30, "failures": failed, "failed": failures}
    oracle = {"name": "Ora|cle", "images": 4, "failures": [], "failed": 0}
    bars = {
        "method": "convex",
        "group": next(iter(groups)),
        "counted": 30,
        "inside": (0.4, 0.876),
        "median_width": {"normalised": 0.3},
    }
    return {
        "methods": [convex, oracle],
        "summaries": [*summaries_of(groups)],
        "warnings": ["no true\nrotation"],
        "calibration": [bars],
        "landmarks": [],
        "angles": [],
    }


def test_the_few_lines_say_errors_images_and_what_bars_hold():
    report = make_report({"all": ("s",)})
    assert short_lines(report) == [
        (
            "convex   error aligned 300.0 mean, 200.0 median (mm); rotation 18.0 mean,"
            " 3.0 median (deg); 3 images; 50% bars hold 40%; 90% bars hold 88%;"
            " expected / error 0.67"
        ),
        "Ora|cle  error aligned 0.0500 mean, 0.0500 median (normalised); 3 images",
        "convex   failed: 1 of 30",
    ]


def test_means_over_sequences_say_so():
    """Of the second sequence one method has measured nothing."""
    report = make_report({"all": ("s", "t")})
    convex, oracle, *_ = short_lines(report)
    assert "; 3 images; 50%" in convex
    assert "; 4 images, means over 2 sequences" in oracle


def test_angles_have_a_line():
    report = make_report({"all": ("s", "t")})
    errors = np.array([[1.0, 4.0], [3.0, NAN], [NAN, 8.0]])
    report["angles"] = [*summarise_parts("convex", ("a", "b"), {"deg": errors})]
    assert "convex   joint angles 4.0 mean (deg); b 6.0" in short_lines(report)


class TestParts:
    @pytest.fixture
    def parts(self):
        """Errors of three landmarks in two images, which lack the second."""
        errors = np.array([[1.0, NAN, 4.0], [3.0, NAN, NAN]])
        return [*summarise_parts("m", ("a", "b", "c"), {"m": errors})]

    def test_parts_that_no_image_has_are_left_out(self, parts):
        assert [part.part for part in parts] == ["a", "c"]
        assert [part.images for part in parts] == [2, 1]
        assert [part.mean for part in parts] == [2.0, 4.0]

    def test_their_table_has_a_row_for_each(self, parts):
        assert parts_csv(parts, "landmark").splitlines() == [
            "method,landmark,images,mean,median,p90,unit",
            "m,a,2,2.0,2.0,2.8,m",
            "m,c,1,4.0,4.0,4.0,m",
        ]


@pytest.mark.parametrize(
    ("unit", "errors", "shown"),
    [
        ("m", (0.04, NAN), ("mm", 1000)),
        ("m", (0.04, 1.2), ("m", 1)),
        ("cm", (0.04,), ("cm", 1)),
        ("m", (), ("mm", 1000)),
    ],
)
def test_metres_are_millimetres_where_all_errors_are_below_one(unit, errors, shown):
    assert shown_unit(unit, errors) == shown


class TestReportCsv:
    @pytest.fixture
    def rows(self):
        report = make_report({"G": ("s", "t")})
        return [*csv.DictReader(io.StringIO(report_csv(report)))]

    def find_mean(self, rows, metric, unit, sequence):
        """Return the mean of the one row of a metric of the convex method."""
        key = ("convex", metric, unit, sequence)
        names = ("method", "metric", "unit", "sequence")
        (row,) = [row for row in rows if tuple(row[name] for name in names) == key]
        return row["mean"]

    def test_means_have_all_digits(self, rows):
        mean = self.find_mean(rows, "similarity", "m", "s")
        assert float(mean) == np.mean([0.1, 0.2, 0.6])

    def test_a_mean_of_no_images_is_empty(self, rows):
        assert self.find_mean(rows, "similarity", "m", "t") == ""

    def test_what_error_bars_hold_is_a_metric(self, rows):
        assert self.find_mean(rows, "inside_90", "share", "") == "0.876"

    def test_their_width_is_one_with_a_median_alone(self, rows):
        (width,) = [row for row in rows if row["metric"] == "width"]
        assert width["median"] == "0.3"
        assert width["mean"] == ""
        assert width["images"] == "30"


@pytest.mark.parametrize(
    ("values", "decimals"),
    [
        ([0.26, 9.999], 3),
        ([10.0], 1),
        ([0.2, 345.6], 1),
        ([0.05, NAN], 4),
        ([0.1], 3),
        ([0.00123], 5),
        ([0.0], 3),
        ([NAN, None], 3),
        ([], 3),
    ],
)
def test_the_largest_number_chooses_the_decimals_of_all(values, decimals):
    assert decimals_of(values) == decimals


@pytest.mark.parametrize(
    ("value", "shown"),
    [(None, ABSENT), (NAN, ABSENT), (0.006, "0.01"), (12.0, "12.00")],
)
def test_numbers_are_shown_with_two_decimals_or_as_absent(value, shown):
    assert format_number(value, 2) == shown
