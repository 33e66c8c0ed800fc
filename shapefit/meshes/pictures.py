"""Sheets of fitted images: landmarks on the photograph and the model, and its sides.

Functions take arrays and give figures, which need no screen; `save` writes them as PNG
or SVG. The colours are those of the page.
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
from shapefit.geometry.rotations import rotation_about

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from PIL.Image import Image

VIEW_TILT = 12.0
"""Degrees by which a view rises above the shape."""

BODY_TURNS = (-50.0,)
"""Degrees by which the view walks around a body, as on the page."""

MESH_TURNS = (-50.0, -140.0)
"""Degrees by which the views walk around a mesh: front and back are both seen."""

SIDES_SAID = {
    1: "Each image as the camera sees it, and beside it the shape from another side",
    2: "Each image as the camera sees it, and beside it the shape from two other sides",
}
"""Number of views -> what is said of the panels of an image."""

# Those of viewer/palette.css in the light: told apart with every common form of colour
# blindness.

BODY_COLOURS = ("#00785a", "#6b52ae", "#a8467f", "#7d6608", "#4a6a7a", "#96503c")
"""Of individuals: the middle of their bodies."""

LEFT_COLOUR = "#0072b2"
RIGHT_COLOUR = "#b86e00"
MESH_COLOUR = "#8fb1e3"
INK_COLOUR = "#1d2430"

DOUBT_COLOUR = "#c6281c"
"""Of titles of shapes that are not trusted, and of outliers."""

RESIDUAL_COLOUR = "#a8006e"
"""Of lines from landmarks to where the model has them."""

LIGHT = np.array([-0.31, 0.51, 0.81])
"""Direction from which meshes are lit: the viewer's upper left."""

SHADOW = 0.5
"""Brightness of a face that the light does not reach."""

GLEAM = 0.8
"""Brightness that full light adds to it."""

PANEL_INCHES = 1.9
TITLE_INCHES = 0.2
LEGEND_LINE_INCHES = 0.18

PANELS_IN_A_ROW = 6

MIN_PANELS_WIDE = 3
"""Width of a sheet of few images, into which its legend fits."""

LEGEND_WORDS = 7
"""Words of the legend in a line of a sheet of `PANELS_IN_A_ROW`."""

LEGEND_ORDER = (
    "left",
    "right",
    "observed",
    "hidden, from the model",
    "outlier",
    "to its fitted position",
)
"""Of words of the legend, after the names of individuals."""

FONT_POINTS = 7

LETTER_INCHES = 0.058
"""Mean width of a letter of a title."""

MARK_POINTS = 3.0
"""Size of a landmark."""

BONE_POINTS = 2.0

DPI = 150

MARGIN = 0.12
"""Free border of a panel, as a share of what it shows."""

LegendEntries = dict[str, "Line2D"]
"""Label in the legend -> the line or mark that is drawn beside it."""


class DrawnModel(NamedTuple):
    """What all images of a sheet share.

    Where y points, and what the model is drawn with: faces (f, 3) of the mesh; edges
    (e, 2) of the landmarks, for shapes without a mesh; sides (p,) of the landmarks: 0
    middle, 1 left, 2 right.
    """

    y_axis: Literal["up", "down"]
    faces: Integers | None = None
    edges: Integers | None = None
    sides: Sequence[int] | None = None


class PlacedPhotograph(NamedTuple):
    """A photograph, and its width and height in the unit of the landmarks."""

    pixels: Image
    size: tuple[float, float]


