"""Precision and recall of the labels of outliers, and images that leave them undefined."""

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
