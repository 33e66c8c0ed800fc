"""The sweep command's work: the chain over the values of one key, on the people of sample_data."""

import csv
import json
import shutil
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.config import EvalConfig, FitConfig, LearnDictConfig, ProjectConfig, load_config
from shapefit.errors import InputError
from shapefit.io import read_dictionary, read_results
from shapefit.pipelines import projection as project
from shapefit.pipelines.evaluate import run as evaluate
from shapefit.pipelines.fit import run as fit
from shapefit.pipelines.learn_dict import run as learn_dict
from shapefit.pipelines.sweeps import run
from tests.io.files import load
from tests.pipelines.told import done, warnings

PEOPLE = Path(__file__).resolve().parents[2] / "sample_data"
TRUTH = PEOPLE / "people_test.h5"
LEARNING = {"shapes": str(PEOPLE / "people_train.h5"), "k": 8, "iterations": 1, "every": 10}
REPORT = {"per_image.csv", "sweep.csv", "sweep.json", "sweep.md", "work"}  # fmt: skip


@pytest.fixture
def sweep(tmp_path):
    """Return what loads a sweep over one key and runs it; it gives its outcomes and its rows."""

    def start(vary, **settings):
        arguments = {
            "learn_dict": LEARNING,
            "project": {"shapes": str(TRUTH)},
            "fit": {},
            "truth": str(TRUTH),
            "every": 16,
            "vary": vary,
            "output": str(tmp_path / "out"),
            "plots": False,
        }
        config = load_config("sweep", arguments=arguments | settings)
        outcomes = list(run(config))
        with (config.output / "sweep.csv").open(newline="", encoding="utf-8") as file:
            return outcomes, list(csv.DictReader(file))

    return start


def means(rows):
    return [float(row["mean"]) for row in rows]


def test_the_rows_are_what_the_commands_find_one_by_one(sweep, tmp_path):
    _, rows = sweep({"fit.lambda": [0.1, 1.5]}, every=1)
    dictionary, views = tmp_path / "dictionary.h5", tmp_path / "views.h5"
    result, report = tmp_path / "result.h5", tmp_path / "report"
    truth = (TRUTH,)
    settings = LEARNING | {"shapes": (LEARNING["shapes"],)}
    list(learn_dict.run(LearnDictConfig(**settings, output=dictionary)))
    list(project.run(ProjectConfig(shapes=truth, output=views)))
    for row in rows:
        lam = float(row["value"])
        list(fit.run(FitConfig(landmarks=(views,), dictionary=dictionary, output=result, lam=lam)))
        list(
            evaluate.run(
                EvalConfig(results={"it": (result,)}, truth=truth, output=report, plots=False)
            )
        )
        summaries = json.loads((report / "report.json").read_text("utf-8"))["summaries"]
        (own,) = (
            s
            for s in summaries
            if (s["metric"], s["unit"], s["sequence"]) == ("similarity", "normalised", None)
        )
        assert (row["key"], row["group"]) == ("fit.lambda", "all")
        assert int(row["images"]) == own["images"]
        for statistic in ("mean", "median", "p90"):
            assert float(row[statistic]) == pytest.approx(own[statistic], rel=1e-9)
        assert float(row["p25"]) < float(row["median"]) < float(row["p75"]) < float(row["p90"])
        assert float(row["seconds_per_image"]) > 0


def test_the_time_of_an_image_is_that_of_solving_over_the_images(sweep, tmp_path):
    _, rows = sweep({"fit.lambda": [0.1, 0.2]})
    for row, folder in zip(rows, ("1_0.1", "2_0.2"), strict=True):
        found = read_results(tmp_path / "out/work" / folder / "result.h5")
        seconds = found.attributes["solve_seconds"] / len(found)
        assert len(found) > 1
        assert float(row["seconds_per_image"]) == pytest.approx(seconds)


def test_noise_and_hidden_landmarks_raise_the_error(sweep):
    _, rows = sweep({"project.noise": [0.0, 0.05, 0.2]})
    assert means(rows) == sorted(means(rows))
    _, rows = sweep({"project.hidden": [0.0, 0.6]})
    assert means(rows)[0] < means(rows)[1]


def test_a_step_that_the_key_has_no_say_in_is_done_once(sweep, tmp_path):
    sweep({"fit.lambda": [0.1, 0.2]})
    work = tmp_path / "out/work"
    assert {path.name for path in work.rglob("dictionary.h5")} == {"dictionary.h5"}
    assert len(list(work.rglob("dictionary.h5"))) == len(list(work.rglob("landmarks.h5"))) == 1
    assert len(list(work.rglob("result.h5"))) == 2


def test_each_value_of_the_dictionary_size_learns_a_dictionary(sweep, tmp_path):
    _, rows = sweep({"learn_dict.k": [2, 8]})
    files = sorted((tmp_path / "out/work").rglob("dictionary.h5"))
    assert [len(read_dictionary(file).atoms) for file in files] == [2, 8]
    assert len(list((tmp_path / "out/work").rglob("landmarks.h5"))) == 1
    assert means(rows)[1] < means(rows)[0]


