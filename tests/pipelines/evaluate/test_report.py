"""What an evaluation writes: tables, page, pictures, warnings; and what stops it."""

import errno
import json
import sys

import numpy as np
import pytest

from shapefit.config import EvalConfig
from shapefit.errors import InputError
from shapefit.evaluation import metrics
from shapefit.io import atomic, write_shapes
from shapefit.pipelines.evaluate.run import run
from tests.pipelines.told import texts

N = 7
FILES = {"per_image.csv", "report.csv", "report.json", "report.md"}


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
    first, second = written.note.splitlines()
    mean = 1000 * float(
        desk.row(metric="similarity", unit="m", group="Subject 13", sequence="")["mean"]
    )
    assert first.startswith(f"convex  Subject 13  error aligned {mean:.1f} mean, ")
    assert "median (mm); camera frame " in first
    assert second.endswith("; 2 images")


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
    assert last.note.endswith("convex  failed: 1 of 7")
    assert "item1" in (desk.config.output / "report.md").read_text()
    failed = [row for row in desk.rows("per_image.csv") if row["item"] == "item1"]
    assert [row["error"] for row in failed] == [""] * 7


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
    page = (desk.config.output / "report.md").read_text()
    assert all(warning in page for warning in last.warnings)


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
    desk.run(results={"told": [desk.folder / "told.h5"], "silent": desk.config.results["convex"]})
    told_of, silent = json.loads((desk.config.output / "report.json").read_text())["methods"]
    assert told_of["solving"] == pytest.approx(
        {"mean_objective": 3.0, "milliseconds": 2.0, "solved": 6 / 7}
    )
    assert set(silent["solving"].values()) == {None}
    assert "85.71 %" in (desk.config.output / "report.md").read_text()


def test_one_plot_is_drawn(desk):
    *_, last = desk.run(plots=True, metrics=["similarity", "reprojection"])
    assert {path.name for path in last.written} == FILES | {"errors.png"}
    assert {path.name for path in desk.config.output.iterdir()} == FILES | {"errors.png"}


def test_without_matplotlib_nothing_is_written(desk, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(
        InputError, match=r"plots: matplotlib is not installed; .*`pip install matplotlib`"
    ):
        desk.run(plots=True)
    assert not desk.config.output.exists()


def test_by_default_plots_are_left_out_without_matplotlib(desk, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    *_, last = desk.run(plots="auto")
    (warning,) = last.warnings
    assert warning.startswith("no plots: matplotlib is not installed; install it with `pip ")
    written = {path.name for path in desk.config.output.iterdir()}
    assert written == FILES


@pytest.mark.parametrize("kind", ["seen", "unseen"])
def test_truth_that_the_dictionary_was_learned_from_is_a_warning(world, tmp_path, kind):
    truth = world.shapes("people") if kind == "seen" else world.truth("people")
    config = EvalConfig(
        results=[world.fit("people", images=world.views("people", shapes=[str(truth)]))],
        truth=[truth],
        output=tmp_path / "report",
        plots=False,
    )
    said = [text for text in texts(run(config)) if "learned from the truth" in text]
    page = (tmp_path / "report/report.md").read_text(encoding="utf-8")
    if kind == "seen":
        assert f"the dictionary was learned from the truth, {truth}" in said[0]
        assert "learned from the truth" in page
    else:
        assert not said
        assert "learned from the truth" not in page


def test_an_item_in_two_files_of_one_method_is_an_error(desk, results):
    desk.write("again.h5", results.take([3]))
    files = {"convex": [desk.folder / "convex.h5", desk.folder / "again.h5"]}
    with pytest.raises(InputError, match=r"again.h5: has the item 'item3', which .*convex.h5"):
        desk.run(results=files)


@pytest.mark.parametrize(
    "fault", [OSError(errno.ENOSPC, "No space left on device"), OSError("No space left (os 28)")]
)
def test_a_full_disk_is_told_and_replaces_nothing(desk, monkeypatch, fault):
    desk.run()
    old = {path.name: path.read_bytes() for path in desk.config.output.iterdir()}

    def fill(path):
        raise fault

    monkeypatch.setattr(atomic, "_sync", fill)
    with pytest.raises(InputError, match=r"report/per_image.csv: cannot be written: No space left"):
        desk.run(metrics=["similarity"])
    assert {path.name: path.read_bytes() for path in desk.config.output.iterdir()} == old


class TestInputErrors:
    def test_groups_match_no_sequence(self, desk):
        with pytest.raises(InputError, match=r"groups: no sequence matches.*13_01, 13_02, 14_01"):
            desk.run(groups={"Subject 15": "15_*"})
        assert not desk.config.output.exists()


@pytest.mark.parametrize("seconds", [float("nan"), float("inf"), -1.0, "soon"])
def test_a_time_that_is_none_is_unknown(desk, results, seconds):
    desk.write("convex.h5", results.replaced(attributes={"solve_seconds": seconds}))
    desk.run()
    (method,) = json.loads((desk.config.output / "report.json").read_text())["methods"]
    assert method["solving"]["milliseconds"] is None


def test_what_overflows_is_a_failure_of_the_image(desk, results):
    fitted = results.landmarks_fitted.copy()
    fitted[2] = 1e300
    desk.write("convex.h5", results.replaced(landmarks_fitted=fitted))
    outcomes = desk.run(metrics=["similarity", "reprojection"])
    (failure,) = [failure for outcome in outcomes for failure in outcome.failures]
    assert failure.item == "item2"
    assert "reprojection" in failure.reason
