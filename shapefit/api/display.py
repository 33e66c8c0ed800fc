"""A fit as people look at it and export it: a line, a page, a picture, tables of other libraries.

What draws or tabulates is imported when it is called.
"""

from __future__ import annotations

import json
import tempfile
import warnings
from collections.abc import Iterable
from html import escape
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import counted, input_error
from shapefit.io.options import OutputOptions
from shapefit.io.skeletons import edges_of
from shapefit.io.writers.motion import find_motions
from shapefit.io.writers.tables import METRES, metres_columns
from shapefit.pipelines.outcome import Note

if TYPE_CHECKING:
    from shapefit.api.records import Fit
    from shapefit.geometry.cameras import Up
    from shapefit.io.records import ResultSet

HEIGHT = 640
"""Of a page in a notebook, in px."""
SIDE = (30, 15)
"""Degrees around and above the shape that a picture is seen from."""


def warn(messages: Iterable[object], level: int = 3) -> None:
    """Issue a Python warning for each message, at the caller of the function; notes are none."""
    for message in messages:
        if not isinstance(message, Note):
            warnings.warn(str(message), stacklevel=level)


def describe(fit: Fit) -> str:
    """Return a fit in one line."""
    parts = [counted(len(fit), "image"), counted(fit.shapes.shape[1], "landmark")]
    if "method" in fit.attributes:
        parts.append(f"method {fit.attributes['method']}")
    if fit.failures:
        parts.append(f"{len(fit.failures)} failed")
    if fit.trusted is not None:
        parts.append(f"{int(np.sum(fit.trusted))} trusted")
    return f"<shapefit.Fit: {', '.join(parts)}, in {fit.unit}>"


def write_page(result: ResultSet, path: Path) -> None:
    """Write the page that `shapefit view` makes of a result."""
    from shapefit.config import load_config
    from shapefit.io import result_writer
    from shapefit.pipelines.view.run import run

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "fit.h5"
        with result_writer(file) as writer:
            writer.append(result)
            writer.attributes.update(result.attributes)
        given = {"files": (str(file),), "output": str(path)}
        for _ in run(load_config("view", None, (), given)):  # type: ignore[arg-type]
            pass


def embedded_page(fit: Fit) -> str:
    """Return the page of a fit within an element of HTML, for notebooks."""
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        write_page(fit.record(), page)
        text = page.read_text(encoding="utf-8")
    style = f"width: 100%; height: {HEIGHT}px; border: 0"
    return f'<iframe sandbox="allow-scripts" style="{style}" srcdoc="{escape(text)}"></iframe>'


def open_page(fit: Fit, path: str | PathLike[str] | None = None) -> Path:
    """Write the page of the shapes, by default to a temporary file, open it; return its path."""
    import webbrowser

    page = Path(tempfile.mkdtemp()) / "fit.html" if path is None else Path(path)
    write_page(fit.record(), page)
    webbrowser.open(page.resolve().as_uri())
    return page


def draw_shape(fit: Fit, image: int = 0) -> Any:
    """Draw the shape of an image in 3D with matplotlib: bones, error bars; return the axes."""
    from shapefit.meshes.pictures import FittedImage, Model, View, draw_solid

    pyplot = _library("matplotlib.pyplot")
    axes = pyplot.figure(figsize=(5, 5)).add_axes((0, 0, 1, 0.93), projection="3d")
    record = fit.record()
    shape, sd = record.shapes[image], None if record.shape_sd is None else record.shape_sd[image]
    drawn = FittedImage(record.items[image], shape[:2], shape, shape[:2], sd=sd)
    axes.set_title(drawn.title, parse_math=False)
    if drawn.fitted:
        edges = edges_of(record.landmark_names) if record.lines is None else record.lines
        draw_solid(axes, drawn, Model(record.y_axis, edges=np.array(edges, int)), View(*SIDE))
    return axes


def as_metres(
    fit: Fit,
    *,
    height: float | None = None,
    unit: str | None = None,
    up: Up | None = None,
) -> np.recarray[Any, Any]:
    """Return joints in metres: a row per frame and landmark, as `convert -o x.metres.csv` writes.

    Columns: frame, time (s, or frames without a frame rate), landmark, x, y, z, sd of the distance
    to the point, trusted, sequence; nan in gaps. height of the body in metres, by default that of
    the fit; unit and up as of `convert`. Raises InputError where nothing says how large
    the shapes are.
    """
    height = stated_height(fit) if height is None else height
    options = OutputOptions(height=height, unit=unit, up=up)
    motions = find_motions(fit.record(), options, "Fit.to_metres")
    warn(dict.fromkeys(text for each in motions for text in each.warnings))
    parts = []
    for motion in motions:
        columns = metres_columns(motion)
        columns["trusted"] = [answer == "true" for answer in columns["trusted"]]
        parts.append([*columns.values(), [motion.name] * len(columns["x"])])
    arrays = [np.concatenate(column) for column in zip(*parts, strict=True)]
    kinds = [(name, a.dtype) for name, a in zip([*METRES, "sequence"], arrays, strict=True)]
    return np.rec.fromarrays(arrays, dtype=kinds)


def stated_height(fit: Fit) -> float | None:
    """Return the height in metres that a fit was given."""
    height: float | None = json.loads(str(fit.attributes.get("config", "{}"))).get("height")
    return height


def as_table(fit: Fit) -> Any:
    """Return a pandas.DataFrame with a row per landmark and image: item, x, y, z, more.

    time is in s where the frame rate is known, else in frames.
    """
    n, p = len(fit), fit.shapes.shape[1]
    columns: dict[str, Any] = {
        "item": np.repeat(np.array(fit.items, dtype=object), p),
        "landmark": np.tile(np.array(fit.landmark_names, dtype=object), n),
    }
    columns |= dict(zip("xyz", fit.shapes.reshape(n * p, 3).T, strict=True))
    if fit.shape_sd is not None:
        names = ("sd_x", "sd_y", "sd_z")
        columns |= dict(zip(names, fit.shape_sd.reshape(n * p, 3).T, strict=True))
    frames = _frames(fit)
    of_images: dict[str, Any] = {"frame": frames, "time": frames / (fit.frame_rate or 1)}
    of_images |= {"sequence": fit.sequences, "trusted": fit.trusted, "reasons": fit.reasons}
    columns |= {name: np.repeat(v, p) for name, v in of_images.items() if v is not None}
    return _library("pandas").DataFrame(columns)


def _frames(fit: Fit) -> NDArray[np.int64]:
    """Return the frame of each image (n,): its dataset, or its number within its sequence."""
    if "frame" in fit.extras:
        return np.asarray(fit.extras["frame"], np.int64)
    names = np.array(fit.sequences or ("",) * len(fit))
    frames = np.zeros(len(fit), np.int64)
    for name in np.unique(names):
        frames[names == name] = np.arange((names == name).sum())
    return frames


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        fix = f"run `pip install {package}`"
        raise input_error("Fit", f"{package} is not installed", fix) from None
