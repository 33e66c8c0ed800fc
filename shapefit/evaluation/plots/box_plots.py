"""Box plots of the errors of all images of each group, one box per method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from shapefit.arrays import Floats
from shapefit.evaluation.averages import of_names, percentiles
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

    values = {
        group: [of_names(e.values, e.sequences, members) for e in errors]
        for group, members in grouping.items()
    }
    values = {group: boxes for group, boxes in values.items() if any(map(len, boxes))}
    taken = [max(len(errors), LETTER * (len(group) + 2) / SLOT) for group in values]
    slots = max(FEWEST_SLOTS, sum(taken) + GAP * (len(taken) - 1))
    figure = Figure(figsize=(1.1 + SLOT * slots, 3.9))
    figure.set_layout_engine("constrained")
    axis = figure.subplots()
    every = [known for boxes in values.values() for known in boxes if len(known)]
    reach = [percentiles(known, (WHISKERS[1],))[0] for known in every]
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


def _draw_box(axis: Axes, place: float, known: Floats, style: tuple[str, str]) -> None:
    if not len(known):
        return
    colour, hatch = style
    first, lower, middle, upper, last = percentiles(known, (WHISKERS[0], 25, 50, 75, WHISKERS[1]))
    box = {
        "med": middle,
        "q1": lower,
        "q3": upper,
        # Whiskers reach to the outermost images that are not beyond their percentiles.
        "whislo": min(lower, known[known >= first].min()),
        "whishi": max(upper, known[known <= last].max()),
    }
    axis.bxp(
        [box], positions=[place], widths=[BARS], showfliers=False,
        patch_artist=True, manage_ticks=False, capwidths=[BARS / 2],
        boxprops={"facecolor": colour, "hatch": hatch, "edgecolor": INK, "linewidth": 0.8},
        medianprops={"color": INK, "linewidth": 1.6}, whiskerprops={"color": INK},
        capprops={"color": INK}, zorder=2,
    )  # fmt: skip
    axis.annotate(
        f"{middle:#.3g}".rstrip("."), (place, middle), xytext=(0, 2), textcoords="offset points",
        ha="center", va="bottom", fontsize=6.5, color=INK, zorder=4,
        bbox={"boxstyle": "round,pad=0.12", "fc": "white", "ec": "none", "alpha": 0.8},
    )  # fmt: skip
