"""The tables and the page that an evaluation writes, and what stands in them."""

import json

import numpy as np
import pytest

from shapefit.evaluation import metrics
from shapefit.io import write_shapes

N = 7
FILES = {"per_image.csv", "report.csv", "report.json", "report.md", "report.html", "view.html"}


def test_group_mean_is_the_mean_of_its_sequences_means(desk, truth, results):
    desk.run()
    errors = metrics.similarity(results.shapes, truth.shapes)
    labels = {"method": "convex", "metric": "similarity", "unit": "m"}
    first = desk.row(**labels, group="Subject 13", sequence="13_01")
    group = desk.row(**labels, group="Subject 13", sequence="")
    np.testing.assert_allclose(float(first["mean"]), errors[:4].mean())
    np.testing.assert_allclose(float(group["mean"]), (errors[:4].mean() + errors[4]) / 2)
    assert abs(errors[:5].mean() - float(group["mean"])) > 1e-3
    assert (first["images"], group["images"]) == ("4", "5")


def test_last_outcome_shows_the_table_and_lists_what_was_written(desk):
    judged, written = desk.run()
    assert (judged.done, judged.failures, judged.warnings) == (N, (), ())
    assert {path.name for path in written.written} == FILES
    assert {path.name for path in desk.config.output.iterdir()} == FILES
    assert f"{written.note}\n" == (desk.config.output / "report.md").read_text()
    assert "Subject 13" in written.note


def test_failed_items_are_counted_listed_and_left_out(desk, truth, results):
    shapes = results.shapes.copy()
    shapes[1] = np.nan
    desk.write("convex.h5", results.replaced(shapes=shapes))
    judged, last = desk.run()
    assert [failure.item for failure in judged.failures] == ["item1"]
    assert judged.failures[0].reason.startswith("convex: ")
    assert judged.done == N
    errors = metrics.similarity(results.shapes, truth.shapes)
    row = desk.row(metric="similarity", unit="m", sequence="13_01")
    assert row["images"] == "3"
    np.testing.assert_allclose(float(row["mean"]), errors[[0, 2, 3]].mean())
    (method,) = json.loads((desk.config.output / "report.json").read_text())["methods"]
    assert (method["images"], method["failed"]) == (N, 1)
    assert "item1" in last.note
    failed = [row for row in desk.rows("per_image.csv") if row["item"] == "item1"]
    assert [row["error"] for row in failed] == [""] * 7


def test_several_methods_side_by_side(desk, results):
    desk.write("worse.h5", results.replaced(shapes=-results.shapes))
    methods = {"good": [desk.folder / "convex.h5"], "mirrored": [desk.folder / "worse.h5"]}
    outcomes = desk.run(results=methods)
    assert [outcome.note for outcome in outcomes[:-1]] == ["good", "mirrored"]
    labels = {"metric": "similarity", "unit": "m", "group": "Subject 14", "sequence": ""}
    good, mirrored = (float(desk.row(**labels, method=m)["mean"]) for m in methods)
    assert good < mirrored


def test_csv_results_are_judged_by_shape_alone(desk, results):
    desk.write("table.csv", results)
    judged, last = desk.run(results=[desk.folder / "table.csv"])
    assert len(judged.warnings) == 3
    assert all(warning in last.note for warning in judged.warnings)
    metrics_left = {row["metric"] for row in desk.rows()}
    assert metrics_left == {"similarity"}


def test_without_groups_and_sequences_all_is_one(desk, truth, results):
    write_shapes(desk.folder / "truth.h5", truth.replaced(sequences=None))
    desk.write("convex.h5", results.replaced(sequences=None))
    desk.run(groups={})
    places = {(row["group"], row["sequence"]) for row in desk.rows()}
    assert places == {("all", ""), ("all", "all")}


def test_groups_and_sequences_that_match_nothing_are_said(desk):
    *_, last = desk.run(groups={"Subject 13": "13_*", "Subject 15": "15_*"})
    assert len(last.warnings) == 2
    assert "group Subject 15: no sequence matches '15_*'" in last.warnings
    assert any("14_01" in warning for warning in last.warnings)
    assert all(warning in last.note for warning in last.warnings)


def test_provenance_is_kept(desk):
    desk.run()
    document = json.loads((desk.config.output / "report.json").read_text())
    assert document["config"]["match"] == "item"
    assert set(document["inputs"]) == {
        str(desk.config.truth[0]),
        str(*desk.config.results["convex"]),
    }
    assert all(len(digest) == 64 for digest in document["inputs"].values())


def test_what_the_files_tell_about_solving_is_summed_up(desk, results):
    status = np.array(["optimal"] * 6 + ["iteration limit"], dtype=object)
    told = results.replaced(
        objective=np.arange(7.0),
        status=status,
        attributes={"solve_seconds": 0.014, "method": "convex"},
    )
    desk.write("told.h5", told)
    *_, last = desk.run(
        results={"told": [desk.folder / "told.h5"], "silent": desk.config.results["convex"]}
    )
    told_of, silent = json.loads((desk.config.output / "report.json").read_text())["methods"]
    assert told_of["solving"] == pytest.approx(
        {"mean_objective": 3.0, "milliseconds": 2.0, "solved": 6 / 7}
    )
    assert set(silent["solving"].values()) == {None}
    assert "## Solving" in last.note
    assert "85.71 %" in last.note
