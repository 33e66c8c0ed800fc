"""Figures of the paper's experiments: shares as heat maps, errors against a setting.

Boxes and bars of errors are those of `eval`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from shapefit.evaluation.figures import COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from experiments.car_bodies import Case
    from experiments.recovery import Shares
    from experiments.sensitivity import Point
    from shapefit.arrays import Floats, Integers

LOGARITHMIC = 10
"""Ratio of the largest to the smallest value from which the axis is logarithmic."""


def draw_shares(panels: Mapping[str, Shares]) -> Figure:
    """Draw a heat map for each title: shares of exact recoveries over landmarks p and
    active atoms z, white for 1 and black for 0.
    """
    from matplotlib.figure import Figure

    places = [at for shares in panels.values() for at in shares]
    rows, columns = sorted({p for p, _ in places}), sorted({z for _, z in places})
    size = (0.9 + (0.46 * len(columns) + 0.5) * len(panels), 0.31 * len(rows) + 1.1)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
    for axis, (title, shares) in zip(axes, panels.items(), strict=True):
        table = np.array([[shares.get((p, z), np.nan) for z in columns] for p in rows])
        image = axis.imshow(table, cmap="Greys_r", vmin=0, vmax=1, aspect="auto")
        for (row, column), share in np.ndenumerate(table):
            if np.isfinite(share):
                text = (
                    f"{share:.2f}".removeprefix("0")
                    if 0 < share < 1
                    else f"{share:.0f}"
                )
                ink = "white" if share < 0.5 else "black"
                axis.text(
                    column, row, text, ha="center", va="center", fontsize=7, color=ink
                )
        axis.set_title(title, loc="left", fontsize=10)
        axis.set_xticks(range(len(columns)), map(str, columns))
        axis.set_yticks(range(len(rows)), map(str, rows))
        axis.set_xlabel("atoms in use z")
    axes[0].set_ylabel("landmarks p")
    figure.colorbar(image, ax=list(axes), fraction=0.03, pad=0.02)
    return figure


def draw_cars(cases: Sequence[Case], edges: Integers) -> Figure:
    """Draw a row for each car: its landmarks, and for each method the fitted model in
    the image and the shape from its side.

    edges (e, 2) are the lines of the model; the true shape is grey.
    """
    from matplotlib.figure import Figure

    methods = list(cases[0].fitted)
    columns = 1 + 2 * len(methods)
    figure = Figure(figsize=(2.9 * columns, 1.4 * len(cases)), layout="constrained")
    axes = figure.subplots(len(cases), columns, squeeze=False)
    for row, case in zip(axes, cases, strict=True):
        image, side = [0, 1], [2, 1]  # columns of landmarks, and of shapes seen from it
        row[0].scatter(*case.landmarks.T, s=5, color="black")
        row[0].set_ylabel(case.body)
        for index, method in enumerate(methods):
            fitted, shape = row[1 + 2 * index], row[2 + 2 * index]
            _draw_lines(fitted, case.fitted[method][:, image], edges, COLOURS[index])
            fitted.scatter(*case.landmarks.T, s=5, color="black")
            _draw_lines(shape, case.truth[:, side], edges, "#bbbbbb")
            _draw_lines(shape, case.shapes[method][:, side], edges, COLOURS[index])
        for axis in (row[0], *row[1::2]):
            axis.invert_yaxis()  # pixels are counted downwards
        for axis in row:
            axis.set_aspect("equal")
            axis.set_xticks([])
            axis.set_yticks([])
    axes[0, 0].set_title("landmarks", loc="left", fontsize=9)
    for index, method in enumerate(methods):
        axes[0, 1 + 2 * index].set_title(method, loc="left", fontsize=9)
        axes[0, 2 + 2 * index].set_title(
            "side; true shape grey", loc="left", fontsize=9
        )
    return figure


def _draw_lines(axis: Axes, points: Floats, edges: Integers, colour: str) -> None:
    for edge in edges:
        axis.plot(*points[edge].T, color=colour, linewidth=0.7)


def draw_points(points: Sequence[Point]) -> Figure:
    """Draw the points of an experiment: mean and quartiles of each group of sequences
    against the value, a panel for each metric.

    Values that are names get a last panel with the time of an image.
    """
    from matplotlib.figure import Figure

    metrics = list(dict.fromkeys((point.metric, point.unit) for point in points))
    named = isinstance(points[0].value, str)
    panels = len(metrics) + named
    figure = Figure(figsize=(4.7 * panels, 3.6), layout="constrained")
    axes = figure.subplots(1, panels, squeeze=False)[0]
    for axis, (metric, unit) in zip(axes, metrics, strict=False):
        for index, group in enumerate(dict.fromkeys(point.group for point in points)):
            own = [p for p in points if (p.metric, p.group) == (metric, group)]
            _draw_group(axis, own, group, COLOURS[index % len(COLOURS)])
        axis.set_title(
            f"{metric} ({unit}), mean and quartiles", loc="left", fontsize=10
        )
        axis.set_ylim(bottom=0)
        axis.set_xlabel(points[0].key)
    if named:
        times = {str(point.value): 1000 * point.seconds_per_image for point in points}
        bars = axes[-1].barh(list(times), list(times.values()), color="#333333")
        axes[-1].bar_label(bars, [f"{time:.3g}" for time in times.values()], padding=3)
        axes[-1].set_xscale("log")
        axes[-1].set_title("Time per image (ms)", loc="left", fontsize=10)
    axes[0].legend(frameon=False)
    return figure


def _draw_group(axis: Axes, points: Sequence[Point], group: str, colour: str) -> None:
    values = [point.value for point in points]
    low, high = [point.p25 for point in points], [point.p75 for point in points]
    axis.fill_between(values, low, high, color=colour, alpha=0.15, linewidth=0)
    axis.plot(values, [point.mean for point in points], "o-", color=colour, label=group)
    numbers = [float(value) for value in values if not isinstance(value, str)]
    if numbers and min(numbers) > 0 and max(numbers) >= LOGARITHMIC * min(numbers):
        axis.set_xscale("log")
        axis.minorticks_off()
        axis.set_xticks(numbers, [f"{value:g}" for value in numbers])
