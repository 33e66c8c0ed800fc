"""Sweeps and recovery drawn: the error against a key that varied, and shares as heat maps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from shapefit.evaluation.metric_table import METRICS
from shapefit.evaluation.plots import COLOURS, error_label
from shapefit.evaluation.summaries import ALL
from shapefit.evaluation.sweep import Point, Sweep, value_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOGARITHMIC = 10
"""Ratio of the largest to the smallest value from which the axis is logarithmic."""

MARKERS = "osD^v<>P"

INK, FAINT = "#333333", "#DDDDDD"


COLUMNS = 3
"""Panels side by side."""


def sweep_plot(sweep: Sweep) -> Figure:
    """Draw the mean of each group in each metric with the range from quartile to quartile.

    Numbers lie on an axis; names get bars, and a last panel with the time of an image.
    """
    from matplotlib.figure import Figure

    metrics = sweep.of_metric()
    panels = len(metrics) if sweep.is_numeric else len(metrics) + 1
    across = min(panels, COLUMNS)
    down = -(-panels // across)
    width = 5.6 if panels == 1 else 4.7 * across
    figure = Figure(figsize=(width, 3.6 * down))
    figure.set_layout_engine("constrained")
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for axis in axes[panels:]:
        axis.remove()
    for axis, ((metric, unit), groups) in zip(axes, metrics.items(), strict=False):
        if sweep.is_numeric:
            _draw_lines(axis, groups)
            axis.set_xlabel(sweep.key, color=INK)
        else:
            _draw_bars(axis, groups)
        axis.set_title(METRICS[metric].title, loc="left", fontsize=10, color=INK)
        axis.set_ylabel(f"{error_label(unit)}, mean and quartiles", color=INK)
        axis.set_ylim(bottom=0)
    if not sweep.is_numeric:
        _draw_times(axes[len(metrics)], next(iter(groups.values())))
    for axis in axes[:panels]:
        style(axis, "top", "right", grid="both")
    if list(groups) != [ALL]:
        figure.legend(
            *axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4,
            frameon=False, labelcolor=INK, fontsize=9,
        )  # fmt: skip
    return figure


def _draw_lines(axis: Axes, groups: Mapping[str, Sequence[Point]]) -> None:
    for index, (group, points) in enumerate(groups.items()):
        points = sorted(points, key=lambda point: float(point.value))
        values = [float(point.value) for point in points]
        colour = COLOURS[index % len(COLOURS)]
        low, high = [p.p25 for p in points], [p.p75 for p in points]
        axis.fill_between(values, low, high, color=colour, alpha=0.15, linewidth=0)
        axis.plot(
            values, [p.mean for p in points], color=colour, label=group, linewidth=1.6,
            marker=MARKERS[index % len(MARKERS)], markersize=4.5,
        )  # fmt: skip
    if values[0] > 0 and values[-1] >= LOGARITHMIC * values[0]:
        axis.set_xscale("log")
        axis.minorticks_off()
    axis.set_xticks(values, [f"{value:g}" for value in values])


def _draw_bars(axis: Axes, groups: Mapping[str, Sequence[Point]]) -> None:
    width = 0.8 / len(groups)
    for index, (group, points) in enumerate(groups.items()):
        offset = (index - (len(groups) - 1) / 2) * width
        places = [place + offset for place in range(len(points))]
        axis.bar(
            places, [p.mean for p in points], width, label=group, zorder=2, edgecolor="white",
            color=COLOURS[index % len(COLOURS)],
        )  # fmt: skip
        low, high = [p.p25 for p in points], [p.p75 for p in points]
        axis.vlines(places, low, high, color=INK, linewidth=1, zorder=3)
    names = [value_text(point.value) for point in points]
    axis.set_xticks(range(len(names)), names)


def _draw_times(axis: Axes, points: Sequence[Point]) -> None:
    times = [1000 * point.seconds_per_image for point in points]
    names = [value_text(point.value) for point in points]
    axis.barh(range(len(points)), times, 0.6, color=INK, zorder=2)
    axis.set_yticks(range(len(points)), names)
    axis.invert_yaxis()
    axis.set_xscale("log")
    axis.set_xlim(min(times) / 3, max(times) * 6)
    for place, time in enumerate(times):
        axis.annotate(
            f"{time:.3g}", (time, place), xytext=(3, 0), textcoords="offset points", va="center",
            fontsize=8, color=INK,
        )  # fmt: skip
    axis.minorticks_off()
    axis.set_title("Time per image (ms)", loc="left", fontsize=10, color=INK)


SHADES = "Greys_r"
"""White is 1, black is 0, as in the paper's figure."""

CELL = 0.46
"""Width of a cell in inches; its height is 2/3 of that."""


def heat_maps(
    panels: Mapping[str, Mapping[tuple[int, int], float]], down: str, across: str
) -> Figure:
    """Draw title -> {(row, column): share}; `down` and `across` say what rows and columns are.

    All panels have the rows and columns of all; a cell without a share stays empty.
    """
    from matplotlib.figure import Figure

    places = [at for shares in panels.values() for at in shares]
    rows, columns = sorted({row for row, _ in places}), sorted({column for _, column in places})
    width, height = CELL * len(columns), CELL * len(rows) * 2 / 3
    figure = Figure(figsize=(0.9 + (width + 0.5) * len(panels), height + 1.1))
    figure.set_layout_engine("constrained")
    axes = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
    for axis, (title, shares) in zip(axes, panels.items(), strict=True):
        table = np.full((len(rows), len(columns)), np.nan)
        for (row, column), share in shares.items():
            table[rows.index(row), columns.index(column)] = share
        image = axis.imshow(table, cmap=SHADES, vmin=0, vmax=1, aspect="auto")
        _write_numbers(axis, table)
        axis.set_title(title, loc="left", fontsize=10, color=INK)
        axis.set_xticks(range(len(columns)), map(str, columns))
        axis.set_yticks(range(len(rows)), map(str, rows))
        axis.set_xlabel(across, color=INK)
        axis.tick_params(length=0, colors=INK, labelsize=8)
        axis.spines[:].set_color(INK)
    axes[0].set_ylabel(down, color=INK)
    bar = figure.colorbar(image, ax=list(axes), fraction=0.03, pad=0.02)
    bar.ax.tick_params(colors=INK, labelsize=8)
    return figure


def _write_numbers(axis: Axes, table: np.ndarray) -> None:
    for (row, column), share in np.ndenumerate(table):
        if not np.isnan(share):
            ink = "white" if share < 0.5 else "black"
            text = f"{share:.2f}".removeprefix("0") if 0 < share < 1 else f"{share:.0f}"
            axis.text(column, row, text, ha="center", va="center", fontsize=7, color=ink)


def style(axis: Axes, *hidden: str, grid: Literal["x", "y", "both"] | None = None) -> None:
    """Give an axis the look of its lines and letters, without the spines that are hidden."""
    if grid is not None:
        axis.grid(axis=grid, color=FAINT, linewidth=0.8, zorder=0)
    axis.set_axisbelow(True)
    axis.spines[list(hidden)].set_visible(False)
    axis.spines[:].set_color(INK)
    axis.tick_params(length=0, colors=INK, labelsize=8)
