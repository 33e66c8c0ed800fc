"""What the box plots show: quartiles of the images of a group, medians in numbers."""

import itertools

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from shapefit.evaluation.plots import bars as plots
from shapefit.evaluation.plots.box_plots import box_plot
from shapefit.evaluation.summary import ImageErrors

NAN = float("nan")
SEQUENCES = ("13_01",) * 101 + ("13_02",) * 5 + ("14_01",) * 11 + ("15_01",) * 2
GROUPS = {"Subject 13": ("13_01", "13_02"), "Subject 14": ("14_01",)}
INSIDE = {"Subject 13": slice(0, 106), "Subject 14": slice(106, 117)}


def image_errors(method, values, sequences=SEQUENCES):
    items = tuple(map(str, range(len(values))))
    return ImageErrors(method, "similarity", "normalised", items, sequences, np.array(values))


@pytest.fixture
def errors(rng):
    return [
        image_errors(name, rng.gamma(9, 0.03 * scale, len(SEQUENCES)))
        for scale, name in enumerate(("convex", "alternate", "pmp"), start=1)
    ]


def boxes(axis):
    """Return lower and upper quartile of each box, from left to right, and the colours."""
    found = []
    for patch in axis.patches:
        corners = patch.get_path().vertices
        found.append((corners[:, 0].min(), *np.ptp(corners, axis=0), corners[:, 1].min(), patch))
    found.sort(key=lambda box: box[0])
    spans = [(low, low + height) for _, _, height, low, _ in found]
    return spans, [patch.get_facecolor() for *_, patch in found]


def medians(axis):
    return [text.get_text() for text in sorted(axis.texts, key=lambda text: text.xy[0])]


def test_a_box_spans_the_quartiles_of_all_images_of_its_group(errors):
    (axis,) = box_plot(errors, GROUPS).axes
    expected = [np.percentile(e.values[inside], [25, 75]) for inside in INSIDE.values()
                for e in errors]  # fmt: skip
    spans, colours = boxes(axis)
    np.testing.assert_allclose(spans, expected)
    assert colours == [to_rgba(colour) for colour in plots.COLOURS[:3] * 2]


def test_medians_are_printed_with_three_digits(errors):
    (axis,) = box_plot(errors, GROUPS).axes
    values = [np.median(e.values[inside]) for inside in INSIDE.values() for e in errors]
    assert [float(text) for text in medians(axis)] == [float(f"{value:.3g}") for value in values]
    (axis,) = box_plot([image_errors("m", [0.25, 0.26, 0.27], ("a",) * 3)], {"all": ("a",)}).axes
    assert medians(axis) == ["0.260"]
    (axis,) = box_plot([image_errors("m", [120.0, 123.4, 130.0], ("a",) * 3)], {"all": ("a",)}).axes
    assert medians(axis) == ["123"]


def test_whiskers_reach_to_the_5th_and_95th_percentile(rng):
    values = np.linspace(1, 2, 101)
    (axis,) = box_plot([image_errors("m", values, ("a",) * 101)], {"all": ("a",)}).axes
    ends = [line.get_ydata() for line in axis.lines]
    assert (np.min(np.concatenate(ends)), np.max(np.concatenate(ends))) == pytest.approx(
        (1.05, 1.95)
    )
    assert axis.get_ylim()[1] >= 1.95


def test_failed_images_and_methods_without_any_are_left_out(errors):
    values = errors[0].values.copy()
    values[:50] = NAN
    gone = np.full(len(values), NAN)
    shown = [image_errors("convex", values), image_errors("none", gone), errors[2]]
    (axis,) = box_plot(shown, GROUPS).axes
    spans, colours = boxes(axis)
    np.testing.assert_allclose(spans[0], np.percentile(values[50:106], [25, 75]))
    assert len(spans) == 4
    assert colours[:2] == [to_rgba(plots.COLOURS[0]), to_rgba(plots.COLOURS[2])]
    legend = axis.figure.legends[0]
    assert [text.get_text() for text in legend.get_texts()] == ["convex", "none", "pmp"]


def test_groups_are_named_and_those_without_images_are_not(errors):
    groups = {**GROUPS, "Subject 16": ()}
    (axis,) = box_plot(errors, groups).axes
    assert [tick.get_text() for tick in axis.get_xticklabels()] == list(GROUPS)
    assert axis.get_ylabel() == "error (normalised)"
    (axis,) = box_plot(errors[:1], {"all": SEQUENCES}).axes
    assert [tick.get_text() for tick in axis.get_xticklabels()] == [""]


def test_without_any_error_the_axes_are_empty():
    (axis,) = box_plot([image_errors("m", [NAN, NAN], ("a", "a"))], {"all": ("a",)}).axes
    assert not axis.texts
    assert not axis.patches


@pytest.mark.parametrize("methods", [1, 6])
def test_nothing_written_covers_anything_else(methods, rng):
    shown = [
        image_errors(f"method {i}", 0.2 + 0.01 * rng.random(len(SEQUENCES))) for i in range(methods)
    ]
    groups = {
        f"A group of activities, number {i}": (s,) for i, s in enumerate(sorted({*SEQUENCES}))
    }
    figure = box_plot(shown, groups)
    figure.draw_without_rendering()
    (axis,) = figure.axes
    for texts in (axis.texts, axis.get_xticklabels()):
        extents = [text.get_window_extent() for text in texts]
        assert not any(a.overlaps(b) for a, b in itertools.combinations(extents, 2))


def test_files_are_the_same_every_time(errors, tmp_path):
    for turn in ("first", "second"):
        plots.save(box_plot(errors, GROUPS), tmp_path / turn, "svg")
    assert (tmp_path / "first").read_bytes() == (tmp_path / "second").read_bytes()
