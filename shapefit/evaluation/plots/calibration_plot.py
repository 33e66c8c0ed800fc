"""Coverage of error bars against the nominal level, and landmark by landmark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from shapefit.evaluation.calibration import CURVE, LEVELS, Coverage
from shapefit.evaluation.plots.style import BARS, INK, LETTER, look, style
from shapefit.evaluation.summary import ALL

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLES = ("-", "--", ":", "-.")
"""Once all colours are used they come again with the next style."""
SQUARE = 3.6
"""Side in inches of the panel of all landmarks."""
BAR = 0.075
"""Least width in inches of the bar of a landmark in one series."""


def calibration_plot(
    coverage: Sequence[Coverage], curves: Mapping[tuple[str, str], Sequence[float]]
) -> Figure:
    """Draw the share inside over the nominal level, then the shares of each landmark.

    `curves` maps a method and a group to the shares at the levels of `CURVE`.

    One line and one row of bars for each method and group. True error bars lie on the diagonal, and
    at the two lines of the nominal levels: a bar reaches to the larger one, its mark stands at the
    smaller.
    """
    from matplotlib.figure import Figure

    series = list(dict.fromkeys((c.method, c.group) for c in coverage))
    names = list(dict.fromkeys(c.landmark for c in coverage if c.landmark is not None))
    slot = max(0.2, BAR * len(series))
    width = max(SQUARE, slot * len(names))
    upright = max(map(len, names)) * LETTER > width / len(names)
    figure = Figure(figsize=(SQUARE + width + 1.4, SQUARE + (1.3 if upright else 0.9)))
    figure.set_layout_engine("constrained")
    left, right = figure.subplots(1, 2, width_ratios=[SQUARE, width])
    for index, (method, group) in enumerate(series):
        shares = np.array(curves[method, group])
        colour, line = look(index, STYLES)
        left.plot(100 * np.array(CURVE), 100 * shares, line, color=colour, linewidth=1.6,
                  label=method if group == ALL else f"{method}, {group}")  # fmt: skip
    _style_curves(left)
    _draw_landmarks(right, coverage, series, names)
    right.set_xticks(range(len(names)), names, rotation=90 if upright else 0)
    figure.legend(
        *left.get_legend_handles_labels(), loc="outside lower center",
        ncols=max(1, min(4, len(series))), frameon=False, labelcolor=INK, fontsize=9,
    )  # fmt: skip
    return figure


def _style_curves(axis: Axes) -> None:
    axis.plot([0, 100], [0, 100], color=INK, linewidth=0.8, zorder=1)
    axis.set_aspect("equal")
    axis.set_xlim(0, 100)
    axis.set_ylim(0, 100)
    axis.set_xticks(range(0, 101, 25))
    axis.set_yticks(range(0, 101, 25))
    axis.set_xlabel("nominal level (%)", color=INK)
    axis.set_ylabel("truth inside (%)", color=INK)
    axis.set_title("Error bars, all landmarks", loc="left", color=INK, fontsize=11, y=1)
    style(axis, "top", "right", grid="both")


def _draw_landmarks(
    axis: Axes,
    coverage: Sequence[Coverage],
    series: Sequence[tuple[str, str]],
    names: Sequence[str],
) -> None:
    found = {(c.method, c.group, c.landmark): c.inside for c in coverage}
    each = BARS / len(series)
    for index, column in enumerate(series):
        shares = np.array([found.get((*column, name), (np.nan,) * len(LEVELS)) for name in names])
        places = np.arange(len(names)) + (index - (len(series) - 1) / 2) * each
        colour, _ = look(index)
        axis.bar(places, 100 * shares[:, -1], each, color=colour, edgecolor="white",
                 linewidth=0.3, zorder=2)  # fmt: skip
        axis.hlines(100 * shares[:, 0], places - each / 2, places + each / 2, color="white",
                    linewidth=1.6, zorder=3)  # fmt: skip
    for level in LEVELS:
        axis.axhline(100 * level, color=INK, linewidth=0.8, zorder=4)
    axis.set_xlim(-0.7, len(names) - 0.3)
    axis.set_ylim(0, 100)
    axis.set_yticks([0, *(100 * level for level in LEVELS), 100])
    title = f"Inside {LEVELS[-1]:.0%} (bars) and {LEVELS[0]:.0%} (marks), by landmark"
    axis.set_title(title, loc="left", color=INK, fontsize=11, y=1)
    style(axis, "top", "right")
