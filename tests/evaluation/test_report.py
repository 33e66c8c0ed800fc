"""Sums over sequences, groups and landmarks by hand; the tables and the few lines."""

import csv
import io

import numpy as np
import pytest

from shapefit.evaluation.report import (
    ABSENT,
    decimals_of,
    group_sequences,
    number,
    parts_csv,
    report_csv,
    short_lines,
    summarise_errors,
    summarise_parts,
)
from shapefit.evaluation.units import shown_unit

NAN, INF = float("nan"), float("inf")
KIND = ("similarity", "m")


def sums(groups, **sequences):
    """Group -> sequence (None for the group) -> its summary, of errors by sequence."""
    names = [name for name, values in sequences.items() for _ in values]
    values = np.array([v for values in sequences.values() for v in values], dtype=float)
    order = np.argsort(
        np.arange(len(names)) % 2, kind="stable"
    )  # images of a sequence lie apart
    rows = summarise_errors(
        "convex", [names[i] for i in order], {KIND: values[order]}, groups
    )
    found = {}
    for row in rows:
        found.setdefault(row.group, {})[row.sequence] = row
    return found


def test_means_of_groups_are_means_over_their_sequences():
    a, b = list(range(11)), [20, 20, 50]  # medians 5 and 20, 90th percentiles 9 and 44
    rows = sums({"all": ("a", "b", "elsewhere"), "none": ("elsewhere",)}, a=a, b=b)
    assert [*rows] == ["all"]
    assert [*rows["all"]] == [None, "a", "b"]
    whole, first, second = rows["all"].values()
    assert (first.mean, first.median, first.p90) == pytest.approx((5, 5, 9))
    assert (second.mean, second.median, second.p90) == pytest.approx((30, 20, 44))
    assert (whole.mean, whole.median, whole.p90) == pytest.approx((17.5, 12.5, 26.5))
    assert (whole.images, whole.failed) == (14, 0)


def test_failed_images_are_counted_and_infinite_errors_are_not():
    rows = sums({"all": ("a", "b", "c")}, a=[1, NAN, 3], b=[NAN, NAN], c=[INF, INF])[
        "all"
    ]
    assert [*rows] == [None, "a", "b"]
    counts = [(row.images, row.failed) for row in rows.values()]
    assert counts == [(2, 3), (2, 1), (0, 2)]
    assert (rows[None].mean, rows["a"].mean) == (2, 2)
    assert np.isnan([rows["b"].mean, rows["b"].median, rows["b"].p90]).all()


def test_groups_take_their_sequences_by_glob_in_order_of_appearance():
    names = ["14_02", "13_01", "14_01", "13_01"]
    globs = {"thirteen": "13_*", "fourteen": "14_*", "none": "15_*"}
    expected = {"thirteen": ("13_01",), "fourteen": ("14_02", "14_01"), "none": ()}
    assert group_sequences(globs, names) == expected


SIZES = {
    "convex": {
        ("similarity", "normalised"): [0.1, 0.2, 0.6, NAN],
        ("similarity", "m"): [0.1, 0.2, 0.6, NAN],
        ("expected", "normalised"): [0.2, 0.2, 0.2, NAN],
        ("rotation", "deg"): [1.0, 3.0, 50.0, NAN],
    },
    "Ora|cle": {("similarity", "normalised"): [0.05] * 4},
}


def make_report(groups, failures=1):
    summaries = [
        row
        for method, errors in SIZES.items()
        for row in summarise_errors(
            method,
            ("s", "s", "s", "t"),
            {k: np.array(v) for k, v in errors.items()},
            groups,
        )
    ]
    failed = [{"item": f"<b>item{i}", "reason": "no shape"} for i in range(failures)]
    convex = {"name": "convex", "images": 30, "failures": failed, "failed": failures}
    bars = {"method": "convex", "group": next(iter(groups)), "counted": 30}
    bars |= {"inside": (0.4, 0.876), "median_width": {"normalised": 0.3}}
    return {
        "methods": [
            convex,
            {"name": "Ora|cle", "images": 4, "failures": [], "failed": 0},
        ],
        "summaries": summaries,
        "warnings": ["no true\nrotation"],
        "calibration": [bars],
        "landmarks": [],
        "angles": [],
    }


def test_the_few_lines_say_errors_images_and_what_bars_hold():
    assert short_lines(make_report({"all": ("s",)})) == [
        (
            "convex   error aligned 300.0 mean, 200.0 median (mm); rotation 18.0 mean,"
            " 3.0 median (deg); 3 images; 50% bars hold 40%; 90% bars hold 88%;"
            " expected / error 0.67"
        ),
        "Ora|cle  error aligned 0.0500 mean, 0.0500 median (normalised); 3 images",
        "convex   failed: 1 of 30",
    ]


def test_means_over_sequences_say_so_and_angles_have_a_line():
    report = make_report({"all": ("s", "t")})
    assert "; 3 images; 50%" in short_lines(report)[0]  # none of t was measured
    assert "; 4 images, means over 2 sequences" in short_lines(report)[1]
    errors = np.array([[1.0, 4.0], [3.0, NAN], [NAN, 8.0]])
    report["angles"] = [*summarise_parts("convex", ("a", "b"), {"deg": errors})]
    line = "convex   joint angles 4.0 mean (deg); b 6.0"
    assert line in short_lines(report)


def test_parts_that_no_image_has_are_left_out():
    errors = np.array([[1.0, NAN, 4.0], [3.0, NAN, NAN]])
    parts = [*summarise_parts("m", ("a", "b", "c"), {"m": errors})]
    assert [(one.part, one.images, one.mean) for one in parts] == [
        ("a", 2, 2.0),
        ("c", 1, 4.0),
    ]
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


def test_report_csv_has_all_digits_and_error_bars_as_metrics():
    rows = list(csv.DictReader(io.StringIO(report_csv(make_report({"G": ("s", "t")})))))
    means = {
        (r["method"], r["metric"], r["unit"], r["sequence"]): r["mean"] for r in rows
    }
    assert float(means["convex", "similarity", "m", "s"]) == np.mean([0.1, 0.2, 0.6])
    assert means["convex", "similarity", "m", "t"] == ""
    assert means["convex", "inside_90", "share", ""] == "0.876"
    (width,) = [row for row in rows if row["metric"] == "width"]
    assert (width["median"], width["mean"], width["images"]) == ("0.3", "", "30")


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
    assert [number(v, 2) for v in (None, NAN, 0.006, 12.0)] == [
        ABSENT,
        ABSENT,
        "0.01",
        "12.00",
    ]