def test_every_nth_image_is_fitted(sweep, tmp_path, monkeypatch):
    monkeypatch.setattr("shapefit.pipelines.sweeps.BATCH", 5)  # some chunks have none
    _, (row,) = sweep({"fit.lambda": [0.1]}, every=7)
    items = read_results(tmp_path / "out/work/1_0.1/result.h5").items
    list(project.run(ProjectConfig(shapes=(TRUTH,), output=tmp_path / "views.h5")))
    views = load(tmp_path / "views.h5")
    assert items == views.items[::7]
    assert int(row["images"]) == len(items)


def test_files_that_are_given_are_used(sweep, tmp_path):
    dictionary, views = tmp_path / "dictionary.h5", tmp_path / "views.h5"
    settings = LEARNING | {"shapes": (LEARNING["shapes"],), "k": 2}
    list(learn_dict.run(LearnDictConfig(**settings, output=dictionary)))
    list(project.run(ProjectConfig(shapes=(TRUTH,), output=views, noise=0.2)))
    given = {"landmarks": str(views), "dictionary": str(dictionary)}
    _, (row,) = sweep({"fit.lambda": [0.1]}, learn_dict=None, project=None, fit=given)
    _, (made,) = sweep(
        {"fit.lambda": [0.1]},
        learn_dict=LEARNING | {"k": 2},
        project={"shapes": str(TRUTH), "noise": 0.2},
    )
    assert means([row]) == means([made])
    assert not (tmp_path / "out/work/1_0.1/dictionary.h5").exists()


def test_a_sweep_writes_no_pictures_of_its_fits(sweep, tmp_path):
    folder = tmp_path / "pictures"
    sweep({"fit.lambda": [0.1, 0.2]}, fit={"pictures": {"folder": str(folder)}})
    assert not folder.exists()


def test_methods_are_told_apart(sweep, tmp_path):
    _, rows = sweep({"fit.method": ["convex", "mean-shape"]}, plots=True)
    assert [row["value"] for row in rows] == ["convex", "mean-shape"]
    assert means(rows)[0] < means(rows)[1]
    assert read_results(tmp_path / "out/work/2_mean-shape/result.h5").attributes["method"] == (
        "mean-shape"
    )
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == REPORT | {"sweep.png", "sweep.svg"}


def test_every_image_has_a_row_for_each_value(sweep, tmp_path):
    _, rows = sweep({"fit.lambda": [0.1, 1.5]})
    with (tmp_path / "out/per_image.csv").open(newline="", encoding="utf-8") as file:
        images = list(csv.DictReader(file))
    assert list(images[0]) == ["value", "sequence", "item", "metric", "error", "unit"]
    for row in rows:
        errors = [float(image["error"]) for image in images if image["value"] == row["value"]]
        assert len(errors) == int(row["images"])
        assert np.mean(errors) == pytest.approx(float(row["mean"]))


def test_groups_have_rows_of_their_own(sweep):
    groups = {"Walking": "walk*", "All": "*"}
    _, rows = sweep({"fit.lambda": [0.1, 0.2]}, groups=groups)
    assert [(row["value"], row["group"]) for row in rows] == [
        ("0.1", "Walking"), ("0.1", "All"), ("0.2", "Walking"), ("0.2", "All"),
    ]  # fmt: skip
    assert 0 < int(rows[0]["images"]) < int(rows[1]["images"])


def test_outcomes_count_the_images_of_all_values(sweep):
    outcomes, rows = sweep({"fit.lambda": [0.1, 0.2]})
    images = [int(row["images"]) for row in rows]
    assert done(outcomes) == sum(images)
    assert {outcome.total for outcome in outcomes if outcome.done} == {sum(images)}
    assert {path.name for path in outcomes[-1].written} == REPORT - {"work"}
    assert outcomes[-1].note.startswith("# Error against fit.lambda")


def test_an_image_that_fails_is_reported_once_for_each_value(sweep, tmp_path):
    views = tmp_path / "views.csv"
    list(project.run(ProjectConfig(shapes=(TRUTH,), output=views)))
    header, *rows = views.read_text("utf-8").splitlines()
    item, landmark, *_, sequence = rows[0].split(",")
    seen = [row for row in rows if not row.startswith(f"{item},")]
    hidden = f"{item},{landmark},,,{sequence}"
    assert header == "item,landmark,x,y,sequence"
    views.write_text("\n".join([header, hidden, *seen, ""]), encoding="utf-8")
    outcomes, rows = sweep({"fit.lambda": [0.1, 0.2]}, project=None, fit={"landmarks": str(views)})
    failures = [failure.item for outcome in outcomes for failure in outcome.failures]
    assert failures == [f"fit.lambda=0.1: {item}", f"fit.lambda=0.2: {item}"]
    assert done(outcomes) == 2 + sum(int(row["images"]) for row in rows)


def test_the_json_says_how_it_was_made(sweep, tmp_path):
    sweep({"fit.lambda": [0.1]})
    document = json.loads((tmp_path / "out/sweep.json").read_text("utf-8"))
    assert document["config"]["every"] == 16
    assert set(document["inputs"]) == {LEARNING["shapes"], str(TRUTH)}
    assert document["points"][0]["value"] == 0.1


