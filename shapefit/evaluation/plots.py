"""The errors of all images, sorted, a line for each method; figures as files."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from shapefit.errors import input_error
from shapefit.evaluation.metric_table import METRICS, SHARE
from shapefit.evaluation.summaries import ImageErrors, without_nan

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 150

# Okabe and Ito 2008: told apart with every common form of colour blindness.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#000000", "#F0E442")
POINTS = 1000
"""Of a line, at most."""

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


def draw_errors(errors: Sequence[ImageErrors]) -> Figure:
    """Draw the errors of one metric and unit, sorted, over the share of the images.

    One entry a method; images that failed are nowhere, and the line of their method ends early.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 4.2), layout="constrained")
    axis = figure.subplots()
    for index, each in enumerate(errors):
        known = np.sort(without_nan(each.values))
        share = 100 * (np.arange(len(known)) + 0.5) / max(len(each.values), 1)
        shown = np.unique(np.linspace(0, max(len(known) - 1, 0), POINTS).astype(int))[: len(known)]
        colour = COLOURS[index % len(COLOURS)]
        axis.plot(share[shown], known[shown], color=colour, label=each.method)
    axis.set(xlim=(0, 100), xlabel="images (%), sorted by error", ylim=(0, None))
    axis.set_ylabel(error_label(errors[0].unit))
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(color="#DDDDDD")
    axis.set_title(METRICS[errors[0].metric].title, loc="left")
    if len(errors) > 1:
        columns = min(4, len(errors))
        figure.legend(loc="outside lower center", ncols=columns, fontsize=8, frameon=False)
    return figure


def error_label(unit: str) -> str:
    """Return what the errors of a unit are called; shares, of labels, are no errors."""
    return unit if unit == SHARE else f"error ({unit})"
