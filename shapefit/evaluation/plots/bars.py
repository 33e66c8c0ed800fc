"""Errors drawn: a bar per method for the mean of every sequence, and boxes of all images."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from shapefit.arrays import Floats
from shapefit.evaluation.averages import of_names, percentiles
from shapefit.evaluation.metric_table import METRICS
from shapefit.evaluation.plots.style import BARS, INK, LETTER, axis_label, look, style
from shapefit.evaluation.summary import ALL, ImageErrors, Summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SLOTS_A_ROW = 52
"""Clusters of bars side by side; a longer group has a row of its own."""
MOST_SEQUENCES = 400
"""Of a group with more only the mean is drawn, as nobody could tell their bars apart."""
GAP = 1.0
"""Empty slots between groups in one row."""
FEWEST_SLOTS = 6
"""Fewer are padded left and right, so that bars stay slim."""
LEGEND_HANDLE = 0.6
"""Width in inches of an entry of the legend besides its letters."""


@dataclass(frozen=True)
class _Cluster:
    """Bars of all methods at one place: a sequence, or the mean over a group."""

    label: str
    place: float
    errors: Mapping[str, float]


@dataclass(frozen=True)
class _Group:
    """A group, its clusters placed from 0 on, and the slots that it takes."""

    name: str
    clusters: tuple[_Cluster, ...]
    slots: float


def bar_plot(summaries: Sequence[Summary]) -> Figure:
    """Draw the mean error of each sequence and of each group, the methods side by side.

    summaries of one metric and unit. Groups stand side by side as far as they fit into a row.
    """
    from matplotlib.figure import Figure

    methods = tuple(dict.fromkeys(s.method for s in summaries))
    slot = max(0.27, 0.08 * len(methods))  # inches
    groups = _groups(summaries, slot)
    rows = _rows(groups)
    slots = max(FEWEST_SLOTS, *(sum(g.slots + GAP for g in row) - GAP for row in rows))
    longest = max(len(cluster.label) for group in groups for cluster in group.clusters)
    width = max(4.0, slot * slots)
    upright = LETTER * (longest + 1) > width / slots

    row_height = 2.7 + (LETTER * longest if upright else 0.2)
    figure = Figure(figsize=(1.1 + width, 0.5 + row_height * len(rows)))
    figure.set_layout_engine("constrained")
    axes = figure.subplots(len(rows), squeeze=False)[:, 0]
    top = 1.05 * max((s.mean for s in summaries if not math.isnan(s.mean)), default=0.0)
    for axis, row in zip(axes, rows, strict=True):
        label = f"mean {axis_label(summaries[0].unit)}"
        lay_out(axis, slots, top or 1.0, label)
        start = 0.0 if slots > FEWEST_SLOTS else (slots - row[0].slots) / 2
        ticks: dict[float, str] = {}
        for group in row:
            _draw(axis, start, group, methods)
            ticks |= {start + cluster.place: cluster.label for cluster in group.clusters}
            start += group.slots + GAP
        axis.set_xticks(list(ticks), list(ticks.values()), rotation=90 if upright else 0)
    add_head(figure, axes[0], METRICS[summaries[0].metric].title, methods)
    return figure


def _groups(summaries: Sequence[Summary], slot: float) -> list[_Group]:
    sequences: dict[str, dict[str, dict[str, float]]] = {}  # group -> sequence -> method -> mean
    means: dict[str, dict[str, float]] = {}  # group -> method -> mean over sequences
    for s in summaries:
        if s.sequence is None:
            means.setdefault(s.group, {})[s.method] = s.mean
        else:
            sequences.setdefault(s.group, {}).setdefault(s.sequence, {})[s.method] = s.mean
    groups = []
    for name, members in sequences.items():
        clusters = [_Cluster(label, i, errors) for i, (label, errors) in enumerate(members.items())]
        if len(clusters) > MOST_SEQUENCES:
            clusters = [_Cluster("mean", 0.0, means[name])]
        elif len(clusters) > 1:
            clusters.append(_Cluster("mean", len(clusters) + 0.4, means[name]))
        slots = max(clusters[-1].place + 1, LETTER * 1.3 * len(name) / slot)
        groups.append(_Group(name, tuple(clusters), slots))
    return groups


def _rows(groups: Sequence[_Group]) -> list[list[_Group]]:
    """Fill rows with groups in order; a group never breaks over two rows."""
    rows: list[list[_Group]] = []
    used = math.inf
    for group in groups:
        if used + GAP + group.slots > SLOTS_A_ROW:
            rows.append([])
            used = -GAP
        rows[-1].append(group)
        used += GAP + group.slots
    return rows


def _draw(axis: Axes, start: float, group: _Group, methods: Sequence[str]) -> None:
    width = BARS / len(methods)
    for index, method in enumerate(methods):
        offset = start + (index - (len(methods) - 1) / 2) * width
        places = [offset + cluster.place for cluster in group.clusters]
        heights = [cluster.errors.get(method, math.nan) for cluster in group.clusters]
        colour, hatch = look(index)
        axis.bar(
            places, heights, width, label=method, color=colour, hatch=hatch, edgecolor="white",
            linewidth=0.3, zorder=2,
        )  # fmt: skip
    axis.annotate(
        "" if group.name == ALL else group.name, (start - BARS / 2, 1),
        xycoords=("data", "axes fraction"), xytext=(0, 4), textcoords="offset points",
        fontweight="bold", fontsize=9, color=INK,
    )  # fmt: skip


def lay_out(axis: Axes, slots: float, top: float, label: str) -> None:
    """Give an axis its limits, for slots 1 wide around 0, 1, ..., and its label."""
    axis.set_xlim(-0.7, slots - 0.3)
    axis.set_ylim(0, top)
    axis.set_ylabel(label, color=INK)
    axis.xaxis.set_label_coords(0.5, 0)  # there is none: its place need not be found
    style(axis, "top", "right", "left", grid="y")


def add_head(figure: Figure, axis: Axes, title: str, methods: Sequence[str]) -> None:
    """Put the title above the first row, the legend of the methods below the last."""
    from matplotlib.patches import Patch

    axis.set_title(title, loc="left", color=INK, fontsize=12, pad=20, y=1)
    looks = [look(index) for index in range(len(methods))]
    entry = LETTER * max(map(len, methods)) + LEGEND_HANDLE
    columns = max(1, min(len(methods), 4, int(figure.get_figwidth() / entry)))
    figure.legend(
        handles=[
            Patch(facecolor=colour, hatch=hatch, edgecolor="white", linewidth=0.3, label=method)
            for method, (colour, hatch) in zip(methods, looks, strict=True)
        ],
        loc="outside lower center", ncols=columns, frameon=False, labelcolor=INK,
        fontsize=9,
    )  # fmt: skip


SLOT = 0.45
"""Width in inches of a box with its share of the space around it; a median's digits fit in."""
WHISKERS = (5, 95)
"""Percentiles that the whiskers reach to; of tens of thousands of images none is drawn alone."""
FEWEST_BOXES = 7
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
    slots = max(FEWEST_BOXES, sum(taken) + GAP * (len(taken) - 1))
    figure = Figure(figsize=(1.1 + SLOT * slots, 3.9))
    figure.set_layout_engine("constrained")
    axis = figure.subplots()
    every = [known for boxes in values.values() for known in boxes if len(known)]
    reach = [percentiles(known, (WHISKERS[1],))[0] for known in every]
    lay_out(axis, slots, 1.05 * max(reach, default=0.0) or 1.0, axis_label(errors[0].unit))
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
