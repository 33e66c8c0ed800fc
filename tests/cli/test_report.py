"""Outcomes fold into a report of bounded size."""

from pathlib import Path

from shapefit.cli.report import LISTED, Report

from shapefit.pipelines.outcome import Counted, Failure, Outcome


def folded(*outcomes: Outcome) -> Report:
    report = Report("fit", "image")
    for outcome in outcomes:
        report.add(outcome)
    return report


def test_the_exit_code_tells_failed_items():
    assert folded().exit_code == 0
    assert folded(Outcome(done=3, warnings=("odd",))).exit_code == 0
    assert folded(Outcome(done=1, failures=(Failure("a", "b"),)), Outcome(done=1)).exit_code == 1


def test_the_order_of_outcomes_does_not_matter_for_the_counts():
    outcomes = [Outcome(done=n, failures=(Failure(str(n), "x"),) * n) for n in range(5)]
    forwards, backwards = folded(*outcomes), folded(*reversed(outcomes))
    assert (forwards.done, forwards.failed) == (backwards.done, backwards.failed) == (10, 10)


def test_a_repeated_warning_is_printed_once():
    lines = list(folded(*[Outcome(warnings=("odd",))] * 3, Outcome(warnings=("even",))).lines())
    assert lines[:2] == ["Warning: odd", "Warning: even"]


def test_the_numbers_of_a_warning_are_added_up_over_the_run():
    parts = [(128, 0.2, "a"), (13, 0.7, "b"), (1, 0.1, "c")]
    counts = [
        Outcome(warnings=(Counted(number, "image", "not optimal", worst, severity),))
        for number, severity, worst in parts
    ]
    empty = Outcome(warnings=(Counted(1, "image", "with an empty shape"),))
    *lines, _ = folded(counts[0], empty, *counts[1:]).lines()
    assert lines == [
        "Warning: 142 images not optimal, the worst: b",
        "Warning: 1 image with an empty shape",
    ]


def test_a_quiet_report_has_failures_only():
    outcome = Outcome(done=2, failures=(Failure("a", "b"),), warnings=("odd",), note="n")
    report = Report("fit", "image", quiet=True)
    report.add(outcome)
    assert list(report.lines()) == ["Failed: a: b"]


def test_a_verbose_report_lists_everything(tmp_path):
    report = Report("fit", "image", verbose=True)
    for n in range(LISTED + 7):
        report.add(Outcome(failures=(Failure(f"i{n}", "x"),), warnings=(f"w{n}",)))
    report.add(Outcome(written=tuple(tmp_path / name for name in "abcd")))
    *lines, summary = report.lines()
    assert len(lines) == 2 * (LISTED + 7)
    assert summary.count(str(tmp_path)) == 4


def test_the_unit_is_that_of_the_outcomes():
    *_, summary = folded(Outcome(done=34, unit="shape")).lines()
    assert summary.startswith("fit: 34 shapes in ")


def test_many_failures_and_warnings_are_counted_and_not_kept():
    outcomes = [
        Outcome(failures=(Failure(f"i{n}", "x"),), warnings=(f"w{n}",)) for n in range(LISTED + 7)
    ]
    report = folded(*outcomes)
    lines = list(report.lines())
    assert lines.count("Warning: and 7 more") == lines.count("Failed: and 7 more") == 1
    assert len(lines) == 2 * (LISTED + 1) + 1
    assert report.failed == LISTED + 7


def test_the_last_note_that_says_something_is_told():
    report = folded(Outcome(note="a"), Outcome(note="b"), Outcome())
    assert report.note == "b"
    assert [line.split("; ")[1:] for line in report.lines()] == [["b"]]
    report.prints_note = True
    assert [line.split("; ")[1:] for line in report.lines()] == [[]]


def test_written_files_are_named_from_the_working_folder(tmp_path, monkeypatch):
    inside = tmp_path / "here"
    inside.mkdir()
    monkeypatch.chdir(inside)
    outcome = Outcome(written=(inside / "a.h5", tmp_path / "b.h5", Path("-")))
    *_, summary = folded(outcome).lines()
    assert summary.endswith(f"; wrote a.h5, {tmp_path / 'b.h5'}, standard output")


def test_many_files_in_one_folder_are_counted(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    files = tuple(tmp_path / "report" / f"{name}.csv" for name in "abcdefghi")
    summary = next(folded(Outcome(written=files)).lines())
    assert summary.endswith(f"; wrote 9 files in {tmp_path}/report")
    apart = (*files, tmp_path / "e.csv")
    assert next(folded(Outcome(written=apart)).lines()).endswith("report/i.csv, e.csv")
