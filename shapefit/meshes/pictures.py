"""Pictures of fitted shapes: rows of panels, a contact sheet, skeletons side by side.

Functions take arrays and give figures, which need no screen; `shapefit.evaluation.plots.save`
writes them as PNG or SVG.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.meshes import panels
from shapefit.meshes.ellipses import seen_ellipses
from shapefit.meshes.views import View, YAxis, level, upright

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Grid = NDArray[Any]
"""Axes (rows, columns)."""

NOVEL_VIEWS = (View(60, 15), View(-60, 15))
SKELETON_VIEW = View(45, 10)

WIDE, TALL = 1.4, 0.72
"""Width / height of the panels of fitted images, and of skeletons."""
HEIGHT, SMALL_HEIGHT, TALL_HEIGHT = 1.85, 0.95, 2.2
"""Height of a panel in inches: of a row, in a contact sheet, of a skeleton."""
BORDER, GAP = 0.3, 0.12
"""Inches around all panels, and between rows."""
MARK, SMALL_MARK = 3.2, 1.7
"""Diameter in points of the mark of a landmark."""
ROW_LETTERS, SHEET_LETTERS = 32, 40
"""Letters of a title that fit beside a row, and above an image of a contact sheet."""
SHEET_COLUMNS = 4
UNDER_LANDMARKS = 0.72
"""Paleness of a mesh that has landmarks drawn over it."""


@dataclass(frozen=True)
class Model:
    """What all images of a picture share: where y points, and what the model is drawn with.

    faces (f, 3) of the mesh; edges (e, 2) of the landmarks, for shapes without a mesh.
    """

    y_axis: YAxis
    faces: Integers | None = None
    edges: Integers | None = None


@dataclass(frozen=True)
class FittedImage:
    """The landmarks of an image and the shape fitted to them.

    landmarks (2, p), nan = hidden; shape (3, p) and mesh_vertices (3, q) in the camera frame and
    the unit of the landmarks, nan where the fit failed; outliers (p,): the landmarks judged to be
    wrong; rotation (3, 3) from the object frame, whose y axis then stands upright in novel views.
    seen_shape (3, p) and seen_mesh (3, q): x and y where the camera sees them, and depths, if that
    is not straight along z. covariance (p, 3, 3) of the landmarks of the shape in the camera frame,
    where it is known.
    """

    title: str
    landmarks: Floats
    shape: Floats
    mesh_vertices: Floats | None = None
    outliers: Flags | None = None
    rotation: Floats | None = None
    seen_shape: Floats | None = None
    seen_mesh: Floats | None = None
    covariance: Floats | None = None

    @property
    def as_seen(self) -> FittedImage:
        """Return the image with shape and mesh as the camera sees them."""
        shape = self.shape if self.seen_shape is None else self.seen_shape
        mesh = self.mesh_vertices if self.seen_mesh is None else self.seen_mesh
        return replace(self, shape=shape, mesh_vertices=mesh)

    @property
    def fitted(self) -> bool:
        """Return whether there is a shape."""
        return bool(np.isfinite(self.shape).all())


@dataclass(frozen=True)
class Pose:
    """The landmarks (2, p) of an image and shapes (3, p) in its camera frame, by name.

    covariances (p, 3, 3) of those shapes whose error bars are known.
    """

    title: str
    landmarks: Floats
    shapes: Mapping[str, Floats]
    covariances: Mapping[str, Floats] = field(default_factory=dict)


def fit_picture(
    images: Sequence[FittedImage], model: Model, views: Sequence[View] = NOVEL_VIEWS
) -> Figure:
    """One row per image: its landmarks, the fitted model under them, the model in novel views."""
    heads = ["landmarks", "fitted model", *(f"turned by {view.turn:+g}°" for view in views)]
    figure, grid = _grid(len(images), len(heads), WIDE, HEIGHT)
    for row, image in zip(grid, images, strict=True):
        _draw_input(row[0], image, model)
        if image.fitted:
            _draw_overlay(row[1], image, model)
        else:
            _say_no_shape(row[1])
        for axes, view in zip(row[2:], views, strict=True):
            _draw_in_3d(axes, image, model, view)
    _name_rows(grid, [image.title for image in images])
    _name_columns(grid, heads)
    panels.add_legend(figure)
    return figure


def contact_sheet(
    images: Sequence[FittedImage], model: Model, view: View = NOVEL_VIEWS[0]
) -> Figure:
    """All images, small: the fitted model under the landmarks, and in a novel view.

    Meshes are pixels in SVG too: as vectors they would make the file too large to open.
    """
    columns = min(SHEET_COLUMNS, len(images))
    figure, grid = _grid(math.ceil(len(images) / columns), 2 * columns, WIDE, SMALL_HEIGHT)
    pairs = grid.reshape(-1, 2)
    for (flat, solid), image in zip(pairs, images, strict=False):
        _draw_overlay(flat, image, model, size=SMALL_MARK, as_pixels=True)
        _draw_in_3d(solid, image, model, view, as_pixels=True)
        title = _shown(image.title, SHEET_LETTERS)
        flat.set_title(title, fontsize=7, color=panels.INK, loc="left", pad=0, parse_math=False)
    panels.add_legend(figure)
    return figure


def skeleton_picture(
    poses: Sequence[Pose], edges: Integers, y_axis: YAxis, view: View = SKELETON_VIEW
) -> Figure:
    """One row a pose: the landmarks, then its shapes (estimates, truth) in a novel view.

    All poses have shapes of the same names; the columns follow their order in the first.
    """
    names = list(poses[0].shapes)
    figure, grid = _grid(len(poses), 1 + len(names), TALL, TALL_HEIGHT)
    for row, pose in zip(grid, poses, strict=True):
        landmarks = upright(pose.landmarks, y_axis)
        panels.draw_edges(row[0], landmarks, edges, 2.0)
        panels.draw_landmarks(row[0], landmarks, None, MARK)
        panels.frame(row[0], TALL, landmarks)
        for axes, name in zip(row[1:], names, strict=True):
            turned = view.rotation() @ upright(pose.shapes[name], y_axis)
            panels.draw_edges(axes, turned, edges, 3.5)
            if name in pose.covariances:
                bars = seen_ellipses(pose.covariances[name], view.rotation(), y_axis)
                panels.draw_error_bars(axes, turned, bars)
            panels.frame(axes, TALL, turned)
    _name_rows(grid, [pose.title for pose in poses])
    _name_columns(grid, ["landmarks", *names])
    panels.add_legend(figure, only=(panels.ERROR_BAR,))
    return figure


def _draw_input(axes: Axes, image: FittedImage, model: Model, size: float = MARK) -> None:
    landmarks = upright(image.landmarks, model.y_axis)
    panels.draw_landmarks(axes, landmarks, image.outliers, size)
    seen = image.as_seen
    solid = seen.shape if seen.mesh_vertices is None else seen.mesh_vertices
    panels.frame(axes, WIDE, landmarks, upright(solid, model.y_axis))


def _draw_overlay(
    axes: Axes, image: FittedImage, model: Model, size: float = MARK, *, as_pixels: bool = False
) -> None:
    """Draw what `_draw_input` does, in the same place, over the fitted model."""
    if image.fitted:
        seen = image.as_seen
        fitted = upright(seen.shape[:2], model.y_axis)
        landmarks = upright(image.landmarks, model.y_axis)
        _draw_model(axes, seen, model, np.eye(3), paleness=UNDER_LANDMARKS, as_pixels=as_pixels)
        panels.draw_residuals(axes, fitted, landmarks, size)
        _draw_error_bars(axes, image, fitted, np.eye(3), model)
        panels.draw_hidden(axes, fitted, landmarks, size)
    _draw_input(axes, image, model, size)


def _draw_in_3d(
    axes: Axes, image: FittedImage, model: Model, view: View, *, as_pixels: bool = False
) -> None:
    if not image.fitted:
        _say_no_shape(axes)
        return
    rotation = view.rotation()
    if image.rotation is not None:
        rotation = rotation @ level(upright(image.rotation, model.y_axis)[:, 1])
    drawn = _draw_model(axes, image, model, rotation, as_pixels=as_pixels)
    _draw_error_bars(axes, image, rotation @ upright(image.shape, model.y_axis), rotation, model)
    panels.frame(axes, WIDE, drawn)


def _draw_error_bars(
    axes: Axes, image: FittedImage, points: Floats, rotation: Floats, model: Model
) -> None:
    if image.covariance is not None:
        bars = seen_ellipses(image.covariance, rotation, model.y_axis)
        panels.draw_error_bars(axes, points, bars)


def _say_no_shape(axes: Axes) -> None:
    axes.text(
        0.5, 0.5, "no shape", ha="center", va="center", fontsize=7, color=panels.INK,
        transform=axes.transAxes,
    )  # fmt: skip


def _draw_model(
    axes: Axes,
    image: FittedImage,
    model: Model,
    rotation: Floats,
    *,
    paleness: float = 0.0,
    as_pixels: bool,
) -> Floats:
    """Draw the mesh, else the edges, else the points of a fitted image; return what was drawn."""
    if model.faces is not None and image.mesh_vertices is not None:
        vertices = rotation @ upright(image.mesh_vertices, model.y_axis)
        panels.draw_mesh(axes, vertices, model.faces, paleness=paleness, as_pixels=as_pixels)
        return vertices
    points = rotation @ upright(image.shape, model.y_axis)
    if model.edges is None:
        panels.draw_points(axes, points, MARK)
    else:
        panels.draw_edges(axes, points, model.edges, 1.5, paleness=paleness)
    return points


def _grid(rows: int, columns: int, shape: float, height: float) -> tuple[Figure, Grid]:
    """A figure of equal panels without axes, with room for names around them."""
    from matplotlib.figure import Figure

    width = shape * height
    size = np.array([BORDER + columns * width, 2 * BORDER + rows * (height + GAP)])
    figure = Figure(figsize=tuple(size))
    grid = np.empty((rows, columns), dtype=object)
    for row, column in np.ndindex(grid.shape):
        corner = BORDER + column * width, BORDER + (rows - 1 - row) * (height + GAP)
        place = np.concatenate([corner / size, (width, height) / size])
        axes = figure.add_axes(tuple(place))
        axes.set_axis_off()
        grid[row, column] = axes
    return figure, grid


def _name_rows(grid: Grid, titles: Sequence[str]) -> None:
    for axes, title in zip(grid[:, 0], titles, strict=True):
        axes.annotate(
            _shown(title, ROW_LETTERS), (0, 0.5), xytext=(-2, 0), xycoords="axes fraction",
            textcoords="offset points", rotation=90, ha="right", va="center", fontsize=6.5,
            color=panels.INK, parse_math=False,
        )  # fmt: skip


def _name_columns(grid: Grid, heads: Sequence[str]) -> None:
    for axes, head in zip(grid[0], heads, strict=True):
        axes.set_title(head, fontsize=9, color=panels.INK, pad=4, parse_math=False)


def _shown(title: str, letters: int) -> str:
    """Return a title in one line of at most that many letters, most of them from its end.

    Images of a sequence differ at the end. What cannot be printed is written as in Python.
    """
    line = "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in title
    )
    if len(line) <= letters:
        return line
    head = letters // 3
    return f"{line[:head]}…{line[head + 1 - letters :]}"
