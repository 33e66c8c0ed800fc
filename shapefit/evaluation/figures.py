"""Figures of an evaluation: errors, sequences, landmarks, examples, error bars.

Functions take arrays and give matplotlib figures, which need no screen. Lengths are in
the unit that people read. A figure of several panels has them side by side in columns
of known width, so that a page can put them one below the other.
"""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.errors import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

# Okabe and Ito 2008, as dark as light: read on white and on the dark of a page.
COLOURS = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#CC79A7",
    "#E69F00",
    "#56B4E9",
    "#7f7f7f",
)

DASHES = ("solid", (0, (3, 1.2)), (0, (1, 1)))
"""Of lines, one for each round of colours."""

MARKERS = ("o", "^", "s")
"""Of dots, one for each round of colours."""

INK = "#1d2430"
"""Of text and landmarks; a page puts its own in its place, as for the next two."""

GRID = "#d0d4da"
"""Of lines behind the data."""

TRUTH = "#9aa3af"
"""Of the true shapes."""

MESH = "#c3cad4"
"""Of true meshes, on white as on dark."""

STYLE: dict[str, object] = {
    "font.size": 9,
    "font.family": "sans-serif",
    "text.color": INK,
    # Names may hold dollars, which are no mathematics.
    "text.parse_math": False,
    "axes.edgecolor": GRID,
    "axes.labelcolor": INK,
    "axes.labelsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "legend.handlelength": 1.2,
    "legend.columnspacing": 1.0,
    "savefig.dpi": 160,
    # Text stays text, and the same figure gives the same bytes.
    "svg.fonttype": "none",
    "svg.hashsalt": "shapefit",
}

FIGURE_INCHES = 8.0
"""Width of a figure."""

PANELS: dict[str, tuple[float, ...]] = {
    "errors": (0.5, 0.5),
    "sequences": (1.0,),
    "landmarks": (0.6, 0.4),
    "examples": (0.5, 0.5),
    "bars": (0.5, 0.5),
}
"""Figures in their order, and the shares of the width that their panels take."""

ROW_INCHES = 0.24
"""Height of a line of names."""

MIN_BOX_LINES = 3
"""Lines for which there is room beside boxes, so that few are not huge."""

NAME_LETTERS = 24
"""Letters of a method in a line of its name, which has two lines at most."""

SHORT_NAME_LETTERS = 16
"""Last letters of a sequence below an axis."""

LANDMARK_LETTERS = 36
"""Last letters of a landmark beside an axis."""

MAX_BARS = 200
"""Beyond so many bars errors of sequences are dots."""

MAX_NAMED_SEQUENCES = 60
"""Beyond so many sequences these have no names."""

MAX_LANDMARKS = 20
"""Landmarks with a name; of more the worst are shown."""

MANY_LANDMARKS = 40
"""From so many on landmarks are drawn small."""

CURVE_POINTS = 400
"""Of a curve, at most."""

SHOWN_SHARE = 0.99
"""Share of images that the axis of errors reaches."""

WHISKERS = (5, 95)
"""Percentiles where whiskers end."""

LEVELS = np.arange(0.05, 1.0, 0.05)
"""Of error bars."""

SAID_LEVELS = (0.5, 0.9)
"""Levels whose shares are written beside the curves."""

VIEW_TURN = np.deg2rad(30)
"""By which the mean shape is turned about its vertical."""

EXAMPLE_MARGIN = 0.08
"""Free border of an example, as a share of its size."""


VIEWS = ((0, 1), (2, 1))
"""Axes of the views from the camera and from its side."""

LEGEND_LINE_INCHES = 0.2
"""Height of a line of a legend above the axes."""

LEGEND_LETTERS = 32
"""Last letters of a method in a legend."""


class Look(NamedTuple):
    """How the lines and dots of a method are drawn."""

    colour: str
    dash: str | tuple[int, tuple[float, ...]]
    marker: str


class Example(NamedTuple):
    """An image beside its truth.

    landmarks (2, p) in the image, None where none are known; truth and estimate (3, p),
    aligned; mesh (f, 3, 3): the triangles of the true shape, where it has them. x is
    right, y up and z towards the viewer; nan where unknown.
    """

    title: str
    landmarks: Floats | None
    truth: Floats
    estimate: Floats
    mesh: Floats | None = None


