"""What bar and box plots show: heights, quartiles, looks, files."""

import numpy as np

from shapefit.evaluation.calibration import CURVE, Coverage
from shapefit.evaluation.plots import draw_bars, draw_boxes, draw_calibration, save
from shapefit.evaluation.summaries import ImageErrors, summarise

NAN = float("nan")
GROUPS = {"13": ("13_1", "13_2"), "14": ("14_1",)}


def errors(method="a", shift=0.0):
    sequences = ("13_1", "13_1", "13_2", "14_1", "14_1")
    values = np.array([1.0, 3.0, 6.0, 5.0, NAN]) + shift
    return ImageErrors(method, "similarity", "m", tuple("pqrst"), sequences, values)


def heights(axis):
    return {bars.get_label(): [bar.get_height() for bar in bars] for bars in axis.containers}


def ticks(axis):
    return [text.get_text() for text in axis.get_xticklabels()]


def test_bars_are_the_means_of_sequences_and_of_groups():
    summaries = [s for e in (errors(), errors("b", 1)) for s in summarise(e, GROUPS)]
    first, second = draw_bars(summaries).axes
    assert heights(first) == {"a": [2.0, 6.0, 4.0], "b": [3.0, 7.0, 5.0]}
    assert ticks(first) == ["13_1", "13_2", "mean"]
    assert heights(second) == {"a": [5.0], "b": [6.0]}
    assert [axis.get_title() for axis in (first, second)] == ["13", "14"]
    assert first.get_ylabel() == "mean error (m)"
    many = draw_bars([s for name in "abcdefghijkl" for s in summarise(errors(name), GROUPS)])
    assert many.get_figwidth() > 0.12 * 12 * 6  # inches: 48 bars, and gaps as wide as 24


def test_boxes_are_the_quartiles_of_the_images_that_did_not_fail_as_in_the_tables():
    """Of several sequences the mean of theirs: medians 2 and 6, where that of all images is 3."""
    first, second = draw_boxes([errors()], GROUPS).axes
    (box,) = first.patches
    bottom, top = box.get_path().vertices[:, 1].min(), box.get_path().vertices[:, 1].max()
    assert (bottom, top) == ((1.5 + 6) / 2, (2.5 + 6) / 2)
    assert [text.get_text() for text in first.texts] == ["4"]
    assert [text.get_text() for text in second.texts] == ["5"]
    in_tables = [s.median for s in summarise(errors(), GROUPS) if s.sequence is None]
    assert in_tables == [4, 5]


def test_marks_of_error_bars_are_as_wide_as_their_bars():
    rows = [Coverage("a", "all", name, 4, (0.5, 0.9), {}) for name in ("hip", "knee")]
    _, right = draw_calibration(rows, {("a", "all"): CURVE}).axes
    marks = [mark[:, 0] for mark in right.collections[0].get_segments()]
    bars = [[bar.get_x(), bar.get_x() + bar.get_width()] for bar in right.patches]
    np.testing.assert_allclose(marks, bars, atol=1e-9)


def test_titles_fit_above_their_panels():
    groups = {"the first of all of the subjects that were ever seen": ("13_1",), "14": ("14_1",)}
    figure = draw_boxes([errors()], groups)
    figure.draw_without_rendering()
    for text in (figure._suptitle, *(axis.title for axis in figure.axes)):
        box = text.get_window_extent()
        assert box.x0 >= 0
        assert box.x1 <= figure.bbox.width
    assert "\n" in figure.axes[0].get_title()


def test_files_are_the_same_every_time_and_need_no_screen(tmp_path):
    for form in ("png", "svg"):
        for turn in ("first", "second"):
            save(draw_boxes([errors()], GROUPS), tmp_path / turn, form)
        assert (tmp_path / "first").read_bytes() == (tmp_path / "second").read_bytes()
