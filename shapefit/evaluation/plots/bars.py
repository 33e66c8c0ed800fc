"""Bar plots of the mean error of every sequence, one bar per method."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from shapefit.evaluation.metric_table import METRICS, SHARE
from shapefit.evaluation.summary import ALL, Summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = ("png", "svg")

# Okabe and Ito 2008: told apart with every common form of colour blindness.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#000000", "#F0E442")
HATCHES = ("", "////", "....", "xxxx")
"""Once all colours are used they come again with the next hatch."""

INK, FAINT = "#333333", "#DDDDDD"

SLOTS_A_ROW = 52
"""Clusters of bars side by side; a longer group has a row of its own."""
MOST_SEQUENCES = 400
"""Of a group with more only the mean is drawn, as nobody could tell their bars apart."""
GAP = 1.0
"""Empty slots between groups in one row."""
BARS = 0.8
"""Share of a slot that its bars fill."""
FEWEST_SLOTS = 6
"""Fewer are padded left and right, so that bars stay slim."""
LETTER = 0.085
"""Width of a letter in inches, about, to decide what fits."""
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
        style_axis(axis, slots, top or 1.0, label)
        start = 0.0 if slots > FEWEST_SLOTS else (slots - row[0].slots) / 2
        ticks: dict[float, str] = {}
        for group in row:
            _draw(axis, start, group, methods)
            ticks |= {start + cluster.place: cluster.label for cluster in group.clusters}
            start += group.slots + GAP
        axis.set_xticks(list(ticks), list(ticks.values()), rotation=90 if upright else 0)
    add_head(figure, axes[0], METRICS[summaries[0].metric].title, methods)
    return figure


def save(figure: Figure, path: Path, file_format: str) -> None:
    """Write the figure as png or svg; the same figure gives the same bytes."""
    import matplotlib

    metadata = {"Date": None} if file_format == "svg" else {"Software": None}
    with matplotlib.rc_context({"svg.hashsalt": "shapefit"}), warnings.catch_warnings():
        # A letter that the font lacks, as some names have, is drawn as a box.
        warnings.filterwarnings("ignore", "Glyph .* missing from ")
        figure.savefig(path, format=file_format, dpi=150, metadata=metadata)


def writers(name: str, figure: Figure) -> dict[str, Callable[[Path], None]]:
    """Return what writes the figure to a path, for each file name that it gets: name.png, ..."""
    return {f"{name}.{form}": partial(save, figure, file_format=form) for form in FORMATS}


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


def look(index: int) -> tuple[str, str]:
    """Return the colour and hatch of the method at an index."""
    return COLOURS[index % len(COLOURS)], HATCHES[index // len(COLOURS) % len(HATCHES)]


def axis_label(unit: str) -> str:
    """Return what the errors of a unit are called; shares, of labels, are no errors."""
    return unit if unit == SHARE else f"error ({unit})"


def style_axis(axis: Axes, slots: float, top: float, label: str) -> None:
    """Give an axis its limits, for slots 1 wide around 0, 1, ..., and its lines and letters."""
    axis.set_xlim(-0.7, slots - 0.3)
    axis.set_ylim(0, top)
    axis.set_ylabel(label, color=INK)
    axis.grid(axis="y", color=FAINT, linewidth=0.8, zorder=0)
    axis.set_axisbelow(True)
    axis.spines[["top", "right", "left"]].set_visible(False)
    axis.spines["bottom"].set_color(INK)
    axis.tick_params(length=0, colors=INK, labelsize=8)


def add_head(figure: Figure, axis: Axes, title: str, methods: Sequence[str]) -> None:
    """Put the title above the first row, the legend of the methods below the last."""
    from matplotlib.patches import Patch

    axis.set_title(title, loc="left", color=INK, fontsize=12, pad=20)
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
