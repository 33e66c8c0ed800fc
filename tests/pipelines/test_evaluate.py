"""The eval command's work: result files in, a folder of tables and plots out."""

import csv
import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from shapefit.config import EvalConfig
from shapefit.errors import InputError
from shapefit.evaluation import metrics, tables
from shapefit.geometry.rotations import random_rotations
from shapefit.io import open_landmarks, read_shapes, result_writer, write_shapes
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.pipelines import evaluate
from shapefit.pipelines.evaluate import run

NAMES = ("head", "left", "right", "foot", "hand")
SEQUENCES = ("13_01",) * 4 + ("13_02",) + ("14_01",) * 2
N = len(SEQUENCES)
GROUPS = {"Subject 13": "13_*", "Subject 14": "14_*"}
FILES = {"per_image.csv", "report.csv", "report.json", "report.md"}


def write_results(path, records):
    with result_writer(path) as out:
        out.append(records)


@pytest.fixture
def truth(rng):
    return ShapeSet(
        shapes=rng.standard_normal((N, 3, 5)),
        landmark_names=NAMES,
        items=tuple(f"item{i}" for i in range(N)),
        sequences=SEQUENCES,
        unit="m",
    )


@pytest.fixture
def results(truth, rng):
    R = random_rotations(N, rng)
    shapes = R @ truth.shapes + 0.2 * rng.standard_normal(truth.shapes.shape)
    return ResultSet(
        shapes=shapes,
        landmarks_fitted=shapes[:, :2],
        rotation=R,
        landmark_names=NAMES,
        items=truth.items,
        sequences=SEQUENCES,
        unit="m",
        extras={"true_rotation": R, "landmarks": (R @ truth.shapes)[:, :2].swapaxes(-1, -2)},
    )


@pytest.fixture
def config(tmp_path, truth, results):
    write_shapes(tmp_path / "truth.h5", truth)
    write_results(tmp_path / "convex.h5", results)
    return EvalConfig(
        results=[tmp_path / "convex.h5"],
        truth=[tmp_path / "truth.h5"],
        output=tmp_path / "report",
        groups=GROUPS,
        plots=False,
    )


def changed(config, **changes):
    return EvalConfig(**{**config.model_dump(), **changes})


