"""Points of a sweep: statistics of groups, and how they are written and drawn."""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from shapefit.evaluation.experiment_plots import sweep_plot
from shapefit.evaluation.summaries import ImageErrors
from shapefit.evaluation.sweep import Sweep, markdown, points, sweep_json, write_csv

GROUPING = {"ab": ("a", "b"), "c": ("c",)}


def errors(*values, sequences="aaaaabbc"):
    items = tuple(map(str, range(len(values))))
    return ImageErrors("it", "similarity", "normalised", items, tuple(sequences), np.array(values))


ERRORS = errors(0.0, 0.1, 0.2, 0.3, 0.9, 1.0, 2.0, 0.5)


def sweep(*values, data=(ERRORS,), grouping=GROUPING):
    found = [p for value in values for d in data for p in points(value, d, grouping, 0.002)]
    return Sweep("fit.lambda", tuple(found))


def cells(line):
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_a_group_has_the_means_of_the_statistics_of_its_sequences():
    ab, c = points(0.1, ERRORS, GROUPING, 0.002)
    assert (ab.value, ab.group, ab.images, ab.seconds_per_image) == (0.1, "ab", 7, 0.002)
    assert ab.mean == pytest.approx((0.3 + 1.5) / 2)
    assert ab.p25 == pytest.approx((0.1 + 1.25) / 2)
    assert ab.median == pytest.approx((0.2 + 1.5) / 2)
    assert ab.p75 == pytest.approx((0.3 + 1.75) / 2)
    assert (c.p25, c.mean, c.p75) == (0.5, 0.5, 0.5)


def test_failed_images_do_not_count_and_a_group_without_any_has_no_numbers():
    ab, c = points(0.1, errors(0.0, 0.2, math.nan, math.nan, sequences="aabc"), GROUPING, 0.002)
    assert (ab.images, ab.p25) == (2, pytest.approx(0.05))
    assert c.images == 0
    assert math.isnan(c.mean)
    assert math.isnan(c.p25)


def test_what_does_not_exist_is_null_and_empty(tmp_path):
    found = sweep(0.1, data=[errors(0.0, math.nan, sequences="ac")])
    assert json.loads(sweep_json(found))["points"][1]["mean"] is None
    write_csv(tmp_path / "sweep.csv", found)
    *_, last = (tmp_path / "sweep.csv").read_text("utf-8").splitlines()
    assert last == "fit.lambda,0.1,c,similarity,normalised,0,1,,,,,,0.002"


def test_the_table_has_values_down_and_groups_across():
    lines = markdown(sweep(0.1, 0.2)).splitlines()
    assert lines[0] == "# Error against fit.lambda"
    header, _, first, second = (cells(line) for line in lines if line.startswith("|"))
    groups = ["ab: similarity (normalised)", "c: similarity (normalised)"]
    assert header == ["fit.lambda", *groups, "ms per image"]
    assert first == ["0.1", "0.900 / 0.850", "0.500 / 0.500", "2"]
    assert second == ["0.2", *first[1:]]


def test_true_and_false_are_written_as_in_yaml(tmp_path):
    found = sweep(False, True)
    first, second = [cells(line) for line in markdown(found).splitlines() if line[:1] == "|"][2:]
    assert (first[0], second[0]) == ("false", "true")
    write_csv(tmp_path / "sweep.csv", found)
    with (tmp_path / "sweep.csv").open() as file:
        assert [row["value"] for row in csv.DictReader(file)] == ["false", "false", "true", "true"]


def test_every_metric_has_a_column_and_a_panel():
    degrees = replace(ERRORS, metric="rotation", unit="deg", values=10 * ERRORS.values)
    recall = replace(ERRORS, metric="recall", unit="share", values=ERRORS.values / 2)
    whole = {"all": ("a", "b", "c")}
    found = sweep(0.1, 0.2, data=(ERRORS, degrees), grouping=whole)
    # at the second value only, as where the share of wrong landmarks varies from 0
    found = replace(found, points=(*found.points, *points(0.2, recall, whole, 0.002)))
    text = markdown(found)
    assert "Recall of" not in text
    assert "recall the share of the corrupted landmarks" in text
    header, _, first, second = (cells(line) for line in text.splitlines() if line[:1] == "|")
    assert header[1:] == [
        "similarity (normalised)", "rotation (deg)", "recall (share)", "ms per image",
    ]  # fmt: skip
    assert first == ["0.1", "0.767 / 0.733", "7.667 / 7.333", "–", "2"]
    assert second == ["0.2", *first[1:3], "0.383 / 0.367", "2"]
    panels = sweep_plot(found).axes
    assert [axis.get_ylabel() for axis in panels] == [
        f"{what}, mean and quartiles" for what in ("error (normalised)", "error (deg)", "share")
    ]
    assert [list(axis.lines[0].get_xdata()) for axis in panels] == [[0.1, 0.2], [0.1, 0.2], [0.2]]
    assert list(panels[1].lines[0].get_ydata()) == pytest.approx([23 / 3, 23 / 3])


def test_where_images_failed_the_share_of_the_others_is_told():
    found = sweep(0.1, data=[errors(0.0, 0.2, math.nan, sequences="aaa")], grouping={"all": ("a",)})
    header, _, row = (cells(line) for line in markdown(found).splitlines() if line[:1] == "|")
    assert header[2] == "with a shape"
    assert row[1:3] == ["0.100 / 0.100", "66 %"]


def test_numbers_are_drawn_as_lines_in_their_order():
    (axis,) = sweep_plot(sweep(0.2, 0.1)).axes
    assert [line.get_label() for line in axis.lines] == ["ab", "c"]
    assert list(axis.lines[0].get_xdata()) == [0.1, 0.2]
    assert list(axis.lines[0].get_ydata()) == pytest.approx([0.9, 0.9])
    assert axis.get_xscale() == "linear"
    assert axis.get_ylim()[0] == 0


@pytest.mark.parametrize("values", [(0.1, 0.2), ("convex", "pmp")])
def test_the_range_around_the_mean_goes_from_quartile_to_quartile(values):
    axis = sweep_plot(sweep(*values)).axes[0]
    drawn = axis.collections[0]  # a band behind a line, or a stroke on each bar
    y = np.concatenate([path.vertices[:, 1] for path in drawn.get_paths()])
    ab, _ = points(0.1, ERRORS, GROUPING, 0.002)
    assert (y.min(), y.max()) == pytest.approx((ab.p25, ab.p75))


def test_a_wide_range_has_a_logarithmic_axis_unless_it_has_zero():
    assert sweep_plot(sweep(0.01, 1)).axes[0].get_xscale() == "log"
    assert sweep_plot(sweep(0, 0.01, 1)).axes[0].get_xscale() == "linear"


@pytest.mark.parametrize(
    ("values", "names"),
    [(("convex", "mean-shape"), ["convex", "mean-shape"]), ((True, False), ["true", "false"])],
)
def test_names_are_drawn_as_bars_beside_their_times(values, names):
    errors_, times = sweep_plot(sweep(*values)).axes
    assert [bar.get_height() for bar in errors_.containers[0]] == pytest.approx([0.9, 0.9])
    assert [label.get_text() for label in times.get_yticklabels()] == names
    assert [label.get_text() for label in errors_.get_xticklabels()] == names
    assert [bar.get_width() for bar in times.containers[0]] == pytest.approx([2, 2])