class FittedImage(NamedTuple):
    """The landmarks of an image and the shape fitted to them.

    landmarks (2, p), nan = hidden; shape (3, p) and mesh (3, q) in the camera frame and
    the unit of the landmarks, nan where the fit failed; projected (2, p) and
    projected_mesh (2, q): where the camera sees them. outliers (p,): the landmarks
    judged to be wrong. doubt: why the shape is not trusted, "" where it is. upright (3,
    3) takes the camera frame to that of the object, in which y is up; None where up is
    that of the image. individual, of several, is a name and the number of its colour.
    """

    title: str
    landmarks: Floats
    shape: Floats
    projected: Floats
    mesh: Floats | None = None
    projected_mesh: Floats | None = None
    outliers: Flags | None = None
    photograph: PlacedPhotograph | None = None
    doubt: str = ""
    upright: Floats | None = None
    individual: tuple[str, int] = ("", 0)

    @property
    def is_fitted(self) -> bool:
        """Whether the image has a shape: the fit has not failed."""
        return bool(np.isfinite(self.shape).all())

    @property
    def colour(self) -> str:
        """Return the colour of the middle of the body."""
        return BODY_COLOURS[self.individual[1] % len(BODY_COLOURS)]


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
    """Draw each image, landmarks over the model, and the model from other sides."""
    from matplotlib.figure import Figure

    turns = BODY_TURNS if model.faces is None else MESH_TURNS
    panels = 1 + len(turns)
    groups = min(PANELS_IN_A_ROW // panels, len(images))
    across = max(panels * groups, MIN_PANELS_WIDE)
    rows = math.ceil(len(images) / groups)
    # What the legend names is known when all is drawn: it has room for two lines,
    # below the line that says what the panels are.
    legend_height = 3 * LEGEND_LINE_INCHES
    row_height = PANEL_INCHES + TITLE_INCHES
    height = rows * row_height + legend_height
    figure = Figure(figsize=(across * PANEL_INCHES, height))
    entries: LegendEntries = {}
    for number, image in enumerate(images):
        row, column = divmod(number, groups)
        bottom = (height - (row + 1) * row_height) / height
        for panel in range(panels if image.is_fitted else 1):
            left = (panels * column + panel + 0.01) / across
            box = (left, bottom, 0.98 / across, PANEL_INCHES / height)
            axes = figure.add_axes(box)
            axes.set_axis_off()
            axes.set_aspect("equal")
            if panel == 0:
                write_title(axes, image, panels * PANEL_INCHES)
                entries |= draw_image(axes, image, model)
            else:
                draw_shape(axes, image, model, turns[panel - 1])
    figure.text(
        0.5,
        2.5 * LEGEND_LINE_INCHES / height,
        SIDES_SAID[len(turns)],
        ha="center",
        va="center",
        fontsize=FONT_POINTS,
        color=INK_COLOUR,
    )
    draw_legend(figure, entries, across)
    return figure


def write_title(axes: Axes, image: FittedImage, inches: float) -> None:
    """Write the title of an image, and why it is not trusted, in the width `inches`."""
    letters = round(inches / LETTER_INCHES)
    doubt = f"  {printable(image.doubt)}" if image.doubt else ""
    title = printable(image.title)[-max(8, letters - len(doubt)) :]
    axes.set_title(
        (title + doubt)[:letters],
        fontsize=FONT_POINTS,
        loc="left",
        pad=2,
        parse_math=False,
        color=DOUBT_COLOUR if image.doubt else INK_COLOUR,
    )


def draw_legend(figure: Figure, entries: LegendEntries, across: int) -> None:
    """Write the legend below a sheet: what its lines and marks stand for."""
    columns = max(1, LEGEND_WORDS * across // PANELS_IN_A_ROW)
    of_all = [word for word in LEGEND_ORDER if word in entries]
    words = [*(word for word in entries if word not in of_all), *of_all]
    figure.legend(
        [entries[word] for word in words],
        [printable(word) for word in words],
        loc="lower center",
        ncols=columns,
        frameon=False,
        fontsize=FONT_POINTS,
        borderaxespad=0.1,
        columnspacing=1.2,
        handletextpad=0.3,
    )


def draw_image(axes: Axes, image: FittedImage, model: DrawnModel) -> LegendEntries:
    """Draw the photograph, the model and the landmarks, as the camera sees them.

    Returns entries of the legend for what is drawn.
    """
    entries: LegendEntries = {}
    shown = [image.landmarks]
    if image.photograph is not None:
        draw_photograph(axes, image.photograph, model)
    if image.is_fitted:
        shown.append(image.projected)
        if image.projected_mesh is not None and model.faces is not None:
            shown.append(image.projected_mesh)
            draw_silhouette(axes, image.projected_mesh, model)
        elif model.edges is not None:
            entries |= draw_bones(axes, image, image.projected, model)
        entries |= draw_residuals(axes, image)
    else:
        axes.text(
            0.5,
            0.5,
            "no shape",
            ha="center",
            fontsize=FONT_POINTS,
            transform=axes.transAxes,
        )
    entries |= draw_landmarks(axes, image)
    every = np.concatenate(shown, axis=1)
    low, high = _limits(every[:, np.isfinite(every).all(axis=0)])
    axes.set_xlim(low[0], high[0])
    if model.y_axis == "down":
        axes.set_ylim(high[1], low[1])
    else:
        axes.set_ylim(low[1], high[1])
    return entries


def draw_photograph(
    axes: Axes, photograph: PlacedPhotograph, model: DrawnModel
) -> None:
    """Draw a photograph in the coordinates of the landmarks."""
    width, height = photograph.size
    lower, upper = (height, 0) if model.y_axis == "down" else (0, height)
    axes.imshow(photograph.pixels, extent=(0, width, lower, upper))


def draw_silhouette(axes: Axes, mesh: Floats, model: DrawnModel) -> None:
    """Fill a mesh (2, q) as the camera sees it.

    The faces that look at it are one path, so that neighbours leave no gaps and do not
    add up.
    """
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    corners = mesh.T[model.faces]
    to_second = corners[:, 1] - corners[:, 0]
    to_third = corners[:, 2] - corners[:, 0]
    turn = to_second[:, 0] * to_third[:, 1] - to_second[:, 1] * to_third[:, 0]
    is_front = turn > 0 if model.y_axis == "up" else turn < 0
    points = corners[is_front][:, [0, 1, 2, 0]].reshape(-1, 2)
    steps = [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY]
    codes = np.tile(np.array(steps, np.uint8), np.count_nonzero(is_front))
    patch = PathPatch(
        Outline(points, codes), facecolor=MESH_COLOUR, linewidth=0, alpha=0.55
    )
    # `add_patch` asks each edge for its extremes, though the limits are set here.
    axes.add_artist(patch).set_rasterized(True)


def draw_bones(
    axes: Axes,
    image: FittedImage,
    points: Floats,
    model: DrawnModel,
    nearness: Floats | None = None,
) -> LegendEntries:
    """Draw bones between points (2, p) in the colours of their sides.

    nearness (p,): the bones of near landmarks are drawn last. Returns entries of
    the legend for the sides that there are.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D

    edges = np.asarray(model.edges).reshape(-1, 2)
    if nearness is not None:
        edges = edges[np.argsort(nearness[edges].sum(axis=1), kind="stable")]
    sides = np.zeros(points.shape[1], np.intp)
    if model.sides is not None:
        sides = np.asarray(model.sides, np.intp)
    ends = sides[edges]
    is_across = (ends > 0).all(axis=1) & (ends[:, 0] != ends[:, 1])
    side_of_bone = np.where(is_across, 0, ends.max(axis=1, initial=0))
    colours = (image.colour, LEFT_COLOUR, RIGHT_COLOUR)
    bones = LineCollection(
        list(points.T[edges]),
        colors=[colours[side] for side in side_of_bone],
        linewidths=BONE_POINTS,
        capstyle="round",
        zorder=2,
    )
    axes.add_collection(bones, autolim=False)
    words = {0: image.individual[0], 1: "left", 2: "right"}
    return {
        word: Line2D([], [], color=colours[side], linewidth=BONE_POINTS)
        for side, word in words.items()
        if word and side in side_of_bone
    }


def draw_residuals(axes: Axes, image: FittedImage) -> LegendEntries:
    """Draw lines from landmarks to where the model projects them.

    Returns their entry of the legend, {} where no line is drawn.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D

    lines = np.stack([image.landmarks.T, image.projected.T], axis=1)
    lines = lines[np.isfinite(lines).all(axis=(1, 2))]
    if not len(lines):
        return {}
    residuals = LineCollection(
        list(lines), colors=RESIDUAL_COLOUR, linewidths=0.8, zorder=3
    )
    axes.add_collection(residuals, autolim=False)
    return {"to its fitted position": Line2D([], [], color=RESIDUAL_COLOUR)}


def draw_landmarks(axes: Axes, image: FittedImage) -> LegendEntries:
    """Draw landmarks: those observed, outliers, and hidden ones of the model.

    Returns entries of the legend for those that there are.
    """
    is_hidden = ~np.isfinite(image.landmarks).all(axis=0)
    is_wrong = np.zeros_like(is_hidden)
    if image.outliers is not None:
        is_wrong = image.outliers
    from_model = np.empty((2, 0))
    if image.is_fitted:
        from_model = image.projected[:, is_hidden]
    entries: LegendEntries = {}
    if np.isfinite(from_model).any():
        (entries["hidden, from the model"],) = axes.plot(
            *from_model,
            linestyle="",
            marker="o",
            markersize=MARK_POINTS,
            markerfacecolor="white",
            markeredgecolor=INK_COLOUR,
            markeredgewidth=0.6,
            zorder=4,
        )
    if np.isfinite(image.landmarks[:, ~is_wrong]).any():
        (entries["observed"],) = axes.plot(
            *image.landmarks[:, ~is_wrong],
            linestyle="",
            marker="o",
            markersize=MARK_POINTS,
            color=INK_COLOUR,
            markeredgecolor="white",
            markeredgewidth=0.4,
            zorder=4,
        )
    if np.isfinite(image.landmarks[:, is_wrong]).any():
        (entries["outlier"],) = axes.plot(
            *image.landmarks[:, is_wrong],
            linestyle="",
            marker="X",
            markersize=2 * MARK_POINTS,
            color=DOUBT_COLOUR,
            markeredgecolor="white",
            markeredgewidth=0.4,
            zorder=4,
        )
    return entries


def draw_shape(axes: Axes, image: FittedImage, model: DrawnModel, turn: float) -> None:
    """Draw the mesh, else the bones, else the points of a shape, seen from a side.

    The projection is orthographic: far ones first, and all of it inside the panel.
    """
    frame = viewer_frame(image, model, turn)
    centre = image.shape.mean(axis=1, keepdims=True)
    points = frame @ (image.shape - centre)
    shown = points
    if image.mesh is not None and model.faces is not None:
        shown = frame @ (image.mesh - centre)
        draw_solid(axes, shown, model.faces)
    else:
        if model.edges is not None:
            draw_bones(axes, image, points[:2], model, nearness=points[2])
        axes.plot(
            *points[:2],
            linestyle="",
            marker="o",
            markersize=MARK_POINTS - 0.5,
            markeredgewidth=0,
            color=INK_COLOUR,
            zorder=3,
        )
    low, high = _limits(shown[:2])
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def viewer_frame(image: FittedImage, model: DrawnModel, turn: float) -> Floats:
    """Return the rotation (3, 3) from the camera frame to that of the viewer.

    In the viewer's x is right, y up and z towards the viewer, who walks around the
    shape by `turn` degrees and rises by `VIEW_TILT`.
    """
    upright = np.diag([1.0, 1.0, 1.0] if model.y_axis == "up" else [1.0, -1.0, -1.0])
    if image.upright is not None:
        upright = image.upright
    right, up, _ = np.eye(3)
    (around,) = rotation_about(up, np.radians([turn]))
    (above,) = rotation_about(right, np.radians([VIEW_TILT]))
    return np.asarray(above @ around @ upright)


def draw_solid(axes: Axes, vertices: Floats, faces: Integers) -> None:
    """Draw the faces (f, 3) of a mesh (3, q) that look at the viewer, lit, far first.

    Each has corners of its own, which share its colour.
    """
    from matplotlib.collections import TriMesh
    from matplotlib.colors import to_rgb
    from matplotlib.tri import Triangulation

    corners = vertices.T[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.maximum(lengths, 1e-30)
    far_first = np.argsort(corners[:, :, 2].sum(axis=1), kind="stable")
    visible = far_first[normals[far_first, 2] > 0]
    if not len(visible):  # an open mesh, seen from behind
        return
    brightness = SHADOW + GLEAM * np.clip(normals[visible] @ LIGHT, 0, 1)
    colours = np.clip(brightness[:, None] * to_rgb(MESH_COLOUR), 0, 1)
    x, y = corners[visible, :, :2].reshape(-1, 2).T
    triangles = Triangulation(x, y, np.arange(len(x)).reshape(-1, 3))
    solid = TriMesh(triangles, facecolors=np.repeat(colours, 3, axis=0))
    axes.add_collection(solid, autolim=False).set_rasterized(True)


def _limits(points: Floats) -> tuple[Floats, Floats]:
    """Return lowest and highest corner (2,) of a square around points (2, p).

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