def rows_of(folder, name):
    with (folder / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def cell(rows, **labels):
    (row,) = (row for row in rows if all(row[key] == value for key, value in labels.items()))
    return row


def test_group_mean_is_the_mean_of_its_sequences_means(config, truth, results):
    list(run(config))
    errors = metrics.similarity(results.shapes, truth.shapes)
    rows = rows_of(config.output, "report.csv")
    labels = {"method": "convex", "metric": "similarity", "unit": "m"}
    first = cell(rows, **labels, group="Subject 13", sequence="13_01")
    group = cell(rows, **labels, group="Subject 13", sequence="")
    np.testing.assert_allclose(float(first["mean"]), errors[:4].mean())
    np.testing.assert_allclose(float(group["mean"]), (errors[:4].mean() + errors[4]) / 2)
    assert abs(errors[:5].mean() - float(group["mean"])) > 1e-3
    assert (first["images"], group["images"]) == ("4", "5")


def test_last_outcome_shows_the_table_and_lists_what_was_written(config):
    judged, written = run(config)
    assert (judged.done, judged.failures, judged.warnings) == (N, (), ())
    assert {path.name for path in written.written} == FILES
    assert {path.name for path in config.output.iterdir()} == FILES
    assert f"{written.note}\n" == (config.output / "report.md").read_text()
    assert "Subject 13" in written.note


def test_per_image_has_a_row_for_every_metric_and_unit(config):
    list(run(config))
    rows = rows_of(config.output, "per_image.csv")
    assert len(rows) == 6 * N
    kinds = {(row["metric"], row["unit"]) for row in rows}
    assert kinds == {
        ("similarity", "normalised"),
        ("similarity", "m"),
        ("camera", "normalised"),
        ("camera", "m"),
        ("rotation", "deg"),
        ("reprojection", "m"),
    }
    row = cell(rows, item="item4", metric="rotation")
    assert (row["sequence"], row["method"]) == ("13_02", "convex")
    assert float(row["error"]) < 1e-4


def test_published_rows_and_caveats_stand_beside_ours(config):
    published = {"Convex (paper)": {"Subject 13": 0.259}}
    *_, last = run(changed(config, published=published, caveats=["Other frames than theirs."]))
    header = next(line for line in last.note.splitlines() if "paper" in line)
    row = next(line for line in last.note.splitlines() if "0.259" in line)
    assert "convex" in header
    assert row.startswith("| Subject 13 |")
    assert "- Other frames than theirs." in last.note
    document = json.loads((config.output / "report.json").read_text())
    assert document["published"] == published


def test_failed_items_are_counted_listed_and_left_out(config, truth, results, tmp_path):
    shapes = results.shapes.copy()
    shapes[1] = np.nan
    write_results(tmp_path / "convex.h5", replace(results, shapes=shapes))
    judged, last = run(config)
    assert [failure.item for failure in judged.failures] == ["item1"]
    assert judged.failures[0].reason.startswith("convex: ")
    assert judged.done == N
    errors = metrics.similarity(results.shapes, truth.shapes)
    row = cell(
        rows_of(config.output, "report.csv"), metric="similarity", unit="m", sequence="13_01"
    )
    assert row["images"] == "3"
    np.testing.assert_allclose(float(row["mean"]), errors[[0, 2, 3]].mean())
    (method,) = json.loads((config.output / "report.json").read_text())["methods"]
    assert (method["images"], method["failed"]) == (N, 1)
    assert "item1" in last.note
    failed = [row for row in rows_of(config.output, "per_image.csv") if row["item"] == "item1"]
    assert [row["error"] for row in failed] == [""] * 6


def test_items_without_truth_are_failures(config, truth, tmp_path):
    write_shapes(tmp_path / "truth.h5", truth.take([0, 1, 2, 3, 4, 5]))
    judged, last = run(config)
    assert [failure.item for failure in judged.failures] == ["item6"]
    assert "item6" in last.note


def test_several_methods_side_by_side(config, results, tmp_path):
    write_results(tmp_path / "worse.h5", replace(results, shapes=-results.shapes))
    methods = {"good": [tmp_path / "convex.h5"], "mirrored": [tmp_path / "worse.h5"]}
    outcomes = list(run(changed(config, results=methods)))
    assert [outcome.note for outcome in outcomes[:-1]] == ["good", "mirrored"]
    rows = rows_of(config.output, "report.csv")
    labels = {"metric": "similarity", "unit": "m", "group": "Subject 14", "sequence": ""}
    good, mirrored = (float(cell(rows, **labels, method=m)["mean"]) for m in methods)
    assert good < mirrored


def test_files_of_one_method_are_joined(config, results, tmp_path):
    list(run(config))
    whole = rows_of(config.output, "report.csv")
    write_results(tmp_path / "a.h5", results.take([0, 1, 5]))
    write_results(tmp_path / "b.h5", results.take([2, 3, 4, 6]))
    files = {"convex": [tmp_path / "a.h5", tmp_path / "b.h5"]}
    list(run(changed(config, results=files)))
    for row in whole:
        kind = {key: row[key] for key in ("metric", "unit", "group", "sequence")}
        other = cell(rows_of(config.output, "report.csv"), **kind)
        assert other["images"] == row["images"]
        np.testing.assert_allclose(float(other["mean"]), float(row["mean"]))


def test_an_item_in_two_files_of_one_method_is_an_error(config, results, tmp_path):
    write_results(tmp_path / "again.h5", results.take([3]))
    files = {"convex": [tmp_path / "convex.h5", tmp_path / "again.h5"]}
    with pytest.raises(InputError, match=r"again.h5: has the item 'item3', which .*convex.h5"):
        list(run(changed(config, results=files)))


def test_csv_results_are_judged_by_shape_alone(config, results, tmp_path):
    write_results(tmp_path / "table.csv", results)
    judged, last = run(changed(config, results=[tmp_path / "table.csv"]))
    assert len(judged.warnings) == 3
    assert all(warning in last.note for warning in judged.warnings)
    metrics_left = {row["metric"] for row in rows_of(config.output, "report.csv")}
    assert metrics_left == {"similarity"}


def test_without_groups_and_sequences_all_is_one(config, truth, results, tmp_path):
    write_shapes(tmp_path / "truth.h5", replace(truth, sequences=None))
    write_results(tmp_path / "convex.h5", replace(results, sequences=None))
    list(run(changed(config, groups={})))
    places = {(row["group"], row["sequence"]) for row in rows_of(config.output, "report.csv")}
    assert places == {("all", ""), ("all", "all")}


def test_groups_and_sequences_that_match_nothing_are_said(config):
    *_, last = run(changed(config, groups={"Subject 13": "13_*", "Subject 15": "15_*"}))
    assert len(last.warnings) == 2
    assert "group Subject 15: no sequence matches '15_*'" in last.warnings
    assert any("14_01" in warning for warning in last.warnings)
    assert all(warning in last.note for warning in last.warnings)


def test_provenance_is_kept(config):
    list(run(config))
    document = json.loads((config.output / "report.json").read_text())
    assert document["config"]["match"] == "item"
    assert set(document["inputs"]) == {str(config.truth[0]), str(*config.results["convex"])}
    assert all(len(digest) == 64 for digest in document["inputs"].values())


def test_plots_are_drawn_for_every_metric(config):
    *_, last = run(changed(config, plots=True, metrics=["similarity", "reprojection"]))
    names = ("similarity", "similarity_boxes", "reprojection", "reprojection_boxes")
    drawn = {f"{name}.{e}" for name in names for e in ("png", "svg")}
    assert {path.name for path in last.written} == FILES | drawn
    assert {path.name for path in config.output.iterdir()} == FILES | drawn


def test_boxes_are_those_of_the_normalised_errors_of_the_groups(config, monkeypatch):
    asked = []
    draw = evaluate.box_plot
    monkeypatch.setattr(evaluate, "box_plot", lambda *a: asked.append(a) or draw(*a))
    list(run(changed(config, plots=True)))
    kinds = [(e.metric, e.unit) for (e,), _ in asked]
    assert kinds == [
        ("similarity", "normalised"),
        ("camera", "normalised"),
        ("rotation", "deg"),
        ("reprojection", "m"),
    ]
    assert asked[0][1] == {"Subject 13": ("13_01", "13_02"), "Subject 14": ("14_01",)}


def test_what_the_files_tell_about_solving_is_summed_up(config, results, tmp_path):
    status = np.array(["optimal"] * 6 + ["iteration limit"], dtype=object)
    told = replace(
        results,
        objective=np.arange(7.0),
        status=status,
        attributes={"solve_seconds": 0.014, "method": "convex"},
    )
    write_results(tmp_path / "told.h5", told)
    *_, last = run(
        changed(
            config, results={"told": [tmp_path / "told.h5"], "silent": config.results["convex"]}
        )
    )
    told_of, silent = json.loads((config.output / "report.json").read_text())["methods"]
    assert told_of["solving"] == pytest.approx(
        {"mean_objective": 3.0, "milliseconds": 2.0, "solved": 6 / 7}
    )
    assert set(silent["solving"].values()) == {None}
    assert "## Solving" in last.note
    assert "85.71 %" in last.note


class TestExamples:
    @pytest.fixture(autouse=True)
    def edges(self, config, truth, tmp_path):
        write_shapes(tmp_path / "truth.h5", replace(truth, edges=np.array([[0, 1], [1, 3]])))

    def test_they_are_drawn_for_methods_by_name(self, config, results, tmp_path):
        write_results(tmp_path / "b.h5", results)
        files = {"Convex": [tmp_path / "convex.h5"], "Alternate": [tmp_path / "b.h5"]}
        *_, last = run(changed(config, results=files, plots=True, examples=["item3", "item5"]))
        assert {path.name for path in last.written} >= {"examples.png", "examples.svg"}
        assert (config.output / "examples.png").read_bytes().startswith(b"\x89PNG")
        svg = (config.output / "examples.svg").read_text()
        shown = {line.strip() for line in svg.splitlines() if line.strip().startswith("<!--")}
        words = {"landmarks", "truth", "Convex", "Alternate", "item3", "item5"}
        assert {f"<!-- {word} -->" for word in words} <= shown

    @pytest.mark.parametrize("keys", [{"plots": False}, {"examples": 0}, {"examples": []}])
    def test_they_are_not_drawn_unasked(self, config, keys):
        *_, last = run(changed(config, **{"plots": True, "examples": 2, **keys}))
        assert not any(path.name.startswith("examples") for path in last.written)

    def test_without_edges_nothing_is_read_or_written(self, config, truth, tmp_path):
        write_shapes(tmp_path / "truth.h5", truth)
        with pytest.raises(InputError, match=r"truth\.h5: has no edges"):
            next(run(changed(config, plots=True, examples=1)))
        assert not config.output.exists()

    def test_an_unknown_item_leaves_no_report(self, config):
        with pytest.raises(InputError, match="'item9'"):
            list(run(changed(config, plots=True, examples=["item9"])))
        assert not config.output.exists()


def test_without_matplotlib_nothing_is_written(config, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match=r"shapefit\[plots\]"):
        list(run(changed(config, plots=True)))
    assert not config.output.exists()


def test_a_crash_while_writing_leaves_old_files_and_no_half_ones(config, monkeypatch):
    list(run(config))
    old = {path.name: path.read_bytes() for path in config.output.iterdir()}

    def crash(report):
        raise RuntimeError("crashed")

    monkeypatch.setattr(tables, "report_json", crash)
    with pytest.raises(RuntimeError):
        list(run(changed(config, metrics=["similarity"])))
    assert {path.name for path in config.output.iterdir()} == set(old)
    assert (config.output / "report.json").read_bytes() == old["report.json"]
    assert (config.output / "report.md").read_bytes() == old["report.md"]


class TestInputErrors:
    def test_groups_match_no_sequence(self, config):
        with pytest.raises(InputError, match=r"groups: no sequence matches.*13_01, 13_02, 14_01"):
            list(run(changed(config, groups={"Subject 15": "15_*"})))
        assert not config.output.exists()

    def test_results_of_other_items(self, config, results, tmp_path):
        write_results(tmp_path / "convex.h5", replace(results, items=tuple("abcdefg")))
        with pytest.raises(InputError, match="none of its 7 images is in the truth"):
            list(run(config))
        assert not config.output.exists()

    def test_output_is_a_file(self, config, tmp_path):
        (tmp_path / "report").write_text("kept")
        with pytest.raises(InputError, match="report: it is not a folder"):
            next(run(config))
        assert (tmp_path / "report").read_text() == "kept"

    def test_folder_of_the_output_is_missing(self, config, tmp_path):
        with pytest.raises(InputError, match="does not exist"):
            next(run(changed(config, output=tmp_path / "none" / "report")))

    def test_output_is_standard_output(self, config):
        with pytest.raises(InputError, match="folder"):
            next(run(changed(config, output="-")))


@pytest.mark.real_data
def test_real_cars_are_matched_by_their_model(real_data, tmp_path):
    with open_landmarks([real_data / "cars" / "annotated_cars.h5"]) as source:
        cars = next(source.chunks(300))
    models = read_shapes([real_data / "cars" / "models.h5"])
    rows = [models.items.index(model) for model in cars.extras["true_model"]]
    R = np.asarray(cars.extras["true_rotation"], dtype=float)
    perfect = ResultSet(
        shapes=50 * R @ models.shapes[rows],
        landmarks_fitted=cars.landmarks + np.array([[3.0], [4.0]]),
        rotation=R,
        landmark_names=cars.landmark_names,
        items=cars.items,
        unit=cars.unit,
        y_axis=cars.y_axis,
        extras={**cars.extras, "landmarks": cars.landmarks.swapaxes(-1, -2)},
    )
    write_results(tmp_path / "cars.h5", perfect)
    config = EvalConfig(
        results=[tmp_path / "cars.h5"],
        truth=[real_data / "cars" / "models.h5"],
        output=tmp_path / "report",
        match="true_model",
        plots=False,
    )
    judged, _ = run(config)
    assert (judged.failures, judged.warnings) == ((), ())
    for row in rows_of(tmp_path / "report", "report.csv"):
        expected = 5.0 if row["metric"] == "reprojection" else 0.0
        np.testing.assert_allclose(float(row["mean"]), expected, atol=1e-4)
