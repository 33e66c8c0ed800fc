"""The panels of a picture: landmarks, a fitted model under them, a shape in 3D.

All points are in the viewer's frame: x right, y up, z towards the viewer. The functions draw on
axes that they are given; `frame` then sets the limits.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Any

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.meshes.ellipses import Ellipses
from shapefit.meshes.shading import paint

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Okabe and Ito 2008: told apart with every common form of colour blindness.
SEEN, HIDDEN, OUTLIER = "#0072B2", "#555555", "#D55E00"
BAR = "#E69F00"
FAINTNESS = 0.22
"""Opacity of an error bar."""
INK = "#333333"
BODY = (0.68, 0.80, 0.97)
"""Colour of a mesh."""
NEAR, FAR = (0.10, 0.22, 0.40), (0.72, 0.78, 0.86)
"""Colours of the nearest and of the furthest edge."""
SEEN_MARK, HIDDEN_MARK, OUTLIER_MARK, RESIDUAL, ERROR_BAR = (
    "seen", "hidden, from the model", "judged outlier", "to the model", "one standard deviation",
)  # fmt: skip
"""What is explained in the legend of a figure in which it is drawn."""
CROWD = 80
"""Landmarks beyond this number get smaller marks."""
MARGIN = 0.06
"""Free border of a panel, as a share of what it shows."""


def draw_landmarks(axes: Axes, landmarks: Floats, outliers: Flags | None, size: float) -> None:
    """Mark landmarks (2, p), nan = hidden: those judged outliers (p,) with crosses."""
    if outliers is None:
        outliers = np.zeros(landmarks.shape[1], dtype=bool)
    visible = np.isfinite(landmarks).all(axis=0)
    if np.any(visible & ~outliers):
        draw_points(axes, landmarks[:, ~outliers], size, SEEN_MARK)
    if np.any(visible & outliers):
        axes.plot(
            *landmarks[:, outliers], "X", color=OUTLIER, markersize=1.7 * _small(size, landmarks),
            markeredgewidth=0.4, markeredgecolor="white", zorder=6, label=OUTLIER_MARK,
        )  # fmt: skip


def draw_points(axes: Axes, points: Floats, size: float, label: str | None = None) -> None:
    """Draw points (2 or 3, p) as dots, with or without a word for the legend."""
    size = _small(size, points)
    axes.plot(
        *points[:2], "o", color=SEEN, markersize=size, markeredgewidth=0, zorder=5, label=label
    )


def draw_hidden(axes: Axes, fitted: Floats, landmarks: Floats, size: float) -> None:
    """Mark the fitted landmarks (2, p) that the image does not show with rings."""
    hidden = ~np.isfinite(landmarks).all(axis=0)
    if not hidden.any():
        return
    size = _small(size, landmarks)
    axes.plot(
        *fitted[:, hidden], "o", color=HIDDEN, markersize=size, markerfacecolor="white",
        markeredgewidth=0.25 * size, zorder=4, label=HIDDEN_MARK,
    )  # fmt: skip


def draw_error_bars(axes: Axes, points: Floats, ellipses: Ellipses) -> None:
    """Shade the ellipses of p landmarks around their points (2 or 3, p), below all else.

    The limits of the axes are left to `frame`.
    """
    from matplotlib.collections import EllipseCollection

    known = np.isfinite(points).all(axis=0) & np.isfinite(ellipses.angle)
    if not known.any():
        return
    size = 2 * ellipses.semi_axes[known]
    axes.add_collection(
        EllipseCollection(
            size[:, 0], size[:, 1], np.degrees(ellipses.angle[known]), units="xy",
            offsets=points[:2, known].T, transOffset=axes.transData, facecolors=BAR,
            edgecolors="none", alpha=FAINTNESS, zorder=0.5, label=ERROR_BAR,
        ),
        autolim=False,
    )  # fmt: skip


def draw_residuals(axes: Axes, fitted: Floats, landmarks: Floats, size: float) -> None:
    """Join each landmark (2, p) to where the model has it."""
    from matplotlib.collections import LineCollection

    lines = np.stack([landmarks.T, fitted.T], axis=1)
    lines = lines[np.isfinite(lines).all(axis=(1, 2))]
    if not len(lines):
        return
    axes.add_collection(
        LineCollection(
            list(lines), colors=INK, linewidths=0.25 * size, zorder=4, label=RESIDUAL
        )
    )  # fmt: skip


def draw_mesh(
    axes: Axes, vertices: Floats, faces: Integers, *, paleness: float = 0.0, as_pixels: bool = False
) -> None:
    """Paint a mesh, vertices (3, q) and faces (f, 3), with an outline.

    paleness 0..1 is the share of white in its colours; `as_pixels` embeds an image in SVG files.
    The limits of the axes are left to `frame`: to find them from thousands of triangles takes long.
    """
    from matplotlib.collections import LineCollection, PolyCollection

    painted = paint(vertices, faces, BODY)
    colours = (1 - paleness) * painted.colours + paleness
    axes.add_collection(
        LineCollection(
            list(painted.outline), colors=INK, linewidths=1.4, capstyle="round", zorder=1,
            rasterized=as_pixels,
        ),
        autolim=False,
    )  # fmt: skip
    axes.add_collection(
        PolyCollection(
            painted.triangles,  # type: ignore[arg-type]  # an array is taken ten times as fast
            facecolors=colours, edgecolors=colours, linewidths=0.4,
            joinstyle="round", zorder=2, rasterized=as_pixels,
        ),
        autolim=False,
    )  # fmt: skip


def draw_edges(
    axes: Axes, points: Floats, edges: Integers, width: float, *, paleness: float = 0.0
) -> None:
    """Draw edges (e, 2) between points (3, p), the near ones darker, wider and over the far.

    points (2, p) have all their edges near; edges to hidden points, nan, are left out.
    """
    from matplotlib.collections import LineCollection

    lines = points.T[edges]
    lines = lines[np.isfinite(lines).all(axis=(1, 2))]
    if not len(lines):
        return
    depth = lines[:, :, 2:].sum(axis=(1, 2))
    nearness = 1 - (depth.max() - depth) / (np.ptp(depth) or 1.0)
    order = np.argsort(depth, kind="stable")
    colours = np.asarray(FAR) + nearness[:, None] * (np.asarray(NEAR) - np.asarray(FAR))
    axes.add_collection(
        LineCollection(
            list(lines[order, :, :2]), colors=(1 - paleness) * colours[order] + paleness,
            linewidths=width * (0.6 + 0.4 * nearness[order]), capstyle="round", zorder=3,
        )
    )  # fmt: skip


def frame(axes: Axes, shape: float, *points: Floats) -> None:
    """Show all of the points (2 or 3, p), in one scale on both axes.

    shape is width / height of the panel, which is filled whatever the points.
    """
    every = np.concatenate([part[:2] for part in points], axis=1)
    every = every[:, np.isfinite(every).all(axis=0)]
    axes.set_aspect("equal")
    if not every.size:
        every = np.zeros((2, 1))
    low, high = every.min(axis=1), every.max(axis=1)
    width, height = high - low
    reach = (0.5 + MARGIN) * (max(width, shape * height) or 1.0)
    x, y = (low + high) / 2
    axes.set_xlim(x - reach, x + reach)
    axes.set_ylim(y - reach / shape, y + reach / shape)


def add_legend(figure: Figure, only: Collection[str] = ()) -> None:
    """Explain the marks that are drawn, or some of them, below the panels."""
    from matplotlib.lines import Line2D

    def mark(label: str, symbol: str, colour: str, **style: Any) -> Line2D:
        return Line2D([], [], linestyle="", marker=symbol, color=colour, label=label, **style)

    marks = [
        mark(SEEN_MARK, "o", SEEN, markersize=4, markeredgewidth=0),
        mark(HIDDEN_MARK, "o", HIDDEN, markersize=4, markerfacecolor="white"),
        mark(OUTLIER_MARK, "X", OUTLIER, markersize=6, markeredgecolor="white"),
        Line2D([], [], color=INK, linewidth=0.9, label=RESIDUAL),
        mark(ERROR_BAR, "o", BAR, markersize=8, markeredgewidth=0, alpha=2 * FAINTNESS),
    ]
    drawn = {artist.get_label() for axes in figure.axes for artist in axes.get_children()}
    explained = drawn & {*only} if only else drawn
    figure.legend(
        handles=[mark for mark in marks if mark.get_label() in explained],
        loc="lower center", ncols=len(marks), frameon=False, fontsize=8, labelcolor=INK,
    )  # fmt: skip


def _small(size: float, points: Floats) -> float:
    """Make marks smaller where there are so many that they would cover each other."""
    return size * min(1.0, (CROWD / max(1, points.shape[1])) ** 0.5)