class TypicalShape(NamedTuple):
    """A shape (3, p) that stands for all, y up, with its edges (e, 2).

    mesh (f, 3, 3): its triangles, where it has them.
    """

    shape: Floats
    edges: Integers
    mesh: Floats | None = None


def look_of(place: int) -> Look:
    """Return colour, dash and marker of the method with the index `place`."""
    turn, colour = divmod(place, len(COLOURS))
    again = turn % len(DASHES)
    return Look(COLOURS[colour], DASHES[again], MARKERS[again])


@contextmanager
def style() -> Iterator[None]:
    """Give figures that the block draws and saves the style of reports.

    Figures take some of their style when they are made, some when they are saved. There
    is no warning of letters that a font lacks.
    """
    import matplotlib

    with matplotlib.rc_context(STYLE), warnings.catch_warnings():  # type: ignore[arg-type]
        warnings.simplefilter("ignore", UserWarning)
        yield


def draw_errors(groups: Mapping[str, Mapping[str, Floats]], unit: str) -> Figure:
    """Draw box plots of errors by group and method, and cumulative shares of images.

    groups: name -> method -> errors (n,), nan where an image failed.
    """
    methods = [*dict.fromkeys(name for errors in groups.values() for name in errors)]
    rows = len(methods) * len(groups) + (len(groups) if len(groups) > 1 else 0)
    figure, (left, right) = _panels("errors", max(2.6, 0.7 + 1.25 * ROW_INCHES * rows))
    _draw_boxes(left.subplots(), groups, methods, unit)
    _draw_shares(right.subplots(), groups, methods, unit)
    return figure


def _draw_boxes(
    axes: Axes,
    groups: Mapping[str, Mapping[str, Floats]],
    methods: Sequence[str],
    unit: str,
) -> None:
    """Draw a box plot of errors for each group and method, with their names."""
    labels: list[str] = []
    places: list[float] = []
    line = 0.0
    for group, errors in groups.items():
        if len(groups) > 1:
            heading = _in_two_lines(group)
            axes.text(0, line, f" {heading}", va="center", weight="bold", fontsize=8)
            line += 1
        for number, method in enumerate(methods):
            values = errors.get(method, np.empty(0))
            values = values[np.isfinite(values)]
            if len(values):
                _draw_box(axes, values, line, look_of(number))
            labels.append(_in_two_lines(method))
            places.append(line)
            line += 1
    axes.set_yticks(places, labels, fontsize=8)
    room = max(MIN_BOX_LINES - line, 0) / 2
    axes.set_ylim(line - 0.4 + room, -0.6 - room)
    axes.set_xlim(left=0)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel(f"error of an image ({unit})")


def _draw_box(axes: Axes, values: Floats, line: float, look: Look) -> None:
    """Draw a box plot of finite errors (n,) at the height `line` of the axes."""
    low, *box, high = np.percentile(values, (WHISKERS[0], 25, 50, 75, WHISKERS[1]))
    first, middle, third = box
    top = line - 0.3
    bottom = line + 0.3
    pieces = (
        ([first, third, third, first, first], [top, top, bottom, bottom, top]),
        ([low, first], [line, line]),
        ([third, high], [line, line]),
        ([low, low], [line - 0.15, line + 0.15]),
        ([high, high], [line - 0.15, line + 0.15]),
    )
    for number, (x, y) in enumerate(pieces):
        dash = look.dash if number == 0 else "solid"
        axes.plot(x, y, color=look.colour, linewidth=1.2, linestyle=dash)
    axes.plot([middle, middle], [top, bottom], color=look.colour, linewidth=2.4)
    axes.plot([values.mean()], [line], "D", color=look.colour, markersize=4)


def _draw_shares(
    axes: Axes,
    groups: Mapping[str, Mapping[str, Floats]],
    methods: Sequence[str],
    unit: str,
) -> None:
    """Draw a curve a method: the share of images whose error is below each value."""
    highest = 0.0
    for number, method in enumerate(methods):
        errors = np.concatenate(
            [of_group[method] for of_group in groups.values() if method in of_group]
        )
        values = errors[np.isfinite(errors)]
        if not len(values):
            continue
        look = look_of(number)
        shares = np.linspace(0, 1, min(len(values), CURVE_POINTS))
        axes.plot(
            np.quantile(values, shares),
            100 * shares * len(values) / len(errors),
            color=look.colour,
            linestyle=look.dash,
            label=_legend_name(method),
        )
        highest = max(highest, float(np.quantile(values, SHOWN_SHARE)))
    axes.set(
        xlabel=f"error of an image ({unit})",
        ylabel="images with a smaller error (%)",
        xlim=(0, 1.05 * highest or None),
        ylim=(0, 100),
    )
    if 1 < len(methods) <= len(COLOURS):
        axes.legend(loc="lower right", fontsize=8)


