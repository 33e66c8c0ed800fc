"""Pictures of fitted images: landmarks over the model, and the model from beside it.

Functions take arrays and give figures, which need no screen; `save` writes them as PNG
or SVG.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import input_error, printable

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D


VIEW_TURN = 60
"""Degrees by which the view of the shape walks around it."""

VIEW_TILT = 15
"""Degrees by which the view of the shape rises above it."""

# Okabe and Ito 2008: told apart with every common form of colour blindness.

VISIBLE_COLOUR = "#0072B2"
HIDDEN_COLOUR = "#555555"
OUTLIER_COLOUR = "#D55E00"

LINE_COLOUR = "#333333"
"""Of lines from landmarks to the model."""

BODY_COLOUR = "#8FB1E3"
"""Of the model."""

PALE_COLOUR = "#E3EBF7"
"""Of a mesh below the landmarks."""

PANEL_INCHES = 1.6
"""Width of a panel."""

LEGEND_INCHES = 0.3
"""Height of the legend below all panels."""

MARK_POINTS = 2.4
"""Size of a landmark."""

DPI = 150

PAIRS_IN_A_ROW = 4
"""Images in a row, each with its shape."""

TITLE_LETTERS = 40
"""Last letters of a title, which fit above an image."""

MARGIN = 0.06
"""Free border of a panel, as a share of what it shows."""

IN_AXES = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""From x right, y up, z towards the viewer to the 3D axes: x right, y away, z up."""


class DrawnModel(NamedTuple):
    """What all images of a picture share.

    Where y points, and what the model is drawn with: faces (f, 3) of the mesh; edges
    (e, 2) of the landmarks, for shapes without a mesh.
    """

    y_axis: Literal["up", "down"]
    faces: Integers | None = None
    edges: Integers | None = None


class FittedImage(NamedTuple):
    """The landmarks of an image and the shape fitted to them.

    landmarks (2, p), nan = hidden; shape (3, p) and mesh (3, q) in the camera frame and
    the unit of the landmarks, nan where the fit failed; projected (2, p) and
    projected_mesh (2, q): where the camera sees them. outliers (p,): the landmarks
    judged to be wrong.
    """

    title: str
    landmarks: Floats
    shape: Floats
    projected: Floats
    mesh: Floats | None = None
    projected_mesh: Floats | None = None
    outliers: Flags | None = None

    @property
    def fitted(self) -> bool:
        """Return whether there is a shape."""
        return bool(np.isfinite(self.shape).all())


