"""What bar and box plots show: heights, quartiles, labels, looks, files."""

import itertools
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from shapefit.evaluation.plots import bars as plots
from shapefit.evaluation.plots import style
from shapefit.evaluation.plots.bars import box_plot
from shapefit.evaluation.summary import ImageErrors, group_sequences, summarise

NAN = float("nan")


def summaries(sequences, methods=("convex",), groups=None):
    """One image a sequence; the error of method i in sequence j is 1 + i + j / 100."""
    names = tuple(sequences)
    grouping = group_sequences(groups or {}, names)
    rows = []
    for i, method in enumerate(methods):
        values = 1 + i + np.arange(len(names)) / 100
        errors = ImageErrors(method, "similarity", "normalised", names, names, values)
        rows += summarise(errors, grouping)
    return rows


def subject(number, trials):
    return [f"{number}_{trial:02d}" for trial in range(1, trials + 1)]


def bars(axis):
    return {c.get_label(): [bar.get_height() for bar in c] for c in axis.containers}


def labels(axis):
    return [text.get_text() for text in axis.get_xticklabels()]


def test_a_bar_for_every_sequence_and_method_then_the_mean():
    figure = plots.bar_plot(summaries(["a", "b", "c"], ["convex", "admm"]))
    (axis,) = figure.axes
    assert labels(axis) == ["a", "b", "c", "mean"]
    shown = bars(axis)
    np.testing.assert_allclose(shown["convex"], [1, 1.01, 1.02, 1.01])
    np.testing.assert_allclose(shown["admm"], [2, 2.01, 2.02, 2.01])
    assert "normalised" in axis.get_ylabel()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["convex", "admm"]


@pytest.mark.parametrize("count", [1, 4, 11])
def test_the_legend_lies_within_the_figure(count):
    methods = [f"Convex+robust+refine, 0.{i:02d}" for i in range(count)]
    figure = plots.bar_plot(summaries(["all"], methods))
    figure.draw_without_rendering()
    box = figure.legends[0].get_window_extent()
    assert 0 <= box.x0 < box.x1 <= figure.bbox.width


def test_bars_do_not_overlap():
    figure = plots.bar_plot(summaries(subject(13, 9), [f"method {i}" for i in range(5)]))
    edges = sorted((b.get_x(), b.get_x() + b.get_width()) for b in figure.axes[0].patches)
    assert all(right <= left + 1e-9 for (_, right), (left, _) in itertools.pairwise(edges))


def test_of_very_many_sequences_only_the_mean_is_drawn():
    (axis,) = plots.bar_plot(summaries(subject(13, plots.MOST_SEQUENCES + 1))).axes
    np.testing.assert_allclose(bars(axis)["convex"], [1 + plots.MOST_SEQUENCES / 200])


def test_a_sequence_that_failed_altogether_has_no_bar():
    errors = ImageErrors("m", "similarity", "m", ("1", "2"), ("a", "b"), np.array([1, NAN]))
    (axis,) = plots.bar_plot(summarise(errors, {"all": ("a", "b")})).axes
    np.testing.assert_allclose(bars(axis)["m"], [1, NAN, 1])


def test_a_sequence_that_a_method_has_no_image_of_has_no_bar():
    """A bar of height 0 would say that it has no error."""
    few, many = summaries(["a"], ["few"]), summaries(["a", "b"], ["many"])
    (axis,) = plots.bar_plot(many + few).axes
    np.testing.assert_allclose(bars(axis)["few"], [1, NAN, 1])
    np.testing.assert_allclose(bars(axis)["many"], [1, 1.01, 1.005])


@pytest.mark.parametrize(
    ("sizes", "rows"), [((42, 37), 2), ((14,), 1), ((3, 3, 3, 3, 3), 1), ((70,), 1), ((20, 25), 1)]
)
def test_groups_share_a_row_as_far_as_they_fit(sizes, rows):
    names = [name for group, size in enumerate(sizes, 13) for name in subject(group, size)]
    groups = {f"Subject {group}": f"{group}_*" for group, _ in enumerate(sizes, 13)}
    figure = plots.bar_plot(summaries(names, groups=groups))
    assert len(figure.axes) == rows
    titles = [text.get_text() for axis in figure.axes for text in axis.texts]
    assert titles == list(groups)


@pytest.mark.parametrize(
    "names",
    [
        subject(13, 42),
        subject(13, 1),
        [f"walking_{i}" for i in range(6)],
        ["a long name of a sequence", "b"],
    ],
)
@pytest.mark.parametrize("methods", [1, 3, 9])
def test_no_label_covers_another(names, methods):
    figure = plots.bar_plot(summaries(names, [f"method {i}" for i in range(methods)]))
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in figure.axes[0].get_xticklabels()]
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))


def test_titles_of_single_sequence_groups_do_not_run_into_each_other():
    groups = {f"A group of activities {i}": f"{i}_01" for i in range(5)}
    figure = plots.bar_plot(summaries([f"{i}_01" for i in range(5)], groups=groups))
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for axis in figure.axes for text in axis.texts]
    assert len(boxes) == 5
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))


def test_every_method_looks_different():
    figure = plots.bar_plot(summaries(["a", "b"], [f"method {i}" for i in range(20)]))
    looks = {(c[0].get_facecolor(), c[0].get_hatch()) for c in figure.axes[0].containers}
    assert len(looks) == 20


def test_files_are_png_and_svg_and_the_same_every_time(tmp_path):
    for turn in ("first", "second"):
        figure = plots.bar_plot(summaries(["a", "b"]))
        for file_format in style.FORMATS:
            style.save(figure, tmp_path / f"{turn}.{file_format}", file_format)
    assert (tmp_path / "first.png").read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in (tmp_path / "first.svg").read_bytes()
    for file_format in style.FORMATS:
        first, second = (tmp_path / f"{turn}.{file_format}" for turn in ("first", "second"))
        assert first.read_bytes() == second.read_bytes()


def test_importing_the_evaluation_does_not_import_matplotlib():
    code = (
        "import sys, shapefit.evaluation.plots.bars, shapefit.evaluation.tables.csv_json; "
        "print({'matplotlib'} & set(sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "set()\n"


def test_no_global_state_is_touched(tmp_path):
    code = (
        "import sys; from shapefit.evaluation.plots import bars as plots, style; "
        "from shapefit.evaluation.summary import Summary; "
        "row = Summary('m', 'similarity', 'm', 'g', 'a', 1, 0, 1.0, 1.0, 1.0); "
        f"style.save(plots.bar_plot([row]), {str(tmp_path / 'a.png')!r}, 'png'); "
        "print('matplotlib.pyplot' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "False\n"


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
    assert colours == [to_rgba(colour) for colour in style.COLOURS[:3] * 2]


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
    assert colours[:2] == [to_rgba(style.COLOURS[0]), to_rgba(style.COLOURS[2])]
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
        style.save(box_plot(errors, GROUPS), tmp_path / turn, "svg")
    assert (tmp_path / "first").read_bytes() == (tmp_path / "second").read_bytes()