def draw_sequences(
    groups: Mapping[str, Mapping[str, Mapping[str, float]]], unit: str
) -> Figure:
    """Draw mean errors by sequence and method, and their mean, a row for each group.

    groups: name -> method -> sequence -> mean error. Bars, or dots where bars are too
    many.
    """
    methods = [*dict.fromkeys(name for means in groups.values() for name in means)]
    legend = _legend_lines(methods)
    height = 2.5 * len(groups) + LEGEND_LINE_INCHES * legend + 0.1
    figure, (whole,) = _panels("sequences", height)
    rows = whole.subplots(len(groups), 1, squeeze=False)[:, 0]
    for axes, (group, means) in zip(rows, groups.items(), strict=True):
        _draw_group(axes, means, methods)
        axes.set_ylabel(f"mean error ({unit})")
        if len(groups) > 1:
            axes.set_title(_in_two_lines(group), fontsize=9, weight="bold")
    _draw_legend(whole, methods, legend)
    return figure


def _draw_group(
    axes: Axes, means: Mapping[str, Mapping[str, float]], methods: Sequence[str]
) -> None:
    """Draw mean errors of a group by sequence and method, their means at the end."""
    names = [*dict.fromkeys(name for of_method in means.values() for name in of_method)]
    is_bars = len(names) * len(methods) <= MAX_BARS
    if not is_bars:
        names.sort(key=lambda name: _mean([of.get(name) for of in means.values()]))
    x = np.arange(len(names) + 1.0)
    x[-1] += 0.6
    width = 0.8 / len(methods)
    for number, method in enumerate(methods):
        of_method = means.get(method, {})
        values = [of_method.get(name, np.nan) for name in names]
        values.append(_mean([of_method.get(name) for name in names]))
        look = look_of(number)
        if is_bars:
            offset = width * (number - (len(methods) - 1) / 2)
            # A later round of colours is hatched.
            hatch = "" if look.dash == DASHES[0] else "////"
            axes.bar(
                x + offset,
                values,
                width,
                color=look.colour,
                hatch=hatch,
                edgecolor=GRID,
                linewidth=0,
            )
        else:
            axes.plot(x, values, look.marker, markersize=3.5, color=look.colour)
    _name_sequences(axes, x, names, is_sorted=not is_bars)
    axes.grid(axis="x", visible=not is_bars and len(names) <= MAX_NAMED_SEQUENCES)
    axes.set_ylim(bottom=0)
    axes.set_xlim(x[0] - 0.7, x[-1] + 0.7)


def _name_sequences(
    axes: Axes, x: Floats, names: Sequence[str], *, is_sorted: bool
) -> None:
    """Write the names of sequences below an axis, level where they are short."""
    if len(names) > MAX_NAMED_SEQUENCES:
        axes.set_xticks(x[-1:], ["mean"])
        axes.set_xlabel(f"{len(names)} sequences, the easiest first", loc="left")
        return
    short = [_last_letters(name) for name in names]
    is_level = len(names) < 12 and max(map(len, short)) < 9
    axes.set_xticks(
        x,
        [*short, "mean"],
        rotation=0 if is_level else 60,
        ha="center" if is_level else "right",
        rotation_mode="anchor",
        fontsize=9 if len(names) < 25 else 6.5,
    )
    axes.tick_params(axis="x", length=0)
    if is_sorted:
        axes.set_xlabel("sequences, the easiest first", fontsize=8, loc="left")


