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


def test_boxes_go_from_quartile_to_quartile_and_failed_images_lower_the_curve():
    values = np.array([*np.arange(101.0), *[np.nan] * 101])
    boxes, curve = axes_of(f.draw_errors({"all": {"a": values}}, "mm"))
    box, *_ = boxes.lines
    assert {*box.get_xdata()} == {25.0, 75.0}
    ends = [line.get_xdata() for line in boxes.lines[1:3]]
    assert [[*x] for x in ends] == [[5, 25], [75, 95]]
    assert [*boxes.lines[5].get_xdata()] == [50, 50]
    assert [*boxes.lines[6].get_xdata()] == [50]  # the mean
    (line,) = curve.lines
    assert line.get_ydata().max() == pytest.approx(50)
    assert curve.get_legend() is None


def test_methods_of_one_colour_differ_otherwise():
    looks = [f.look_of(place) for place in range(len(METHODS))]
    assert len(set(looks)) == len(METHODS)


@pytest.mark.parametrize(("count", "is_bars"), [(40, True), (250, False)])
def test_sequences_are_bars_and_too_many_of_them_dots(count, is_bars):
    names = [f"s{n:03}" for n in range(count)]
    means = {"a": {name: float(n) for n, name in enumerate(names)}}
    (axes,) = axes_of(f.draw_sequences({"all": means}, "mm"))
    assert bool(axes.patches) == is_bars
    labels = [label.get_text() for label in axes.get_xticklabels()]
    if is_bars:
        heights = [bar.get_height() for bar in axes.patches]
        assert labels == [*names, "mean"]
    else:
        (dots,) = axes.lines
        heights = [*dots.get_ydata()]
        assert labels == ["mean"]
        assert "250 sequences" in axes.get_xlabel()
    assert heights[-1] == pytest.approx((count - 1) / 2)


def test_of_many_landmarks_the_worst_have_their_names():
    names = [f"landmark {n}" for n in range(30)]
    errors = np.arange(30.0)
    errors[29] = np.nan
    rng = np.random.default_rng(0)
    edges = np.empty((0, 2), np.int64)
    typical = f.TypicalShape(rng.standard_normal((3, 30)), edges)
    figure = f.draw_landmarks({"a": errors}, names, typical, "mm")
    dots, *_ = axes_of(figure)
    labels = [label.get_text() for label in dots.get_yticklabels()]
    assert labels == names[9:29]
    assert "the worst 20 of 30" in dots.get_xlabel()


@pytest.mark.parametrize("methods", [METHODS[:1], METHODS])
def test_every_figure_is_drawn_of_one_and_of_many_methods(methods):
    rng = np.random.default_rng(0)
    errors = {name: rng.uniform(10, 90, 50) for name in methods}
    means = {name: {"a": 1.0, "b": 2.0} for name in methods}
    names = list("abcdef")
    shape = rng.standard_normal((3, 6))
    hidden = shape.copy()
    hidden[:, 2] = np.nan
    edges = np.array([[0, 1], [1, 2]])
    triangles = rng.standard_normal((4, 3, 3))
    example = f.Example("best", shape[:2], shape, hidden, triangles)
    unseen = f.Example("worst", None, hidden, shape)
    drawn = {
        "errors": f.draw_errors({"G": errors, "H": errors}, "mm"),
        "sequences": f.draw_sequences({"G": means, "H": means}, "mm"),
        "landmarks": f.draw_landmarks(
            {name: rng.uniform(1, 2, 6) for name in methods},
            names,
            f.TypicalShape(hidden, edges, triangles),
            "mm",
        ),
        "examples": f.draw_examples([[example], [example, unseen]], edges),
        "bars": f.draw_bars(dict.fromkeys(methods, f.LEVELS)),
    }
    assert drawn.keys() == f.PANELS.keys()
    for name, figure in drawn.items():
        svg = f.figure_bytes(figure, "svg")
        text = inline_svg(name, svg.decode(), "title")
        # a panel of the page for each of the figure, whose widths add up
        views = re.findall(r'viewBox="([\d.]+) 0 ([\d.]+) ', text)
        assert len(views) == len(f.PANELS[name])
        left, width = map(float, views[-1])
        assert left + width == pytest.approx(72 * f.FIGURE_INCHES, abs=0.1)
        # nothing in it has an id of another figure, or a colour of paper
        assert all(i.startswith(f"{name}-") for i in re.findall(r'\bid="([^"]+)', text))
        assert f.INK not in re.sub(">[^<]*<", "><", text)
        assert b'fill="#ffffff"' in f.on_white(svg)


def test_true_bars_lie_on_the_diagonal():
    rng = np.random.default_rng(0)
    square = (rng.standard_normal((20_000, 3)) ** 2).sum(axis=1).reshape(-1, 5)
    square[0] = np.nan
    bars = ErrorBars(square, {})
    assert_allclose(bars.held(f.LEVELS), f.LEVELS, atol=0.012)
    half = ErrorBars(square / 4, {}).held(np.array([0.5]))
    assert half[0] > 0.9


def test_a_section_takes_the_place_of_the_one_of_its_name():
    page = f"<p>a</p>\n{ORIGIN}<dl></dl>"
    once = with_section(page, "x", "<p>first</p>")
    assert once.index("first") < once.index(ORIGIN)
    again = with_section(once, "x", "<p>second</p>")
    assert "first" not in again
    assert with_section(again, "x", "<p>first</p>") == once


def test_the_legend_of_many_methods_has_columns_as_wide_as_their_names():
    short = [f"method {number}" for number in range(11)]
    assert f._legend_lines(short) < f._legend_lines(short, 0.6) <= 3
    long = [f"the first of the longer names {number}" for number in range(5)]
    assert f._legend_lines([*long, *short[:6]], 0.6) == 6
    assert f._legend_lines(long, 0.3) == 5
    assert f._legend_lines(["one"]) == 0