def check_can_draw(key: str) -> None:
    """Raise InputError at `key` where matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        fix = "install it with `pip install matplotlib`"
        raise input_error(key, "matplotlib is not installed", fix)


def save(figure: Figure, path: Path, file_format: str) -> None:
    """Write the figure as png or svg; the same figure gives the same bytes."""
    import matplotlib

    metadata = {"Date": None} if file_format == "svg" else {"Software": None}
    with matplotlib.rc_context({"svg.hashsalt": "shapefit"}), warnings.catch_warnings():
        # A letter that the font lacks, as some names have, is drawn as a box.
        warnings.filterwarnings("ignore", "Glyph .* missing from ")
        figure.savefig(path, format=file_format, dpi=DPI, metadata=metadata)


def contact_sheet(images: Sequence[FittedImage], model: DrawnModel) -> Figure:
    """Draw each image small, the landmarks over the model, and the model beside it."""
    from matplotlib.figure import Figure

    pairs = min(PAIRS_IN_A_ROW, len(images))
    columns = 2 * pairs
    rows = math.ceil(len(images) / pairs)
    height = rows * PANEL_INCHES + LEGEND_INCHES
    figure = Figure(figsize=(columns * PANEL_INCHES, height))
    figure.subplots_adjust(
        left=0.01,
        bottom=LEGEND_INCHES / height,
        right=0.99,
        top=1 - 0.1 / rows,
        wspace=0.02,
        hspace=0.12,
    )
    handle_of: dict[str, Artist] = {}
    for number, image in enumerate(images):
        flat = figure.add_subplot(rows, columns, 1 + 2 * number)
        draw_image(flat, image, model)
        title = printable(image.title)[-TITLE_LETTERS:]
        flat.set_title(title, fontsize=7, loc="left", pad=2, parse_math=False)
        handles, labels = flat.get_legend_handles_labels()
        handle_of.update(zip(labels, handles, strict=True))
        if image.fitted:
            solid = figure.add_subplot(rows, columns, 2 + 2 * number, projection="3d")
            draw_shape(solid, image, model)
    figure.legend(
        handle_of.values(),
        handle_of.keys(),
        loc="lower center",
        ncols=5,
        frameon=False,
        fontsize=7,
    )
    return figure


def draw_image(axes: Axes, image: FittedImage, model: DrawnModel) -> None:
    """Draw the landmarks over the fitted model, as the camera sees them."""
    shown = [image.landmarks]
    if image.fitted:
        shown += draw_projection(axes, image, model)
    draw_landmarks(axes, image)
    if not image.fitted:
        axes.text(
            0.5, 0.5, "no shape", ha="center", fontsize=7, transform=axes.transAxes
        )
    every = np.concatenate(shown, axis=1)
    low, high = _limits(every[:, np.isfinite(every).all(axis=0)])
    axes.set_xlim(low[0], high[0])
    if model.y_axis == "down":
        axes.set_ylim(high[1], low[1])
    else:
        axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_axis_off()


def draw_projection(axes: Axes, image: FittedImage, model: DrawnModel) -> list[Floats]:
    """Draw where the camera sees the model, with lines to the landmarks.

    Returns the points (2, ...) that the panel is to show.
    """
    from matplotlib.collections import LineCollection, PolyCollection

    shown = [image.projected]
    if image.projected_mesh is not None and model.faces is not None:
        shown.append(image.projected_mesh)
        triangles = list(image.projected_mesh.T[model.faces])
        mesh = PolyCollection(
            triangles, facecolors=PALE_COLOUR, edgecolors=PALE_COLOUR, linewidths=0.4
        )
        axes.add_collection(mesh).set_rasterized(True)
    elif model.edges is not None:
        bones = list(image.projected.T[model.edges])
        axes.add_collection(LineCollection(bones, colors=BODY_COLOUR, linewidths=1.5))
    lines = np.stack([image.landmarks.T, image.projected.T], axis=1)
    lines = lines[np.isfinite(lines).all(axis=(1, 2))]
    if len(lines):
        residuals = LineCollection(
            list(lines), colors=LINE_COLOUR, linewidths=0.8, label="to the model"
        )
        axes.add_collection(residuals)
    return shown


def draw_landmarks(axes: Axes, image: FittedImage) -> None:
    """Draw landmarks: those seen, those judged wrong, and hidden ones of the model."""
    is_hidden = ~np.isfinite(image.landmarks).all(axis=0)
    is_wrong = np.zeros_like(is_hidden)
    if image.outliers is not None:
        is_wrong = image.outliers
    if image.fitted and np.isfinite(image.projected[:, is_hidden]).any():
        axes.plot(
            *image.projected[:, is_hidden],
            label="hidden, from the model",
            linestyle="",
            marker="o",
            markersize=MARK_POINTS,
            color=HIDDEN_COLOUR,
            markerfacecolor="white",
            markeredgewidth=0.25 * MARK_POINTS,
        )
    if np.isfinite(image.landmarks[:, ~is_wrong]).any():
        axes.plot(
            *image.landmarks[:, ~is_wrong],
            label="seen",
            linestyle="",
            marker="o",
            markersize=MARK_POINTS,
            color=VISIBLE_COLOUR,
            markeredgewidth=0,
        )
    if np.isfinite(image.landmarks[:, is_wrong]).any():
        axes.plot(
            *image.landmarks[:, is_wrong],
            label="judged outlier",
            linestyle="",
            marker="X",
            markersize=2 * MARK_POINTS,
            color=OUTLIER_COLOUR,
            markeredgewidth=0.4,
        )


def draw_shape(axes: Axes3D, image: FittedImage, model: DrawnModel) -> None:
    """Draw the mesh, else the edges, else the points of a shape, in 3D axes."""
    from matplotlib.colors import LightSource
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    y_up = np.diag([1.0, 1.0, 1.0] if model.y_axis == "up" else [1.0, -1.0, -1.0])
    frame = IN_AXES @ y_up
    points = frame @ image.shape
    solid = points
    if image.mesh is not None and model.faces is not None:
        solid = frame @ image.mesh
        mesh = Poly3DCollection(
            list(solid.T[model.faces]),
            shade=True,
            lightsource=LightSource(azdeg=-45 - VIEW_TURN, altdeg=45),
            facecolors=BODY_COLOUR,
            edgecolors=BODY_COLOUR,
            linewidths=0.3,
        )
        axes.add_collection3d(mesh).set_rasterized(True)
    elif model.edges is not None:
        bones = Line3DCollection(
            list(points.T[model.edges]), colors=VISIBLE_COLOUR, linewidths=1.5
        )
        axes.add_collection3d(bones)
    else:
        axes.plot(
            *points, linestyle="", marker="o", markersize=2.5, color=VISIBLE_COLOUR
        )
    low, high = _limits(solid)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect((1, 1, 1), zoom=1.75)
    axes.set_proj_type("ortho")
    axes.view_init(elev=VIEW_TILT, azim=-90 - VIEW_TURN)
    axes.set_axis_off()


def _limits(points: Floats) -> tuple[Floats, Floats]:
    """Return lowest and highest corner (d,) of a square or cube around points (d, p).

    With a margin; the points must be finite.
    """
    if not points.size:
        points = np.zeros((len(points), 1))
    low = points.min(axis=1)
    high = points.max(axis=1)
    widest = (high - low).max() or 1.0
    reach = (0.5 + MARGIN) * widest
    middle = (low + high) / 2
    return middle - reach, middle + reach