def draw_landmarks(
    errors: Mapping[str, Floats],
    names: Sequence[str],
    typical: TypicalShape,
    unit: str,
) -> Figure:
    """Draw mean errors (p,) of landmarks by method, and of the first one on a shape.

    errors: method -> errors, nan where a method lacks the landmark.
    """
    first = next(iter(errors.values()))
    order = np.argsort(np.where(np.isnan(first), np.inf, -first), kind="stable")
    shown = np.sort(order[:MAX_LANDMARKS])
    legend = _legend_lines([*errors], PANELS["landmarks"][0])
    height = max(2.8, 0.7 + 0.19 * len(shown) + LEGEND_LINE_INCHES * legend)
    figure, (left, right) = _panels("landmarks", height)
    axes = left.subplots()
    for number, values in enumerate(errors.values()):
        look = look_of(number)
        axes.plot(
            values[shown],
            range(len(shown)),
            look.marker,
            markersize=5,
            color=look.colour,
        )
    axes.set_yticks(
        range(len(shown)),
        [_last_letters(names[j], LANDMARK_LETTERS) for j in shown],
        fontsize=8,
    )
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    worst = ""
    if len(shown) < len(names):
        worst = f",\nthe worst {len(shown)} of {len(names)}"
    axes.set(xlabel=f"mean error of a landmark ({unit}){worst}", xlim=(0, None))
    _draw_legend(left, [*errors], legend)
    _draw_typical(
        right, typical, first, f"{_in_two_lines(next(iter(errors)))} ({unit})"
    )
    return figure


def _draw_typical(
    panel: SubFigure, typical: TypicalShape, errors: Floats, title: str
) -> None:
    """Draw a typical shape, its landmarks coloured by their errors (p,)."""
    axes = panel.subplots()
    flat = _project_from_side(typical.shape)
    _draw_lines(axes, flat, typical.edges, GRID, 2.5)
    if typical.mesh is not None:
        _draw_mesh(
            axes, _project_from_side(typical.mesh.transpose(2, 0, 1)).transpose(1, 2, 0)
        )
    x, y = flat
    marks = axes.scatter(
        x,
        y,
        c=errors,
        cmap="viridis_r",
        vmin=0,
        s=60 if len(errors) < MANY_LANDMARKS else 18,
        edgecolors=INK,
        linewidths=0.5,
        zorder=2,
    )
    colour_bar = panel.colorbar(marks, ax=axes, fraction=0.05, pad=0.02)
    colour_bar.ax.grid(visible=False)
    colour_bar.outline.set_visible(False)  # type: ignore[operator]
    colour_bar.solids.set_rasterized(True)  # type: ignore[union-attr]
    axes.set_aspect("equal")
    axes.margins(0.12)
    axes.axis("off")
    colour_bar.set_label(title)


def draw_examples(rows: Sequence[Sequence[Example]], edges: Integers) -> Figure:
    """Draw images: their landmarks, then truth and estimate from two sides.

    Rows of examples of the best, median and worst images; edges (e, 2) are the lines
    of the shapes.
    """
    from matplotlib.figure import Figure

    examples = [one for row in rows for one in row]
    columns = len(PANELS["examples"])
    panel_inches = FIGURE_INCHES / (3 * columns)
    shape = float(np.median([_height_by_width(one.truth) for one in examples]))
    inches = float(np.clip(panel_inches * shape, 0.55, 1.7))
    title_inches = 0.26
    row_inches = inches + title_inches
    height = row_inches * len(rows)
    figure = Figure(figsize=(FIGURE_INCHES, height))
    for row_number, row in enumerate(rows):
        top = 1 - row_number * row_inches / height
        for column, one in enumerate(row):
            left = column / columns
            figure.text(
                left + 0.01, top - 0.19 / height, printable(one.title), fontsize=8.5
            )
            for place in range(3):
                axes = figure.add_axes(
                    (
                        left + place / (3 * columns),
                        top - row_inches / height,
                        1 / (3 * columns),
                        inches / height,
                    )
                )
                axes.axis("off")
                _draw_example(axes, one, place, edges, inches / panel_inches)
    return figure


def _draw_example(
    axes: Axes, one: Example, place: int, edges: Integers, aspect: float
) -> None:
    """Draw a panel of an example: landmarks, or the shapes from the camera or the side.

    place: 0, 1 or 2 for these; aspect: the height of the panel over its width.
    """
    if place == 0:
        if one.landmarks is not None:
            _draw_skeleton(axes, one.landmarks, edges, INK, 1.0)
            _frame(axes, one.landmarks, aspect)
        return
    view = list(VIEWS[place - 1])
    if one.mesh is not None:
        _draw_mesh(axes, one.mesh[:, :, view])
    _draw_skeleton(axes, one.truth[view], edges, TRUTH, 3.0)
    _draw_skeleton(axes, one.estimate[view], edges, COLOURS[0], 1.4)
    apart = np.stack([one.truth[view], one.estimate[view]], axis=2)
    axes.plot(*_one_line_with_gaps(apart), color=COLOURS[1], linewidth=0.8)
    parts = [one.truth, one.estimate]
    if one.mesh is not None:
        parts.append(one.mesh.reshape(-1, 3).T)
    # Both views have one scale, that of the larger one.
    sides = [
        np.concatenate([part[list(view)] for part in parts], axis=1) for view in VIEWS
    ]
    half = max(_half_width(side, aspect) for side in sides)
    _frame(axes, sides[place - 1], aspect, half)


