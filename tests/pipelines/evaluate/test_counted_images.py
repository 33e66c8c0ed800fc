"""Images that count: those with labels of outliers, and those that show enough landmarks."""

import json

import numpy as np
import pytest

from shapefit.errors import InputError

METRICS = ["similarity", "precision", "recall"]


@pytest.fixture
def labelled(results):
    """Three of the seven images were corrupted, three have labels; two are both."""
    outliers, corrupted = np.zeros((7, 5), dtype=bool), np.zeros((7, 5), dtype=bool)
    corrupted[0, :4] = True
    outliers[0, [0, 1, 4]] = True
    corrupted[1, 2] = True
    outliers[1, 2] = True
    corrupted[2, 3] = True
    outliers[5, 0] = True
    labels = {"outliers": outliers, "corrupted": corrupted}
    return results.replaced(further={**results.further, **labels})


def values(desk, metric):
    rows = [row for row in desk.rows("per_image.csv") if row["metric"] == metric]
    assert {row["unit"] for row in rows} <= {"share"}
    return {row["item"]: float(row["error"] or "nan") for row in rows}


def test_are_shares_of_each_image_that_has_some(desk, labelled):
    desk.write("convex.h5", labelled)
    judged, _ = desk.run(metrics=METRICS)
    assert values(desk, "precision") == pytest.approx({"item0": 2 / 3, "item1": 1, "item5": 0})
    assert values(desk, "recall") == pytest.approx({"item0": 0.5, "item1": 1, "item2": 0})
    assert judged.failures == ()
    row = desk.row(metric="recall", group="Subject 13", sequence="")
    assert (row["images"], float(row["mean"])) == ("3", 0.5)
    summaries = json.loads((desk.config.output / "report.json").read_text())["summaries"]
    assert {summary["failed"] for summary in summaries} == {0}


def test_a_failed_image_has_neither(desk, labelled):
    shapes = labelled.shapes.copy()
    shapes[1] = np.nan
    desk.write("convex.h5", labelled.replaced(shapes=shapes))
    judged, _ = desk.run(metrics=METRICS)
    assert [failure.item for failure in judged.failures] == ["item1"]
    for metric in ("precision", "recall"):
        assert np.isnan(values(desk, metric)["item1"])
    assert desk.row(metric="recall", sequence="13_01")["images"] == "2"


def test_are_not_measured_unasked(desk, labelled):
    desk.write("convex.h5", labelled)
    desk.run()
    assert not {"precision", "recall"} & {row["metric"] for row in desk.rows()}


def test_are_left_out_where_nobody_knows_what_was_corrupted(desk, labelled):
    extras = {name: data for name, data in labelled.further.items() if name != "corrupted"}
    desk.write("convex.h5", labelled.replaced(further=extras))
    judged, _ = desk.run(metrics=METRICS)
    assert len(judged.warnings) == 2
    assert "no precision without the dataset `corrupted`" in judged.warnings[0]


def test_nothing_to_judge_at_all_is_an_error(desk, labelled):
    nothing = {**labelled.further, "corrupted": np.zeros((7, 5), dtype=bool)}
    desk.write("convex.h5", labelled.replaced(further=nothing))
    with pytest.raises(InputError, match=r"metrics: no image has anything to judge in recall"):
        desk.run(metrics=["recall"])
    assert not desk.config.output.exists()


def test_labels_of_other_landmarks_are_an_error(desk, labelled):
    wrong = {**labelled.further, "corrupted": np.zeros((7, 4), dtype=bool)}
    desk.write("convex.h5", labelled.replaced(further=wrong))
    with pytest.raises(InputError, match=r"convex\.h5:/corrupted: has the shape \(7, 4\)"):
        desk.run(metrics=METRICS)


SEEN = (5, 4, 3, 5, 2, 4, 5)
"""Observed landmarks of each image; shapes are whole all the same."""


@pytest.fixture
def partly_seen(desk, results):
    observed = results.columns["landmarks"].copy()
    for image, seen in zip(observed, SEEN, strict=True):
        image[seen:] = np.nan
    seen = results.replaced(further={**results.further, "landmarks": observed})
    desk.write("convex.h5", seen)
    return seen


@pytest.mark.parametrize(("least", "judged"), [(0, 7), (2, 7), (3, 6), (4, 5), (5, 3)])
def test_images_with_at_least_so_many_are_judged(desk, partly_seen, least, judged):
    outcome, _ = desk.run(least_visible=least)
    kept = [i for i, seen in enumerate(SEEN) if seen >= least]
    rows = [row["item"] for row in desk.rows("per_image.csv") if row["metric"] == "rotation"]
    assert rows == [f"item{i}" for i in kept]
    assert (outcome.done, outcome.failures) == (judged, ())
    out = f"{7 - judged} of 7 images left out: fewer than {least} observed landmarks"
    assert (out in " ".join(outcome.warnings)) == (judged < 7)
    assert (out in (desk.config.output / "report.md").read_text()) == (judged < 7)


def test_an_image_that_could_not_be_lifted_counts_by_what_it_shows(desk, partly_seen):
    shapes = partly_seen.shapes.copy()
    shapes[[0, 2]] = np.nan  # five landmarks, on one line perhaps, and three
    desk.write("convex.h5", partly_seen.replaced(shapes=shapes))
    outcome, _ = desk.run(least_visible=4)
    assert [failure.item for failure in outcome.failures] == ["item0"]
    assert outcome.done == 5


def test_results_without_observed_landmarks_are_an_error(desk, results):
    desk.write("table.csv", results)
    with pytest.raises(InputError, match=r"table\.csv: has no dataset 'landmarks'.*least_visible"):
        desk.run(results=[desk.folder / "table.csv"], least_visible=1)


def test_no_image_left_is_an_error(desk, partly_seen):
    with pytest.raises(InputError, match=r"none of its 7 images has 6 .*`least_visible` to 5 or"):
        desk.run(least_visible=6)
    assert not desk.config.output.exists()
