"""Errors drawn: bars of sequences and groups, boxes of images, and how true error bars are."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.evaluation.calibration import CURVE, LEVELS, Coverage
from shapefit.evaluation.metric_table import METRICS, SHARE
from shapefit.evaluation.summaries import ALL, ImageErrors, Summary, of_sequences, without_nan

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 150

# Okabe and Ito 2008: told apart with every common form of colour blindness.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#000000", "#F0E442")
MOST_SEQUENCES = 60
"""Of a group with more only the mean is drawn, as nobody could tell their bars apart."""

WHISKERS = (5, 95)
"""Percentiles that the whiskers reach to; of tens of thousands of images none is drawn alone."""


MISSING = "matplotlib is not installed"
INSTALL = "install it with `pip install matplotlib`"


def check_can_draw(key: str) -> None:
    """Raise InputError where matplotlib is not installed; does not import it."""
    if not _can_draw():
        raise input_error(key, MISSING, f"{INSTALL}, or leave `{key}` out")


def draws_plots(wanted: bool | Literal["auto"]) -> bool:
    """Whether plots are drawn; `auto` draws them where that is possible.

    Raises InputError where they are wanted and cannot be drawn.
    """
    if wanted is True:
        check_can_draw("plots")
    return _can_draw() if wanted == "auto" else wanted


def plots_left_out(wanted: bool | Literal["auto"]) -> tuple[str, ...]:
    """Warn where `auto` draws no plots."""
    if wanted != "auto" or _can_draw():
        return ()
    return (f"no plots: {MISSING}; {INSTALL}, or set `plots: false`",)


def _can_draw() -> bool:
    name = "matplotlib"
    return sys.modules[name] is not None if name in sys.modules else find_spec(name) is not None


def save(figure: Figure, path: Path | BytesIO, file_format: str) -> None:
    """Write the figure as png or svg; the same figure gives the same bytes."""
    import matplotlib

    metadata = {"Date": None} if file_format == "svg" else {"Software": None}
    with matplotlib.rc_context({"svg.hashsalt": "shapefit"}), warnings.catch_warnings():
        # A letter that the font lacks, as some names have, is drawn as a box.
        warnings.filterwarnings("ignore", "Glyph .* missing from ")
        figure.savefig(path, format=file_format, dpi=DPI, metadata=metadata)


def draw_bars(summaries: Sequence[Summary]) -> Figure:
    """Draw the mean error of each sequence and of each group, the methods side by side.

    summaries of one metric and unit; a row of panels, one for each group.
    """
    methods = list(dict.fromkeys(s.method for s in summaries))
    groups = list(dict.fromkeys(s.group for s in summaries))
    means = {(s.group, s.sequence, s.method): s.mean for s in summaries}
    places: dict[str, list[str | None]] = {}
    for group in groups:
        own = dict.fromkeys(s.sequence for s in summaries if s.group == group and s.sequence)
        shown = list(own) if len(own) <= MOST_SEQUENCES else []
        places[group] = [*shown] if len(shown) == 1 else [*shown, None]
    widths = [len(own) + 1 for own in places.values()]
    figure, axes = _panels(0.12 * len(methods) * sum(widths), widths)
    each = 0.8 / len(methods)
    for axis, (group, sequences) in zip(axes, places.items(), strict=True):
        for index, method in enumerate(methods):
            heights = [means.get((group, sequence, method), np.nan) for sequence in sequences]
            at = np.arange(len(sequences)) + (index - (len(methods) - 1) / 2) * each
            axis.bar(at, heights, each, label=method, facecolor=COLOURS[index % 8])
        labels = [name or "mean" for name in sequences]
        axis.set_xticks(range(len(labels)), labels, rotation=90)
        axis.set_title("" if group == ALL else group, fontsize=9)
    axes[0].set_ylabel(f"mean {error_label(summaries[0].unit)}")
    return _finish(figure, axes, METRICS[summaries[0].metric].title)


def draw_boxes(errors: Sequence[ImageErrors], grouping: Mapping[str, Sequence[str]]) -> Figure:
    """Draw the errors of the images of each group: quartiles, median with its number, whiskers.

    errors of one metric and unit, one entry per method. As in the tables, each number is the mean
    of that of its sequences. Failed images, nan, are left out, and so are groups without any image.
    """
    known = {
        group: [_percentiles_of(e, members) for e in errors] for group, members in grouping.items()
    }
    known = {group: own for group, own in known.items() if any(map(len, own))} or known
    figure, axes = _panels(0.45 * len(errors) * len(known), [1] * len(known))
    for axis, (group, methods) in zip(axes, known.items(), strict=True):
        for index, percentiles in enumerate(methods):
            if not len(percentiles):
                continue
            low, q1, median, q3, high = percentiles.mean(axis=0)
            box = {"med": median, "q1": q1, "q3": q3, "whislo": low, "whishi": high}
            drawn = axis.bxp(
                [box], positions=[index], widths=0.8, showfliers=False, patch_artist=True
            )
            drawn["boxes"][0].set(facecolor=COLOURS[index % 8], label=errors[index].method)
            drawn["medians"][0].set(color="black")
            axis.annotate(f"{median:.3g}", (index, median), ha="center", va="bottom", fontsize=6)
        axis.set_xticks([])
        axis.set_title("" if group == ALL else group, fontsize=9)
        axis.set_ylim(bottom=0)
    axes[0].set_ylabel(error_label(errors[0].unit))
    return _finish(figure, axes, f"{METRICS[errors[0].metric].title}, image by image")


def _percentiles_of(errors: ImageErrors, sequences: Sequence[str]) -> Floats:
    """Return whisker, quartiles and whisker (s, 5) of the s sequences that have an image."""
    every = of_sequences(errors)
    own = [without_nan(every[name]) for name in sequences if name in every]
    at = [WHISKERS[0], 25, 50, 75, WHISKERS[1]]
    return np.array([np.percentile(values, at) for values in own if len(values)]).reshape(-1, 5)


def draw_calibration(
    coverage: Sequence[Coverage], curves: Mapping[tuple[str, str], Sequence[float]]
) -> Figure:
    """Draw the share inside over the nominal level, then the shares of each landmark.

    `curves` maps a method and a group to the shares at the levels of `CURVE`. True error bars lie
    on the diagonal, and at the two lines of the nominal levels: a bar reaches to the larger one,
    its mark stands at the smaller.
    """
    names = list(dict.fromkeys(c.landmark for c in coverage if c.landmark is not None))
    found = {(c.method, c.group, c.landmark): c.inside for c in coverage}
    across = max(5.0, 0.1 * len(curves) * len(names))
    figure, (left, right) = _panels(4 + across, [4, across], sharey=False)
    left.plot([0, 100], [0, 100], color="black", linewidth=0.8)
    left.set(xlabel="nominal level (%)", ylabel="truth inside (%)", aspect="equal")
    each = 0.8 / len(curves)
    for index, ((method, group), shares) in enumerate(curves.items()):
        label, colour = method if group == ALL else f"{method}, {group}", COLOURS[index % 8]
        left.plot(100 * np.array(CURVE), 100 * np.array(shares), color=colour)
        inside = [found.get((method, group, name), (np.nan, np.nan)) for name in names]
        less, more = 100 * np.array(inside).T
        at = np.arange(len(names)) + (index - (len(curves) - 1) / 2) * each
        right.bar(at, more, each, label=label, facecolor=COLOURS[index % 8])
        right.hlines(less, at - each / 2, at + each / 2, color="white", zorder=3)
    for level in LEVELS:
        right.axhline(100 * level, color="black", linewidth=0.8, zorder=4)
    right.set_xticks(range(len(names)), names, rotation=90)
    right.set_ylim(0, 100)
    right.set_title(f"inside {LEVELS[-1]:.0%} (bars) and {LEVELS[0]:.0%} (marks)", fontsize=9)
    return _finish(figure, [right, left], "Error bars")


def _panels(
    width: float, ratios: Sequence[float], *, sharey: bool = True
) -> tuple[Figure, list[Axes]]:
    """Return a figure at least so wide in inches, with panels side by side."""
    from matplotlib.figure import Figure

    size = (min(max(6.0, 1.5 + width), 60.0), 4.2)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(1, len(ratios), squeeze=False, sharey=sharey, width_ratios=ratios)[0]
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(labelsize=7)
        axis.grid(axis="y", color="#DDDDDD", zorder=0)
        axis.set_axisbelow(True)
    return figure, list(axes)


def _in_lines(title: str, points: float, inches: float) -> str:
    """Return a title in lines so short that none is cut; a letter is 0.6 of its height wide."""
    return "\n".join(wrap(title, max(8, int(72 * inches / (0.6 * points)))))


def _finish(figure: Figure, axes: Sequence[Axes], title: str) -> Figure:
    """Put the title above the panels, and below them the names of what any of them shows."""
    shown: dict[str, Any] = {}
    for axis in axes:
        handles, labels = axis.get_legend_handles_labels()
        shown |= dict(zip(labels, handles, strict=True))
    figure.suptitle(_in_lines(title, 12, figure.get_figwidth()), x=0.01, ha="left")
    grid = axes[0].get_gridspec()
    assert grid is not None
    ratios = np.array(grid.get_width_ratios(), dtype=float)
    for axis, share in zip(figure.axes, ratios / ratios.sum(), strict=True):
        axis.set_title(_in_lines(axis.get_title(), 9, share * figure.get_figwidth()), fontsize=9)
    figure.legend(
        list(shown.values()),
        list(shown),
        loc="outside lower center",
        ncols=min(4, max(1, len(shown))),
        fontsize=8,
        frameon=False,
    )
    return figure


def error_label(unit: str) -> str:
    """Return what the errors of a unit are called; shares, of labels, are no errors."""
    return unit if unit == SHARE else f"error ({unit})"
