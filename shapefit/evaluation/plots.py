"""The errors of all images, sorted, a line for each method; figures as files."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.evaluation.metrics import SHARE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 150

# Okabe and Ito 2008: distinguishable with every common form of colour blindness.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#000000", "#F0E442")
POINTS = 1000
"""Of a line, at most."""

MISSING = "matplotlib is not installed"
INSTALL = "install it with `pip install matplotlib`"


def can_draw() -> bool:
    """Whether matplotlib is installed; it is not imported."""
    name = "matplotlib"
    return sys.modules[name] is not None if name in sys.modules else find_spec(name) is not None


def check_can_draw(key: str) -> None:
    """Raise InputError at `key` where matplotlib is not installed."""
    if not can_draw():
        raise input_error(key, MISSING, f"{INSTALL}, or leave `{key}` out")


def save(figure: Figure, path: Path | BytesIO, file_format: str) -> None:
    """Write the figure as png or svg; the same figure gives the same bytes."""
    import matplotlib

    metadata = {"Date": None} if file_format == "svg" else {"Software": None}
    with matplotlib.rc_context({"svg.hashsalt": "shapefit"}), warnings.catch_warnings():
        # A letter that the font lacks, as some names have, is drawn as a box.
        warnings.filterwarnings("ignore", "Glyph .* missing from ")
        figure.savefig(path, format=file_format, dpi=DPI, metadata=metadata)


def draw_errors(title: str, unit: str, errors: Mapping[str, Floats]) -> Figure:
    """Draw errors (n,) by method, nan = failed, sorted over the share of the images.

    Where images failed the line of their method ends early.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.0, 4.2), layout="constrained")
    axis = figure.subplots()
    for index, (method, values) in enumerate(errors.items()):
        finite = np.sort(values[~np.isnan(values)])
        share = 100 * (np.arange(len(finite)) + 0.5) / max(len(values), 1)
        shown = np.unique(np.linspace(0, max(len(finite) - 1, 0), POINTS).astype(int))
        shown = shown[: len(finite)]
        colour = COLOURS[index % len(COLOURS)]
        axis.plot(share[shown], finite[shown], color=colour, label=method)
    axis.set(xlim=(0, 100), xlabel="images (%), sorted by error", ylim=(0, None))
    axis.set_ylabel(unit if unit == SHARE else f"error ({unit})")
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(color="#DDDDDD")
    axis.set_title(title, loc="left")
    if len(errors) > 1:
        columns = min(4, len(errors))
        figure.legend(loc="outside lower center", ncols=columns, fontsize=8, frameon=False)
    return figure
