"""Sums over sequences and groups by hand; the tables, the page, the few lines and the
plot.
"""

import csv
import io
from xml.etree import ElementTree

import numpy as np
import pytest
from shapefit.evaluation.plots import (
    AXES_HEIGHT,
    AXES_LEFT,
    AXES_TOP,
    AXES_WIDTH,
    draw_errors,
)

from shapefit.evaluation.report import (
    ABSENT,
    decimals_of,
    group_sequences,
    number,
    report_csv,
    report_markdown,
    short_lines,
    summarise_errors,
)

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
        ("similarity", "m"): [0.01, 0.02, 0.06, NAN],
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
    }


def cells(text, heading):
    """Rows of the first Markdown table below a heading."""
    parts = text.split(f"# {heading}\n\n", maxsplit=1)[1].split("\n\n")
    lines = next(part for part in parts if part.startswith("|")).splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
    return [rows[0], *rows[2:]]


def test_the_page_has_groups_and_methods_down_and_metrics_across():
    text = report_markdown(make_report({"all": ("s",)}), "errors.svg")
    assert cells(text, "Errors against the truth") == [
        [
            "method",
            "images",
            "failed",
            "similarity (normalised)",
            "similarity (m)",
            "expected (normalised)",
            "rotation (deg)",
            "in 50% bars (%)",
            "in 90% bars (%)",
            "width (normalised)",
            "expected / error",
        ],
        [
            "convex",
            "3",
            "0",
            "0.300 / 0.200",
            "0.0300 / 0.0200",
            "0.200 / 0.200",
            "18.0 / 3.0",
            "40.0",
            "87.6",
            "0.300",
            "0.667",
        ],
        ["Ora\\|cle", "3", "0", "0.050 / 0.050", *["–"] * 7],
    ]
    assert "- convex, &lt;b>item0: no shape" in text  # names are no HTML
    assert "- no true rotation\n" in text
    assert text.endswith("![errors, sorted](errors.svg)\n")
    grouped = report_markdown(make_report({"S": ("s",), "T": ("t",)}))
    assert [row[:5] for row in cells(grouped, "Errors against the truth")[1:]] == [
        ["S", "convex", "3", "0", "0.300 / 0.200"],
        ["S", "Ora\\|cle", "3", "0", "0.050 / 0.050"],
        ["T", "convex", "0", "1", "–"],
        ["T", "Ora\\|cle", "1", "0", "0.050 / 0.050"],
    ]


def test_the_few_lines_say_errors_images_and_what_bars_hold():
    assert short_lines(make_report({"all": ("s",)})) == [
        (
            "convex   error aligned 30.0 mean, 20.0 median (mm); rotation 18.0 mean,"
            " 3.0 median (deg); 3 images; 50% bars hold 40%; 90% bars hold 88%;"
            " expected / error 0.67"
        ),
        "Ora|cle  error aligned 0.0500 mean, 0.0500 median (normalised); 3 images",
        "convex   failed: 1 of 30",
    ]


def test_report_csv_has_all_digits_and_error_bars_as_metrics():
    rows = list(csv.DictReader(io.StringIO(report_csv(make_report({"G": ("s", "t")})))))
    means = {
        (r["method"], r["metric"], r["unit"], r["sequence"]): r["mean"] for r in rows
    }
    assert float(means["convex", "similarity", "m", "s"]) == np.mean([0.01, 0.02, 0.06])
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


def test_the_plot_has_a_line_a_method_and_ends_early_where_images_failed():
    values = np.array([3.0, 1.0, 6.0, 5.0, NAN])
    errors = {"a<b": values, "b": values + 1, "none": np.full(5, NAN)}
    text = draw_errors("3D error", "m", errors)
    root = ElementTree.fromstring(text)
    lines = [line.get("points").split() for line in root.findall(".//{*}polyline")]
    assert [len(line) for line in lines] == [4, 4, 0]
    first = np.array([point.split(",") for point in lines[0]], float)
    np.testing.assert_allclose(
        first[:, 0], AXES_LEFT + AXES_WIDTH * np.array([0.1, 0.3, 0.5, 0.7])
    )
    heights = AXES_TOP + AXES_HEIGHT * (1 - np.array([1, 3, 5, 6]) / 7)
    np.testing.assert_allclose(first[:, 1], heights, atol=0.06)
    texts = [each.text for each in root.findall(".//{*}text")]
    assert {"3D error", "error (m)", "a<b", "b", "none", "0", "7", "100"} <= set(texts)
    assert draw_errors("3D error", "m", {"none": np.full(5, NAN)}).endswith("</svg>\n")
