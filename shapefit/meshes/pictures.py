"""Pictures of fitted images: landmarks over the fitted model, and the model in 3D from
beside it.

Functions take arrays and give figures, which need no screen; `save` writes them as PNG
or SVG.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import input_error, printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D


TURN, TILT = 60, 15
"""Degrees by which the view of the shape walks around it and rises above it."""
# Okabe and Ito 2008: told apart with every common form of colour blindness.
VISIBLE, HIDDEN, OUTLIER = "#0072B2", "#555555", "#D55E00"
INK, BODY, PALE = "#333333", "#8FB1E3", "#E3EBF7"
SIZE, MARK, DPI = 1.6, 2.4, 150
"""Width of a panel in inches, size of a landmark in points, dots per inch."""
PAIRS_IN_A_ROW, LETTERS = 4, 40
"""Images in a row, and last letters of a title that fit above one."""
IN_AXES = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""From x right, y up, z towards the viewer to the 3D axes: x right, y away, z up."""
MARGIN = 0.06
"""Free border of a panel, as a share of what it shows."""


class Model(NamedTuple):
    """What all images of a picture share: where y points, and what the model is drawn
    with.

    faces (f, 3) of the mesh; edges (e, 2) of the landmarks, for shapes without a mesh.
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


def contact_sheet(images: Sequence[FittedImage], model: Model) -> Figure:
    """Draw each image small: landmarks over the fitted model, and the model from
    another side.
    """
    from matplotlib.figure import Figure

    pairs = min(PAIRS_IN_A_ROW, len(images))
    across, rows = 2 * pairs, math.ceil(len(images) / pairs)
    figure = Figure(figsize=(across * SIZE, rows * SIZE + 0.3))
    figure.subplots_adjust(
        0.01, 0.3 / (rows * SIZE + 0.3), 0.99, 1 - 0.1 / rows, 0.02, 0.12
    )
    drawn: dict[str, Any] = {}
    for number, image in enumerate(images):
        flat = figure.add_subplot(rows, across, 1 + 2 * number)
        draw_image(flat, image, model)
        title = printable(image.title)[-LETTERS:]
        flat.set_title(title, fontsize=7, loc="left", pad=2, parse_math=False)
        handles, labels = flat.get_legend_handles_labels()
        drawn |= dict(zip(labels, handles, strict=True))
        if image.fitted:
            solid = figure.add_subplot(rows, across, 2 + 2 * number, projection="3d")
            draw_shape(solid, image, model)
    figure.legend(
        drawn.values(),
        drawn.keys(),
        loc="lower center",
        ncols=5,
        frameon=False,
        fontsize=7,
    )
    return figure


def draw_image(axes: Axes, image: FittedImage, model: Model) -> None:
    """Draw the landmarks over the fitted model, as the camera sees them."""
    from matplotlib.collections import LineCollection, PolyCollection

    hidden = ~np.isfinite(image.landmarks).all(axis=0)
    wrong = np.zeros_like(hidden) if image.outliers is None else image.outliers
    projected = (
        image.projected if image.fitted else np.full_like(image.landmarks, np.nan)
    )
    shown = [image.landmarks, projected]
    if image.fitted and image.projected_mesh is not None and model.faces is not None:
        shown.append(image.projected_mesh)
        triangles = list(image.projected_mesh.T[model.faces])
        mesh = PolyCollection(
            triangles, facecolors=PALE, edgecolors=PALE, linewidths=0.4
        )
        axes.add_collection(mesh).set_rasterized(True)
    elif image.fitted and model.edges is not None:
        bones = list(projected.T[model.edges])
        axes.add_collection(LineCollection(bones, colors=BODY, linewidths=1.5))
    lines = np.stack([image.landmarks.T, projected.T], axis=1)
    lines = lines[np.isfinite(lines).all(axis=(1, 2))]
    if len(lines):
        residuals = LineCollection(
            list(lines), colors=INK, linewidths=0.8, label="to the model"
        )
        axes.add_collection(residuals)
    hollow = {
        "color": HIDDEN,
        "markerfacecolor": "white",
        "markeredgewidth": 0.25 * MARK,
    }
    cross = {
        "color": OUTLIER,
        "marker": "X",
        "markersize": 2 * MARK,
        "markeredgewidth": 0.4,
    }
    dot = {"color": VISIBLE, "markeredgewidth": 0}
    for points, label, look in (
        (projected[:, hidden], "hidden, from the model", hollow),
        (image.landmarks[:, ~wrong], "seen", dot),
        (image.landmarks[:, wrong], "judged outlier", cross),
    ):
        if np.isfinite(points).any():
            style: dict[str, Any] = {
                "marker": "o",
                "markersize": MARK,
                "linestyle": "",
            } | look
            axes.plot(*points, label=label, **style)
    if not image.fitted:
        axes.text(
            0.5, 0.5, "no shape", ha="center", fontsize=7, transform=axes.transAxes
        )
    every = np.concatenate(shown, axis=1)
    low, high = _limits(every[:, np.isfinite(every).all(axis=0)])
    axes.set_xlim(low[0], high[0])
    axes.set_ylim((high[1], low[1]) if model.y_axis == "down" else (low[1], high[1]))
    axes.set_aspect("equal")
    axes.set_axis_off()


def draw_shape(axes: Axes3D, image: FittedImage, model: Model) -> None:
    """Draw the mesh, else the edges, else the points of a shape, in 3D axes."""
    from matplotlib.colors import LightSource
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

    frame = IN_AXES @ np.diag(
        [1.0, 1.0, 1.0] if model.y_axis == "up" else [1.0, -1.0, -1.0]
    )
    solid = points = frame @ image.shape
    if image.mesh is not None and model.faces is not None:
        solid = frame @ image.mesh
        light = LightSource(azdeg=-45 - TURN, altdeg=45)
        look = {"facecolors": BODY, "edgecolors": BODY, "linewidths": 0.3}
        mesh = Poly3DCollection(
            list(solid.T[model.faces]), shade=True, lightsource=light, **look
        )
        axes.add_collection3d(mesh).set_rasterized(True)
    elif model.edges is not None:
        bones = list(points.T[model.edges])
        axes.add_collection3d(Line3DCollection(bones, colors=VISIBLE, linewidths=1.5))
    else:
        axes.plot(*points, linestyle="", marker="o", markersize=2.5, color=VISIBLE)
    low, high = _limits(solid)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect((1, 1, 1), zoom=1.75)
    axes.set_proj_type("ortho")
    axes.view_init(elev=TILT, azim=-90 - TURN)
    axes.set_axis_off()


def _limits(points: Floats) -> tuple[Floats, Floats]:
    """Lowest and highest coordinates of a square or cube around the points (d, p)."""
    if not points.size:
        points = np.zeros((len(points), 1))
    low, high = points.min(axis=1), points.max(axis=1)
    reach = (0.5 + MARGIN) * ((high - low).max() or 1.0)
    return (low + high) / 2 - reach, (low + high) / 2 + reach
