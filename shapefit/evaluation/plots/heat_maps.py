"""Heat maps of shares between 0 and 1, side by side, each with its numbers in it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from shapefit.evaluation.plots.style import INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = "Greys_r"
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
        image = axis.imshow(table, cmap=COLOURS, vmin=0, vmax=1, aspect="auto")
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
