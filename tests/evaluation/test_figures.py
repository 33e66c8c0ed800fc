"""What figures show: boxes, bars or dots, names, panels; and parts of a page."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shapefit.evaluation import figures as f
from shapefit.evaluation.calibration import ErrorBars
from shapefit.evaluation.page import ORIGIN, inline_svg, with_section

METHODS = [f"method {n} with a name of some length" for n in range(11)]


@pytest.fixture(autouse=True)
def style():
    with f.style():
        yield


def axes_of(figure):
    return [axes for panel in figure.subfigs for axes in panel.axes]


class TestErrors:
    """Errors 0 to 100 of as many images as have failed."""

    @pytest.fixture
    def panels(self):
        measured = np.arange(101.0)
        failed = np.full(101, np.nan)
        errors = np.concatenate([measured, failed])
        return axes_of(f.draw_errors({"all": {"a": errors}}, "mm"))

    def test_boxes_go_from_quartile_to_quartile(self, panels):
        boxes, _ = panels
        box, lower, upper, _, _, median, mean = (
            [*line.get_xdata()] for line in boxes.lines
        )
        assert {*box} == {25.0, 75.0}
        assert lower == [5, 25]
        assert upper == [75, 95]
        assert median == [50, 50]
        assert mean == [50]

    def test_failed_images_lower_the_curve(self, panels):
        _, curve = panels
        (line,) = curve.lines
        assert line.get_ydata().max() == pytest.approx(50)

    def test_the_curve_of_one_method_needs_no_legend(self, panels):
        _, curve = panels
        assert curve.get_legend() is None


def test_methods_of_one_colour_differ_otherwise():
    looks = [f.look_of(place) for place in range(len(METHODS))]
    assert len(set(looks)) == len(METHODS)


def draw_sequences(count):
    """Draw sequences with errors 0, 1, 2, ...; return their panel and names."""
    names = [f"s{n:03}" for n in range(count)]
    means = {name: float(n) for n, name in enumerate(names)}
    (axes,) = axes_of(f.draw_sequences({"all": {"a": means}}, "mm"))
    return axes, names


def labels_of(ticks):
    return [tick.get_text() for tick in ticks]


def test_sequences_are_bars_before_that_of_their_mean():
    axes, names = draw_sequences(40)
    assert labels_of(axes.get_xticklabels()) == [*names, "mean"]
    assert axes.patches[-1].get_height() == pytest.approx(39 / 2)


def test_the_mean_over_sequences_is_of_those_that_a_method_has():
    """In one of three no image has a shape, a fourth is of the other method alone."""
    means = {"a": {"s": 10.0, "t": np.nan, "u": 30.0}, "b": {"v": 7.0}}
    (axes,) = axes_of(f.draw_sequences({"all": means}, "mm"))
    heights = [bar.get_height() for bar in axes.patches]
    mean_of_a = heights[4]
    assert mean_of_a == 20


def test_too_many_sequences_are_dots():
    axes, _ = draw_sequences(250)
    (dots,) = axes.lines
    assert not axes.patches
    assert labels_of(axes.get_xticklabels()) == ["mean"]
    assert "250 sequences" in axes.get_xlabel()
    assert dots.get_ydata()[-1] == pytest.approx(249 / 2)


def test_of_many_landmarks_the_worst_have_their_names():
    """30 landmarks with errors 0, 1, 2, ..., the last of which none has measured."""
    names = [f"landmark {n}" for n in range(30)]
    errors = np.arange(30.0)
    errors[29] = np.nan
    no_edges = np.empty((0, 2), np.int64)
    points = np.random.default_rng(0).standard_normal((3, 30))
    typical = f.TypicalShape(points, no_edges)

    figure = f.draw_landmarks({"a": errors}, names, typical, "mm")

    dots, *_ = axes_of(figure)
    assert labels_of(dots.get_yticklabels()) == names[9:29]
    assert "the worst 20 of 30" in dots.get_xlabel()


ERRORS = {"a": np.array([3.0, 1.0, 4.0, 2.0]), "b": np.array([5.0, 8.0, 6.0, 7.0])}
"""Method -> errors of four landmarks."""


class TestLandmarks:
    """Their errors by name, and on a shape."""

    NAMES = ("nose", "ear", "eye", "chin")
    SHAPE = np.array([[0.0, 1, 2, 5], [0, 3, 1, 1], [0, 0, 1, 2]])

    @pytest.fixture
    def panels(self):
        typical = f.TypicalShape(self.SHAPE, np.array([[0, 1]]))
        return axes_of(f.draw_landmarks(ERRORS, self.NAMES, typical, "mm"))

    def test_the_error_of_each_stands_at_its_name(self, panels):
        dots, *_ = panels
        labels = labels_of(dots.get_yticklabels())
        names_at = dict(zip(dots.get_yticks(), labels, strict=True))
        for line, errors in zip(dots.lines, ERRORS.values(), strict=True):
            stated = {names_at[y]: x for x, y in line.get_xydata()}
            assert stated == dict(zip(self.NAMES, errors, strict=True))

    def test_the_first_is_above_the_others(self, panels):
        dots, *_ = panels
        bottom, top = dots.get_ylim()
        assert labels_of(dots.get_yticklabels())[0] == "nose"
        assert top < dots.get_yticks()[0] < bottom

    def test_all_of_them_are_not_called_the_worst(self, panels):
        dots, *_ = panels
        assert dots.get_xlabel() == "mean error of a landmark (mm)"

    def test_the_shape_has_the_errors_of_the_first_method(self, panels):
        _, shape, colours = panels
        (marks,) = [each for each in shape.collections if len(each.get_offsets()) == 4]
        assert_allclose(marks.get_array(), ERRORS["a"])
        assert colours.get_ylabel() == "a (mm)"

    def test_the_shape_is_not_stretched(self, panels):
        _, shape, _ = panels
        assert shape.get_aspect() == 1


def draw_names(count, letters):
    """Draw the names of sequences; return their rotations, where their left and right
    ends (count,) are, and where their bars are, in pixels.
    """
    names = [f"{n:0{letters}}" for n in range(count)]
    means = dict.fromkeys(names, 1.0)
    figure = f.draw_sequences({"all": {"a": means}}, "mm")
    figure.draw_without_rendering()
    (axes,) = axes_of(figure)
    *labels, _mean = axes.get_xticklabels()
    x = axes.get_xticks()[:-1]
    bars = axes.transData.transform(np.column_stack([x, 0 * x]))[:, 0]
    boxes = [label.get_window_extent() for label in labels]
    ends = np.array([[box.x0, box.x1] for box in boxes])
    return {label.get_rotation() for label in labels}, ends.T, bars


@pytest.mark.parametrize(("count", "letters"), [(3, 8), (11, 4)])
def test_few_short_names_of_sequences_are_level_below_their_bars(count, letters):
    rotations, (left, right), bars = draw_names(count, letters)
    assert rotations == {0}
    assert_allclose((left + right) / 2, bars, atol=1)
    assert (left[1:] > right[:-1]).all()


@pytest.mark.parametrize(("count", "letters"), [(11, 12), (12, 8), (40, 8)])
def test_other_names_of_sequences_are_oblique_and_end_at_their_bars(count, letters):
    rotations, (left, right), bars = draw_names(count, letters)
    (rotation,) = rotations
    assert 0 < rotation < 90
    assert (bars - left > 2 * abs(right - bars)).all()


def draw_every_figure(methods):
    """Return all figures of a report of these methods, by name."""
    rng = np.random.default_rng(0)
    errors = {name: rng.uniform(10, 90, 50) for name in methods}
    means = {name: {"a": 1.0, "b": 2.0} for name in methods}
    shape = rng.standard_normal((3, 6))
    hidden = shape.copy()
    hidden[:, 2] = np.nan
    edges = np.array([[0, 1], [1, 2]])
    triangles = rng.standard_normal((4, 3, 3))
    typical = f.TypicalShape(hidden, edges, triangles)
    best = f.Example("best", shape[:2], shape, hidden, triangles)
    unseen = f.Example("worst", None, hidden, shape)
    landmark_errors = {name: rng.uniform(1, 2, 6) for name in methods}
    return {
        "errors": f.draw_errors({"G": errors, "H": errors}, "mm"),
        "sequences": f.draw_sequences({"G": means, "H": means}, "mm"),
        "landmarks": f.draw_landmarks(landmark_errors, list("abcdef"), typical, "mm"),
        "examples": f.draw_examples([[best], [best, unseen]], edges),
        "bars": f.draw_bars(dict.fromkeys(methods, f.LEVELS)),
    }


@pytest.fixture(scope="module", params=[METHODS[:1], METHODS], ids=["one", "many"])
def svgs(request):
    """Every figure of one and of many methods, as SVG, by name."""
    with f.style():
        figures = draw_every_figure(request.param)
        return {name: f.figure_bytes(figure, "svg") for name, figure in figures.items()}


FIGURES = [*f.PANELS]


def as_parts_of_a_page(svgs, name):
    return inline_svg(name, svgs[name].decode(), "title")


def test_every_figure_is_drawn_of_one_and_of_many_methods(svgs):
    assert svgs.keys() == f.PANELS.keys()


@pytest.mark.parametrize("name", FIGURES)
def test_the_page_has_each_panel_and_their_widths_add_up(svgs, name):
    text = as_parts_of_a_page(svgs, name)

    views = re.findall(r'viewBox="([\d.]+) 0 ([\d.]+) ', text)

    left, width = map(float, views[-1])
    assert len(views) == len(f.PANELS[name])
    assert left + width == pytest.approx(72 * f.FIGURE_INCHES, abs=0.1)


@pytest.mark.parametrize("name", FIGURES)
def test_no_figure_has_an_id_of_another(svgs, name):
    text = as_parts_of_a_page(svgs, name)
    for identifier in re.findall(r'\bid="([^"]+)', text):
        assert identifier.startswith(f"{name}-")


@pytest.mark.parametrize("name", FIGURES)
def test_no_figure_of_the_page_has_a_colour_of_paper(svgs, name):
    text = as_parts_of_a_page(svgs, name)
    tags = re.sub(">[^<]*<", "><", text)
    assert f.INK not in tags


@pytest.mark.parametrize("name", FIGURES)
def test_beside_the_page_a_figure_is_on_white(svgs, name):
    assert b'fill="#ffffff"' in f.on_white(svgs[name])


@pytest.fixture
def squares():
    """Squared errors as true bars have them; those of the first image are unknown."""
    errors = np.random.default_rng(0).standard_normal((20_000, 3))
    squares = (errors**2).sum(axis=1).reshape(-1, 5)
    squares[0] = np.nan
    return squares


def test_true_bars_lie_on_the_diagonal(squares):
    coverage = ErrorBars(squares, {}).coverage(f.LEVELS)
    assert_allclose(coverage, f.LEVELS, atol=0.012)


def test_bars_twice_as_wide_as_they_need_to_be_hold_more(squares):
    (coverage,) = ErrorBars(squares / 4, {}).coverage(np.array([0.5]))
    assert coverage > 0.9


def test_a_section_stands_before_the_origin():
    page = with_section(f"<p>a</p>\n{ORIGIN}<dl></dl>", "x", "<p>first</p>")
    assert page.index("first") < page.index(ORIGIN)


def test_a_section_takes_the_place_of_the_one_of_its_name():
    first = with_section(f"<p>a</p>\n{ORIGIN}<dl></dl>", "x", "<p>first</p>")
    second = with_section(first, "x", "<p>second</p>")
    assert "first" not in second
    assert with_section(second, "x", "<p>first</p>") == first


SHORT_NAMES = [f"method {number}" for number in range(11)]
LONG_NAMES = [f"the first of the longer names {number}" for number in range(5)]


def test_the_legend_of_many_methods_has_columns_as_wide_as_their_names():
    lines = f._legend_lines(SHORT_NAMES)
    lines_where_narrow = f._legend_lines(SHORT_NAMES, 0.6)
    assert lines < lines_where_narrow <= 3


@pytest.mark.parametrize(
    ("methods", "share", "lines"),
    [([*LONG_NAMES, *SHORT_NAMES[:6]], 0.6, 6), (LONG_NAMES, 0.3, 5)],
)
def test_the_legend_of_long_names_has_a_line_for_each_or_for_two(methods, share, lines):
    assert f._legend_lines(methods, share) == lines


def test_one_method_needs_no_legend():
    assert f._legend_lines(["one"]) == 0