def _half_width(points: Floats, aspect: float) -> float:
    """Return half the width of axes that show all points (2, m) with a margin.

    aspect: height by width of the panel.
    """
    size = np.nanmax(points, axis=1) - np.nanmin(points, axis=1)
    widest = max(float(size[0]), float(size[1]) / aspect, 1e-9)
    return (0.5 + EXAMPLE_MARGIN) * widest


def _frame(
    axes: Axes, points: Floats, aspect: float, half: float | None = None
) -> None:
    """Set the limits of axes so that all points (2, m) are shown, on one scale.

    aspect: height by width of the panel; half: half the width, by default that of the
    points.
    """
    if half is None:
        half = _half_width(points, aspect)
    x, y = (np.nanmax(points, axis=1) + np.nanmin(points, axis=1)) / 2
    axes.set_xlim(x - half, x + half)
    axes.set_ylim(y - half * aspect, y + half * aspect)


def _height_by_width(shape: Floats) -> float:
    """Return the height of a shape (3, p) over the larger of its width and depth."""
    size = np.nanmax(shape, axis=1) - np.nanmin(shape, axis=1)
    return float(size[1] / max(size[0], size[2], 1e-9))


def draw_bars(coverage: Mapping[str, Floats]) -> Figure:
    """Draw the coverage of error bars over their nominal `LEVELS`, a line a method.

    coverage: method -> the share of landmarks inside, for each level. Bars that are
    true lie on the diagonal.
    """
    figure, (left, right) = _panels("bars", 3.2)
    axes = left.subplots()
    axes.plot([0, 100], [0, 100], color=GRID, linewidth=2)
    for number, (method, shares) in enumerate(coverage.items()):
        look = look_of(number)
        axes.plot(
            100 * LEVELS,
            100 * shares,
            marker=look.marker,
            markersize=3,
            linestyle=look.dash,
            color=look.colour,
            label=f"{_legend_name(method)}\n{_describe_coverage(shares)}",
        )
    axes.set(
        xlabel="what the error bars state (%)",
        ylabel="true landmarks inside them (%)",
        xlim=(0, 100),
        ylim=(0, 100),
        aspect="equal",
    )
    axes.text(4, 92, "bars too wide", fontsize=8)
    axes.text(96, 5, "bars too narrow", fontsize=8, ha="right")
    handles, labels = axes.get_legend_handles_labels()
    right.legend(handles, labels, loc="upper left")
    return figure


def _describe_coverage(shares: Floats) -> str:
    """Return in words the coverage at `SAID_LEVELS`, of the shares at all `LEVELS`."""
    texts = []
    for level in SAID_LEVELS:
        share = shares[np.abs(LEVELS - level).argmin()]
        texts.append(f"{level:.0%} bars hold {share:.0%}")
    return ", ".join(texts)


def _panels(name: str, height: float) -> tuple[Figure, Sequence[SubFigure]]:
    """Return an empty figure, `height` inches high, and its panels as in `PANELS`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(FIGURE_INCHES, height), layout="constrained")
    shares = PANELS[name]
    panels = figure.subfigures(1, len(shares), width_ratios=shares, squeeze=False)[0]
    return figure, list(panels)


def _legend_lines(methods: Sequence[str], share: float = 1.0) -> int:
    """Return how many lines the legend above a panel takes; none for one method.

    share: of the width of the figure. As many columns as fit, each as wide as its
    longest name.
    """
    if len(methods) < 2:
        return 0
    letters = [len(_legend_name(method)) for method in methods]
    for lines in range(1, len(methods)):
        columns = np.array_split(letters, -(-len(letters) // lines))
        inches = sum(_legend_column_inches(max(column)) for column in columns)
        if inches <= share * FIGURE_INCHES:
            return lines
    return len(methods)


def _legend_column_inches(letters: int) -> float:
    """Return the width in inches of a legend's column whose names have `letters`."""
    return 0.35 + 0.07 * letters


