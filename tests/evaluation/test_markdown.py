"""The Markdown page of an evaluation, cell by cell."""

import numpy as np
import pytest

from shapefit.evaluation.calibration import Coverage
from shapefit.evaluation.report import (
    Method,
    Report,
    Solving,
    as_markdown,
    report_blocks,
    short_lines,
)
from shapefit.evaluation.summaries import ImageErrors, summarise

ALL_IMAGES = {"all": ("13_01", "13_02", "14_01")}


def markdown(report):
    return as_markdown(report_blocks(report))


def cells(text, heading):
    """Rows of the first Markdown table below a heading."""
    parts = text.split(f"# {heading}\n\n", maxsplit=1)[1].split("\n\n")
    lines = next(part for part in parts if part.startswith("|")).splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [rows[0], *rows[2:]]


def test_groups_and_methods_stand_down_and_metrics_across(report):
    assert cells(markdown(report), "Errors against the truth") == [
        ["group", "method", "similarity (normalised)"],
        ["Subject 13", "convex", "0.250 / 0.250"],
        ["Subject 13", "admm", "0.300 / 0.300"],
        ["Subject 14", "convex", "–"],
        ["Subject 14", "admm", "0.400 / 0.400"],
    ]


def test_markdown_counts_failures_and_ends_with_what_is_left_out(report):
    text = markdown(report)
    assert [row[:3] for row in cells(text, "Images")[1:]] == [
        ["convex", "3", "1"],
        ["admm", "4", "0"],
    ]
    assert "- convex, d: no estimate" in text
    assert text.endswith("## Left out\n\n- no true rotation\n")


@pytest.mark.parametrize(("failed", "more"), [(10, ""), (11, "1 more"), (25, "15 more")])
def test_many_failures_are_cut_in_the_markdown_only(report, failed, more):
    failures = {f"item{i}": "no estimate" for i in range(failed)}
    text = markdown(Report((Method("convex", (), 30, failures),), report.summaries))
    assert text.count("no estimate") == 10
    assert more in text
    assert bool(more) == (" more, all listed" in text)


def test_how_each_method_solved_is_told_where_the_files_tell_it(report):
    told = (
        Method("convex", (), 4, {}, Solving(0.72912, 0.2731, 0.99999)),
        Method("pmp", (), 4, {}, Solving(None, 12.3456, 1.0)),
        Method("table", (), 4, {}),
    )
    solved = Report(told, report.summaries)
    text = markdown(solved)
    assert [row[3:] for row in cells(text, "Images")] == [
        ["mean objective", "ms per image", "optimal or converged"],
        ["0.729", "0.273", "99.99 %"],
        ["–", "12.3", "100.00 %"],
        ["–", "–", "–"],
    ]


@pytest.mark.parametrize("groups", [ALL_IMAGES, {"Subject 13": ("13_01",)}])
def test_names_cannot_break_the_table(image_errors, groups):
    summaries = tuple(summarise(image_errors("a|b"), groups))
    assert "a\\|b" in markdown(Report((Method("a|b", (), 4, {}),), summaries))


SIZES = {
    ("convex", "similarity", "normalised"): [0.1, 0.2, 0.6],
    ("convex", "similarity", "m"): [0.01, 0.02, 0.06],
    ("convex", "expected", "normalised"): [0.2, 0.2, 0.2],
    ("convex", "rotation", "deg"): [1.0, 3.0, 50.0],
    ("Oracle", "similarity", "normalised"): [0.05, 0.05, 0.05],
}


@pytest.fixture
def whole():
    """A report without groups, on two methods, one of which has error bars."""
    summaries = tuple(
        row
        for kind, values in SIZES.items()
        for row in summarise(ImageErrors(*kind, ("a", "b", "c"), ("all",) * 3, np.array(values)),
                             {"all": ("all",)})
    )  # fmt: skip
    methods = (Method("convex", (), 3, {}), Method("Oracle", (), 4, {"d": "no shape"}))
    bars = (Coverage("convex", "all", 30, (0.4, 0.876), {"normalised": 0.3}),)
    return Report(methods, summaries, coverage=bars)


def test_without_groups_none_are_named(whole):
    text = markdown(whole)
    assert cells(text, "Errors against the truth") == [
        ["method", "similarity (normalised)", "similarity (m)", "expected (normalised)",
         "rotation (deg)"],
        ["convex", "0.300 / 0.200", "0.0300 / 0.0200", "0.200 / 0.200", "18.0 / 3.0"],
        ["Oracle", "0.050 / 0.050", "–", "–", "–"],
    ]  # fmt: skip
    assert cells(text, "Error bars")[1] == ["convex", "30", "40.0 %", "87.6 %", "0.300", "0.67"]


def test_the_few_lines_say_errors_images_and_what_bars_hold(whole):
    assert short_lines(whole) == [
        "convex  error aligned 30.0 mean, 20.0 median (mm); rotation 18.0 mean, 3.0 median (deg); "
        "3 images; 90% bars hold 88%; expected / error 0.67",
        "Oracle  error aligned 0.0500 mean, 0.0500 median (normalised); 3 images",
        "Oracle  failed: 1 of 4",
    ]


def test_names_are_no_html(report):
    tag = "<script>alert(1)</script>"
    text = markdown(Report((Method(tag, (), 1, {"<img src=x>": "a < b"}),), report.summaries))
    assert "<script" not in text
    assert "</script" not in text
    assert "<img" not in text
    assert "&lt;script>alert(1)&lt;/script>" in text
    assert "a < b" in text
