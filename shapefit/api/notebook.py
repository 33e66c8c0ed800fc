"""A fit in a notebook: a picture and a table, a plot, and the page of `view`."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from shapefit.api.arguments import File
from shapefit.arrays import Flags, Floats, evenly
from shapefit.config import load_config
from shapefit.errors import input_error, listed
from shapefit.io.formats import result_writer
from shapefit.io.skeletons import edges_of
from shapefit.records import Fit
from shapefit.records.columns import present_columns
from shapefit.records.page import Page

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

MAX_DRAWN_IMAGES = 6
"""Images in the picture of a fit, at most."""

DRAWING_SIDE = 110
"""Pixels of each of them."""

DRAWING_MARGIN = 0.1
"""Share of the side that stays empty."""

DOUBTFUL_OPACITY = 0.35
"""Of images that are not trusted."""


def as_html(fit: Fit) -> str:
    """Return HTML of a fit: a line, a picture of some images, a table of its fields."""
    fit = fit.named()
    rows = "".join(
        f"<tr><td><code>{column.field}</code></td><td>{np.shape(values)}</td>"
        f"<td>{escape(column.unit)}</td></tr>"
        for column, values in present_columns(fit)
    )
    head = "<tr><th>field</th><th>shape</th><th>unit</th></tr>"
    table = f"<table>{head}{rows}</table>"
    return (
        f"<div><p>{escape(repr(fit)[1:-1])}</p>{_draw_images(fit)}"
        f"<details><summary>fields</summary>{table}</details></div>"
    )


def _draw_images(fit: Fit) -> str:
    """Return SVG of some shapes as the camera sees them; "" for a fit of no image."""
    rows = evenly(len(fit), MAX_DRAWN_IMAGES)
    if not len(rows):
        return ""
    edges = edges_of_fit(fit)
    drawn = [_draw_shape(fit, int(row), edges) for row in rows]
    images = "".join(
        f'<g transform="translate({place * DRAWING_SIDE})">{drawing}</g>'
        for place, drawing in enumerate(drawn)
    )
    size = f'width="{DRAWING_SIDE * len(rows)}" height="{DRAWING_SIDE}"'
    return f'<svg {size} fill="currentColor" role="img">{images}</svg>'


def edges_of_fit(fit: Fit) -> list[tuple[int, int]]:
    """Return the edges between the landmarks of a fit, as pairs of their indices."""
    if fit.lines is None:
        return [*edges_of(fit.landmark_names)]
    return [(int(a), int(b)) for a, b in fit.lines]


def _draw_shape(fit: Fit, row: int, edges: list[tuple[int, int]]) -> str:
    """Return the shape of one image as a group of SVG, pale where it is not trusted."""
    title = f"<title>{escape(fit.items[row])}</title>"
    places = _fit_in_square(fit.shapes[row, :, :2], up=fit.y_axis == "up")
    if places is None:
        return f"<g>{title}</g>"
    known: Flags = np.asarray(np.isfinite(places).all(axis=1))
    lines = "".join(
        f"M{places[a, 0]:.1f},{places[a, 1]:.1f}L{places[b, 0]:.1f},{places[b, 1]:.1f}"
        for a, b in edges
        if known[a] and known[b]
    )
    dots = "".join(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2"/>' for x, y in places[known]
    )
    is_doubtful = fit.trusted is not None and not fit.trusted[row]
    opacity = f' opacity="{DOUBTFUL_OPACITY}"' if is_doubtful else ""
    path = f'<path d="{lines}" stroke="currentColor" stroke-width="2" fill="none"/>'
    return f"<g{opacity}>{path}{dots}{title}</g>"


def _fit_in_square(points: Floats, *, up: bool) -> Floats | None:
    """Scale points (p, 2) into a square of DRAWING_SIDE pixels; None if all are NaN."""
    if not np.isfinite(points).any():
        return None
    flat = points * (1, -1 if up else 1)
    low = np.nanmin(flat, axis=0)
    high = np.nanmax(flat, axis=0)
    extent = float((high - low).max()) or 1.0
    pixels_per_unit = (1 - 2 * DRAWING_MARGIN) * DRAWING_SIDE / extent
    scaled: Floats = (flat - (low + high) / 2) * pixels_per_unit
    return scaled + DRAWING_SIDE / 2


def plot(fit: Fit, image: int | str, ax: Axes3D | None) -> Axes3D:
    """Draw the shape of one image with its edges, and error bars where it has any."""
    fit = fit.named()
    row = _row_of(fit, image)
    if ax is None:
        ax = _new_axes()
    away = 1.0 if fit.y_axis == "down" else -1.0
    x, y, z = fit.shapes[row].T
    for a, b in edges_of_fit(fit):
        ends = [a, b]
        ax.plot(x[ends], away * z[ends], y[ends], color="0.3")
    ax.scatter(x, away * z, y, s=12)
    for bar in _error_bars(fit, row):
        bar_x, bar_y, bar_z = bar.T
        ax.plot(bar_x, away * bar_z, bar_y, color="C0", linewidth=0.8)
    if (fit.y_axis == "down") != ax.zaxis_inverted():
        ax.invert_zaxis()
    ax.set(title=fit.items[row], xlabel="x", ylabel="depth", zlabel="y")
    ax.locator_params(nbins=MAX_TICKS)
    ax.set_aspect("equal")
    return ax


MAX_TICKS = 4
"""Ticks on an axis of a plot, at most."""


def _row_of(fit: Fit, image: int | str) -> int:
    """Return the row of an image that is given by number or name. Raises InputError."""
    if isinstance(image, int) and -len(fit) <= image < len(fit):
        return image
    if isinstance(image, str) and image in fit.items:
        return fit.items.index(image)
    known = listed([*fit.items[:3], "..."] if len(fit) > 3 else fit.items or ["none"])
    fix = f"give a number below {len(fit)}, or a name: {known}"
    raise input_error("plot.image", f"there is no image {image!r}", fix)


def _new_axes() -> Axes3D:
    """Return new axes in 3D. Raises InputError where matplotlib is not installed."""
    try:
        from matplotlib import pyplot
    except ImportError as error:
        fix = "run `pip install matplotlib`"
        raise input_error("plot", "matplotlib is not installed", fix) from error
    return pyplot.figure().add_subplot(projection="3d")


def _error_bars(fit: Fit, row: int) -> Iterator[Floats]:
    """Yield three error bars for each landmark, as ends (2, 3) one sd to both sides."""
    if fit.shape_sd is None:
        return
    for point, deviations in zip(fit.shapes[row], fit.shape_sd[row], strict=True):
        for along in np.diag(deviations):
            yield np.stack([point - along, point + along])


def view(fit: Fit, output: File | None, *, open: bool) -> Page:
    """Return the page of a fit; save it as `output` if given, show it if `open`.

    It is shown in a browser. Raises InputError for `open` without an `output`.
    """
    from shapefit.pipelines.view.run import write_page

    with TemporaryDirectory() as folder:
        result = Path(folder) / "fit.h5"
        page = Path(folder) / "fit.html"
        with result_writer(result) as writer:
            writer.append(fit.named())
        files = {"fit": [str(result)]}
        config = load_config("view", arguments={"files": files, "output": str(page)})
        for _ in write_page(config):
            pass
        shown = Page(page.read_text(encoding="utf-8"))
        if output is not None:
            shown = shown.save(output)
    if open:
        _open_in_browser(shown)
    return shown


def _open_in_browser(page: Page) -> None:
    """Show a page in a browser. Raises InputError where it is not saved."""
    import webbrowser

    if page.path is None:
        fix = "name the file to write: view('walk.html', open=True)"
        raise input_error("view.open", "a browser shows a file", fix)
    webbrowser.open(page.path.resolve().as_uri())
