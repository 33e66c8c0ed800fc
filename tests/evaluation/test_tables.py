"""The written tables, cell by cell."""

import csv
import json

import numpy as np
import pytest

from shapefit.evaluation import tables
from shapefit.evaluation.report import Method, Report
from shapefit.evaluation.solving import Solving
from shapefit.evaluation.summary import ImageErrors, summarise

NAN = float("nan")
GROUPING = {"Subject 13": ("13_01", "13_02"), "Subject 14": ("14_01",)}
SEQUENCES = ("13_01", "13_01", "13_02", "14_01")
ITEMS = ("a", "b", "c", "d")


def image_errors(method="convex", values=(0.1, 0.2, 0.35, NAN), unit="normalised"):
    return ImageErrors(method, "similarity", unit, ITEMS, SEQUENCES, np.array(values))


@pytest.fixture
def errors():
    return [image_errors(), image_errors("admm", (0.3, 0.3, 0.3, 0.4))]


@pytest.fixture
def report(errors):
    return Report(
        methods=(
            Method("convex", ("one.h5",), 4, {"d": "no estimate"}),
            Method("admm", ("two.h5",), 4, {}),
        ),
        summaries=tuple(row for e in errors for row in summarise(e, GROUPING)),
        published={"Convex, paper": {"Subject 13": 0.259, "Subject 15": 0.204}},
        caveats=("other frames than the paper's",),
        warnings=("no true rotation",),
    )


def rows_of(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def cells(text, heading):
    """Rows of the first Markdown table below a heading."""
    lines = text.split(f"## {heading}\n\n")[1].split("\n\n")[0].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [rows[0], *rows[2:]]


def test_per_image_lists_every_image_the_failed_one_without_error(tmp_path, errors):
    tables.write_per_image(tmp_path / "per_image.csv", errors)
    header, *rows = rows_of(tmp_path / "per_image.csv")
    assert header == ["method", "sequence", "item", "metric", "error", "unit"]
    assert rows[0] == ["convex", "13_01", "a", "similarity", "0.1", "normalised"]
    assert rows[3] == ["convex", "14_01", "d", "similarity", "", "normalised"]
    assert len(rows) == 8


def test_report_csv_has_group_rows_without_sequence(tmp_path, report):
    tables.write_report_csv(tmp_path / "report.csv", report.summaries)
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


def test_csv_keeps_all_digits(tmp_path):
    value = 0.1 + 0.2
    tables.write_per_image(tmp_path / "per_image.csv", [image_errors(values=(value,) * 4)])
    assert float(rows_of(tmp_path / "per_image.csv")[1][4]) == value


def test_json_counts_and_lists_failures(report):
    document = json.loads(tables.report_json(report))
    convex, admm = document["methods"]
    assert (convex["images"], convex["failed"], admm["failed"]) == (4, 1, 0)
    assert convex["failures"] == [{"item": "d", "reason": "no estimate"}]
    assert document["published"] == {"Convex, paper": {"Subject 13": 0.259, "Subject 15": 0.204}}
    assert document["caveats"] == ["other frames than the paper's"]
    failed = next(s for s in document["summaries"] if s["sequence"] == "14_01")
    assert (failed["mean"], failed["failed"]) == (None, 1)


def test_markdown_sets_published_columns_beside_ours(report):
    assert cells(tables.markdown(report), "similarity (normalised)") == [
        ["", "convex", "admm", "*Convex, paper*"],
        ["Subject 13", "0.250", "0.300", "0.259"],
        ["Subject 14", "–", "0.400", "–"],
        ["Subject 15", "–", "–", "0.204"],
    ]


def test_published_numbers_stay_with_their_metric_and_unit(report):
    other = [image_errors(unit="m")]
    summaries = tuple(row for e in other for row in summarise(e, GROUPING))
    text = tables.markdown(Report(report.methods, summaries, report.published))
    assert "paper" not in text


def test_markdown_counts_failures_and_ends_with_the_caveats(report):
    text = tables.markdown(report)
    assert cells(text, "Images")[1:] == [["convex", "3", "1"], ["admm", "4", "0"]]
    assert "- convex, d: no estimate" in text
    assert "- no true rotation" in text
    assert text.endswith("## Caveats\n\n- other frames than the paper's\n")


def test_many_failures_are_cut_in_the_markdown_only(report):
    failures = {f"item{i}": "no estimate" for i in range(25)}
    many = Report((Method("convex", (), 30, failures),), report.summaries)
    text = tables.markdown(many)
    assert text.count("no estimate") == 10
    assert "15 more" in text
    assert len(json.loads(tables.report_json(many))["methods"][0]["failures"]) == 25


def test_how_each_method_solved_is_told_where_the_files_tell_it(report):
    told = (
        Method("convex", (), 4, {}, Solving(0.72912, 0.2731, 0.99999)),
        Method("pmp", (), 4, {}, Solving(None, 12.3456, 1.0)),
        Method("table", (), 4, {}),
    )
    solved = Report(told, report.summaries)
    text = tables.markdown(solved)
    section = text.split("## Solving\n\n")[1]
    assert "Objectives of different models cannot be compared" in section.split("\n\n")[0]
    assert cells(section.replace(section.split("\n\n")[0], "## T", 1), "T") == [
        ["method", "mean objective", "ms an image", "optimal or converged"],
        ["convex", "0.729", "0.273", "99.99 %"],
        ["pmp", "–", "12.3", "100.00 %"],
        ["table", "–", "–", "–"],
    ]
    methods = json.loads(tables.report_json(solved))["methods"]
    assert methods[0]["solving"] == {
        "mean_objective": 0.72912,
        "milliseconds": 0.2731,
        "solved": 0.99999,
    }
    assert methods[2]["solving"] == dict.fromkeys(methods[0]["solving"])


def test_without_any_word_on_solving_there_is_no_such_section(report):
    assert "Solving" not in tables.markdown(report)


def test_names_cannot_break_the_table(report):
    summaries = summarise(image_errors("a|b"), GROUPING)
    first = tables.markdown(Report((), tuple(summaries))).split("\n\n")[3].splitlines()[0]
    assert "a\\|b" in first


@pytest.mark.parametrize(
    ("value", "printed"),
    [(0.2594, "0.259"), (1.25, "1.250"), (40.26, "40.3"), (0.00123, "0.00123"), (0.0, "0.000")],
)
def test_digits_suit_the_size_of_the_numbers(value, printed):
    summaries = summarise(image_errors(values=(value,) * 4), {"all": ("14_01",)})
    text = tables.markdown(Report((), tuple(summaries)))
    assert cells(text, "similarity (normalised)")[1] == ["all", printed]
