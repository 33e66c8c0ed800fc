"""How plots look, and the files that they become."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from shapefit.evaluation.metric_table import SHARE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = ("png", "svg")
DPI = 150

# Okabe and Ito 2008: told apart with every common form of colour blindness.
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#000000", "#F0E442")
HATCHES = ("", "////", "....", "xxxx")
"""Once all colours are used they come again with the next hatch."""

INK, FAINT = "#333333", "#DDDDDD"

BARS = 0.8
"""Share of a slot that its bars fill."""
LETTER = 0.085
"""Width of a letter in inches, about, to decide what fits."""


def save(figure: Figure, path: Path, file_format: str) -> None:
    """Write the figure as png or svg; the same figure gives the same bytes."""
    import matplotlib

    metadata = {"Date": None} if file_format == "svg" else {"Software": None}
    with matplotlib.rc_context({"svg.hashsalt": "shapefit"}), warnings.catch_warnings():
        # A letter that the font lacks, as some names have, is drawn as a box.
        warnings.filterwarnings("ignore", "Glyph .* missing from ")
        if engine := figure.get_layout_engine():  # one layout for all formats
            figure.set_dpi(DPI)
            engine.execute(figure)
            figure.set_layout_engine(None)
        figure.savefig(path, format=file_format, dpi=DPI, metadata=metadata)


def writers(name: str, figure: Figure) -> dict[str, Callable[[Path], None]]:
    """Return what writes the figure to a path, for each file name that it gets: name.png, ..."""
    return {f"{name}.{form}": partial(save, figure, file_format=form) for form in FORMATS}


def look(index: int, further: Sequence[str] = HATCHES) -> tuple[str, str]:
    """Return the colour and hatch, or what else is `further`, of the method at an index."""
    return COLOURS[index % len(COLOURS)], further[index // len(COLOURS) % len(further)]


def axis_label(unit: str) -> str:
    """Return what the errors of a unit are called; shares, of labels, are no errors."""
    return unit if unit == SHARE else f"error ({unit})"


def style(axis: Axes, *hidden: str, grid: Literal["x", "y", "both"] | None = None) -> None:
    """Give an axis the look of its lines and letters, without the spines that are hidden."""
    if grid is not None:
        axis.grid(axis=grid, color=FAINT, linewidth=0.8, zorder=0)
    axis.set_axisbelow(True)
    axis.spines[list(hidden)].set_visible(False)
    axis.spines[:].set_color(INK)
    axis.tick_params(length=0, colors=INK, labelsize=8)