def _draw_legend(panel: SubFigure, methods: Sequence[str], lines: int) -> None:
    """Draw the legend of methods above the axes of a panel."""
    from matplotlib.lines import Line2D

    if not lines:
        return
    handles = [
        Line2D(
            [], [], linestyle="", marker=look.marker, markersize=6, color=look.colour
        )
        for look in map(look_of, range(len(methods)))
    ]
    panel.legend(
        handles,
        [_legend_name(method) for method in methods],
        loc="outside upper left",
        ncols=-(-len(methods) // lines),
        handletextpad=0.2,
        fontsize=8,
    )


def _draw_skeleton(
    axes: Axes, points: Floats, edges: Integers, colour: str, width: float
) -> None:
    """Draw points (2, p) and the edges (e, 2) between them."""
    _draw_lines(axes, points, edges, colour, width)
    size = width + 1.2 if len(edges) else 2.0
    axes.plot(*points, "o", color=colour, markersize=size, markeredgewidth=0)


def _draw_lines(
    axes: Axes, points: Floats, edges: Integers, colour: str, width: float
) -> None:
    """Draw the edges (e, 2) between points (2, p) as one line with gaps."""
    if not len(edges):
        return
    axes.plot(
        *_one_line_with_gaps(points[:, edges]),
        color=colour,
        linewidth=width,
        solid_capstyle="round",
        zorder=1,
    )


def _one_line_with_gaps(ends: Floats) -> Floats:
    """Return m lines between two ends each (2, m, 2) as one (2, 3 m), nan between them.

    One line is drawn faster than many.
    """
    gap = np.full_like(ends[:, :, :1], np.nan)
    return np.concatenate([ends, gap], axis=2).reshape(2, -1)


def _draw_mesh(axes: Axes, triangles: Floats) -> None:
    """Draw the silhouette of triangles (f, 3, 2), as a picture: they are many."""
    from matplotlib.collections import PolyCollection

    mesh = PolyCollection(
        list(triangles), facecolors=MESH, edgecolors=MESH, linewidths=0.3, zorder=0
    )
    mesh.set_rasterized(True)
    axes.add_collection(mesh)


def _project_from_side(points: Floats) -> Floats:
    """Return points (3, ...) seen a little from the side: (2, ...)."""
    x, y, z = points
    return np.stack([np.cos(VIEW_TURN) * x + np.sin(VIEW_TURN) * z, y])


def _mean(values: Sequence[float | None]) -> float:
    """Return the mean of the values that are known, nan for none."""
    known = [value for value in values if value is not None and np.isfinite(value)]
    return float(np.mean(known)) if known else float("nan")


def _in_two_lines(name: str) -> str:
    """Return a name wrapped to two lines at most, and shortened if it is longer."""
    text = printable(name)
    lines = textwrap.wrap(text, NAME_LETTERS, max_lines=2, placeholder="…")
    return "\n".join(lines)


def _last_letters(name: str, max_letters: int = SHORT_NAME_LETTERS) -> str:
    """Return a name shortened to its last letters, which tell it from others."""
    text = printable(name)
    return text if len(text) <= max_letters else f"…{text[1 - max_letters :]}"


def _legend_name(name: str) -> str:
    """Return a name as legends show it: matplotlib omits those that begin with _."""
    short = _last_letters(name, LEGEND_LETTERS)
    return f" {short}" if short.startswith("_") else short


def figure_bytes(figure: Figure, file_format: str) -> bytes:
    """Return a figure as svg, png or pdf; the same figure gives the same bytes."""
    metadata: dict[str, dict[str, None]] = {
        "svg": {"Date": None, "Creator": None},
        "pdf": {"CreationDate": None, "Producer": None, "Creator": None},
        "png": {"Software": None},
    }
    file = BytesIO()
    figure.savefig(
        file,
        format=file_format,
        metadata=metadata[file_format],
        # A page has a ground of its own; files get theirs, see `on_white`.
        transparent=file_format == "svg",
    )
    return file.getvalue()


def on_white(svg: bytes) -> bytes:
    """Return a figure (SVG) on white, for papers and for viewers with a dark ground."""
    ground = b'<rect width="100%" height="100%" fill="#ffffff"/>'
    return svg.replace(b"<defs>", ground + b"<defs>", 1)
