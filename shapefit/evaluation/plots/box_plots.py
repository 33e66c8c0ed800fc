"""Box plots of the errors of all images of each group, one box per method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from shapefit.evaluation.metric_table import METRICS
from shapefit.evaluation.plots.bars import (
    BARS,
    GAP,
    INK,
    LETTER,
    add_head,
    axis_label,
    look,
    style_axis,
)
from shapefit.evaluation.summary import ALL, ImageErrors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

SLOT = 0.45
"""Width in inches of a box with its share of the space around it; a median's digits fit in."""
WHISKERS = (5, 95)
"""Percentiles that the whiskers reach to; of tens of thousands of images none is drawn alone."""
FEWEST_SLOTS = 7
"""Fewer are padded left and right, so that the title fits."""


def box_plot(errors: Sequence[ImageErrors], grouping: Mapping[str, Sequence[str]]) -> Figure:
    """Draw the errors of the images of each group: quartiles, median with its number, whiskers.

    errors of one metric and unit, one entry per method. Every image weighs the same, whichever its
    sequence. Failed images, nan, are left out, and so are groups without any image.
    """
    from matplotlib.figure import Figure

    values = {group: _of_group(errors, members) for group, members in grouping.items()}
    values = {group: boxes for group, boxes in values.items() if any(map(len, boxes))}
    taken = [max(len(errors), LETTER * (len(group) + 2) / SLOT) for group in values]
    slots = max(FEWEST_SLOTS, sum(taken) + GAP * (len(taken) - 1))
    figure = Figure(figsize=(1.1 + SLOT * slots, 3.9))
    figure.set_layout_engine("constrained")
    axis = figure.subplots()
    reach = [np.percentile(v, WHISKERS[1]) for boxes in values.values() for v in boxes if len(v)]
    style_axis(axis, slots, 1.05 * max(reach, default=0.0) or 1.0, axis_label(errors[0].unit))
    start = (slots - sum(taken) - GAP * (len(taken) - 1)) / 2
    ticks: dict[float, str] = {}
    for (group, boxes), width in zip(values.items(), taken, strict=True):
        middle = start + (width - 1) / 2
        for index, known in enumerate(boxes):
            place = middle + index - (len(boxes) - 1) / 2
            _draw_box(axis, place, known, look(index))
        ticks[middle] = "" if group == ALL else group
        start += width + GAP
    axis.set_xticks(list(ticks), list(ticks.values()), fontweight="bold", fontsize=9)
    methods = [e.method for e in errors]
    add_head(figure, axis, f"{METRICS[errors[0].metric].title}, image by image", methods)
    return figure


def _of_group(errors: Sequence[ImageErrors], members: Sequence[str]) -> list[Floats]:
    """Errors of the images of a group that have one, an array per method."""
    found = []
    for e in errors:
        inside = np.isin(np.array(e.sequences, dtype=str), np.array(members, dtype=str))
        found.append(e.values[inside & ~np.isnan(e.values)])
    return found


def _draw_box(axis: Axes, place: float, values: Floats, style: tuple[str, str]) -> None:
    if not len(values):
        return
    colour, hatch = style
    axis.boxplot(
        values, positions=[place], widths=[BARS], whis=WHISKERS, showfliers=False,
        patch_artist=True, manage_ticks=False, capwidths=[BARS / 2],
        boxprops={"facecolor": colour, "hatch": hatch, "edgecolor": INK, "linewidth": 0.8},
        medianprops={"color": INK, "linewidth": 1.6}, whiskerprops={"color": INK},
        capprops={"color": INK}, zorder=2,
    )  # fmt: skip
    median = float(np.median(values))
    axis.annotate(
        f"{median:#.3g}".rstrip("."), (place, median), xytext=(0, 2), textcoords="offset points",
        ha="center", va="bottom", fontsize=6.5, color=INK, zorder=4,
        bbox={"boxstyle": "round,pad=0.12", "fc": "white", "ec": "none", "alpha": 0.8},
    )  # fmt: skip