def test_wrong_folders_and_groups_and_no_matplotlib_are_input_errors(sweep, tmp_path, monkeypatch):
    with pytest.raises(InputError, match="no sequence matches any group"):
        sweep({"fit.lambda": [0.1]}, groups={"None": "nobody*"})
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="file is not a folder"):
        sweep({"fit.lambda": [0.1]}, output=str(tmp_path / "file/out"))
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match="pip install matplotlib"):
        sweep({"fit.lambda": [0.1]}, plots=True)


class TestTheDatasetThatNamesTheTruth:
    def test_is_asked_of_given_landmarks_before_anything_is_written(self, sweep, tmp_path):
        with pytest.raises(InputError, match=r"match: the landmarks have no dataset 'nothing'"):
            sweep(
                {"fit.lambda": [0.1]},
                project=None,
                fit={"landmarks": str(PEOPLE / "people_views.csv")},
                match="nothing",
            )
        assert not (tmp_path / "out").exists()

    def test_is_asked_of_projected_landmarks_before_the_first_fit(self, sweep, tmp_path):
        with pytest.raises(InputError, match=r"match: the landmarks have no dataset 'nothing'"):
            sweep({"fit.lambda": [0.1]}, match="nothing")
        assert not list((tmp_path / "out").rglob("result*.h5"))


class TestCorruptedCars:
    """The cars of sample_data, each fitted without its own model."""

    @pytest.fixture
    def cars(self, sweep):
        def start(vary, metrics=("similarity",), **fit):
            settings = {"leave_out": "true_model", "method": "alternate"} | fit
            return sweep(
                vary,
                learn_dict={"shapes": str(PEOPLE / "cars.h5"), "method": "exemplars"},
                project=None,
                fit={"landmarks": str(PEOPLE / "cars_views.h5")} | settings,
                truth=str(PEOPLE / "cars.h5"),
                match="true_model",
                least_visible=20,
                every=2,
                metrics=list(metrics),
            )

        return start

    def test_every_metric_has_rows(self, cars):
        _, rows = cars({"fit.lambda": [0.1, 1]}, metrics=["similarity", "camera", "rotation"])
        kinds = [(row["value"], row["metric"], row["unit"]) for row in rows]
        assert kinds == [
            (value, metric, unit)
            for value in ("0.1", "1")
            for metric, unit in (
                ("similarity", "normalised"), ("camera", "normalised"), ("rotation", "deg"),
            )
        ]  # fmt: skip
        similarity, camera, rotation = means(rows[:3])
        assert similarity < camera < rotation < 20

    def test_the_images_to_warm_up_with_may_all_be_of_unknown_models(self, cars, tmp_path):
        views = tmp_path / "views.h5"
        shutil.copy(PEOPLE / "cars_views.h5", views)
        with h5py.File(views, "r+") as file:
            assert 40 < len(file["true_model"])
            file["true_model"][:40] = "stranger"
        outcomes, rows = cars({"fit.lambda": [1]}, landmarks=str(views))
        failed = [failure for outcome in outcomes for failure in outcome.failures]
        assert len(failed) == 20
        assert int(rows[0]["images"]) > 20
        told = warnings(outcomes)
        assert [warning for warning in told if "stranger" in warning]

    def test_a_search_survives_what_the_plain_fit_does_not(self, cars, tmp_path):
        shares = {"corrupt.share": [0, 0.4]}
        outcomes, plain = cars(shares)
        clean, spoilt = means(plain)
        assert spoilt > 1.5 * clean
        assert {row["metric"] for row in plain} == {"similarity"}
        assert "precision" not in outcomes[-1].note
        outcomes, robust = cars(shares, outliers={"method": "ransac"})
        found = {(row["metric"], row["value"]): float(row["mean"]) for row in robust}
        assert found["similarity", "0.4"] < 1.25 * clean
        assert ("recall", "0") not in found
        assert found["recall", "0.4"] > 0.85
        assert found["precision", "0.4"] > 0.85
        first, second = (
            read_results(tmp_path / f"out/work/{folder}/result.h5") for folder in ("1_0", "2_0.4")
        )
        assert first.items == second.items
        assert not first.columns["corrupted"].any()
        visible = np.isfinite(second.columns["landmarks"]).all(axis=2)
        assert visible.sum(axis=1).min() >= 20
        share = second.columns["corrupted"].sum() / visible.sum()
        assert share == pytest.approx(0.4, abs=0.03)

    def test_labels_are_judged_at_one_share_while_another_key_varies(self, sweep):
        outcomes, rows = sweep(
            {"fit.outliers.method": ["none", "l1"]},
            corrupt={"share": 0.2},
            fit={"outliers": {"threshold": 0.3}},
        )
        labels = [(row["value"], row["metric"]) for row in rows if row["metric"] != "similarity"]
        assert labels == [("l1", "precision"), ("l1", "recall")]
        assert not warnings(outcomes)
