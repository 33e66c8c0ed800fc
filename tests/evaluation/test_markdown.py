"""The Markdown page of an evaluation, cell by cell."""

import numpy as np
import pytest

from shapefit.evaluation.report import Method, Report, Solving, as_markdown, report_blocks
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


def test_groups_stand_down_and_methods_across(report):
    assert cells(markdown(report), "similarity (normalised)") == [
        ["", "convex", "admm"],
        ["Subject 13", "0.250", "0.300"],
        ["Subject 14", "–", "0.400"],
    ]


def test_markdown_counts_failures_and_ends_with_what_is_left_out(report):
    text = markdown(report)
    assert cells(text, "Images")[1:] == [["convex", "3", "1"], ["admm", "4", "0"]]
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
    assert "Objectives of different models cannot be compared" in text
    assert cells(text, "Solving") == [
        ["method", "mean objective", "ms per image", "images/s", "optimal or converged"],
        ["convex", "0.729", "0.273", "3662", "99.99 %"],
        ["pmp", "–", "12.3", "81", "100.00 %"],
        ["table", "–", "–", "–", "–"],
    ]


@pytest.mark.parametrize("groups", [ALL_IMAGES, {"Subject 13": ("13_01",)}])
def test_names_cannot_break_the_table(image_errors, groups):
    summaries = tuple(summarise(image_errors("a|b"), groups))
    assert "a\\|b" in markdown(Report((), summaries))


class TestWithoutGroups:
    """One table: methods down, mean / median of all metrics across."""

    @pytest.fixture
    def summaries(self):
        sequences, items = ("all",) * 3, ("a", "b", "c")
        errors = [
            ("convex", "similarity", "normalised", [0.1, 0.2, 0.6]),
            ("convex", "rotation", "deg", [1.0, 3.0, 50.0]),
            ("Oracle", "similarity", "normalised", [0.05, 0.05, 0.05]),
        ]
        return tuple(
            row
            for *kind, values in errors
            for row in summarise(
                ImageErrors(*kind, items, sequences, np.array(values)), {"all": ("all",)}
            )
        )

    @pytest.fixture
    def methods(self):
        return (Method("convex", (), 3, {}, Solving(0.7, 0.25, 1.0)),)

    def test_means_stand_beside_medians_and_the_speed_beside_both(self, methods, summaries):
        assert cells(markdown(Report(methods, summaries)), "Errors against the truth") == [
            ["method", "similarity (normalised)", "rotation (deg)", "ms per image", "images/s"],
            ["convex", "0.300 / 0.200", "18.0 / 3.0", "0.25", "4000"],
            ["Oracle", "0.050 / 0.050", "–", "–", "–"],
        ]


def test_names_are_no_html(report):
    tag = "<script>alert(1)</script>"
    text = markdown(Report((Method(tag, (), 1, {"<img src=x>": "a < b"}),), report.summaries))
    assert "<script" not in text
    assert "</script" not in text
    assert "<img" not in text
    assert "&lt;script>alert(1)&lt;/script>" in text
    assert "a < b" in text
