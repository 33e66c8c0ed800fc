"""A fit as people look at it and hand it on: a line, a page, a picture, tables of other libraries.

What draws or tabulates is imported when it is called.
"""

from __future__ import annotations

import tempfile
from html import escape
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from shapefit.errors import counted, input_error

if TYPE_CHECKING:
    from shapefit.api.records import Fit
    from shapefit.io.records import ResultSet

HEIGHT = 640
"""Of a page in a notebook, in px."""


def describe(fit: Fit) -> str:
    """Return a fit in one line."""
    parts = [counted(len(fit), "image"), counted(len(fit.landmark_names), "landmark")]
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


def embedded_page(result: ResultSet) -> str:
    """Return the page of a result within an element of HTML, for notebooks."""
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "page.html"
        write_page(result, page)
        text = page.read_text(encoding="utf-8")
    style = f"width: 100%; height: {HEIGHT}px; border: 0"
    return f'<iframe sandbox="allow-scripts" style="{style}" srcdoc="{escape(text)}"></iframe>'


def open_page(result: ResultSet, path: str | PathLike[str] | None) -> Path:
    """Write the page of a result, by default to a temporary file, and open it in a browser."""
    import webbrowser

    page = Path(tempfile.mkdtemp()) / "fit.html" if path is None else Path(path)
    write_page(result, page)
    webbrowser.open(page.resolve().as_uri())
    return page


def draw_shape(fit: Fit, image: int) -> Any:
    """Draw the landmarks of one shape in 3D, upright, with lines of one deviation in depth."""
    pyplot = _library("matplotlib.pyplot")
    x, y, z = fit.shapes[image].T
    up = -y if fit.y_axis == "down" else y
    axes = pyplot.figure().add_subplot(projection="3d")
    axes.scatter(x, z, up)
    for name, *place in zip(fit.landmark_names, x, z, up, strict=True):
        axes.text(*place, f" {name}", fontsize=7)
    if fit.shape_sd is not None:
        for a, b, c, sd in zip(x, z, up, fit.shape_sd[image, :, 2], strict=True):
            axes.plot([a, a], [b - sd, b + sd], [c, c], color="0.7", linewidth=1)
    axes.set(xlabel="x", ylabel="depth", zlabel="up", title=fit.items[image], aspect="equal")
    return axes


def as_table(fit: Fit) -> Any:
    """Return a pandas.DataFrame with a row per landmark and image."""
    n, p = len(fit), len(fit.landmark_names)
    columns: dict[str, Any] = {
        "item": np.repeat(np.array(fit.items, dtype=object), p),
        "landmark": np.tile(np.array(fit.landmark_names, dtype=object), n),
    }
    columns |= dict(zip("xyz", fit.shapes.reshape(n * p, 3).T, strict=True))
    if fit.shape_sd is not None:
        names = ("sd_x", "sd_y", "sd_z")
        columns |= dict(zip(names, fit.shape_sd.reshape(n * p, 3).T, strict=True))
    of_images = {"sequence": fit.sequences, "trusted": fit.trusted, "doubt": fit.doubt}
    columns |= {name: np.repeat(v, p) for name, v in of_images.items() if v is not None}
    return _library("pandas").DataFrame(columns)


def as_dataset(fit: Fit) -> Any:
    """Return an xarray.Dataset of `position` (time, space, keypoints, individuals).

    Individuals are the sequences; time is in s where the frame rate is known, else in frames.
    """
    n = len(fit)
    names = fit.sequences if fit.sequences is not None else ("",) * n
    who, which = np.unique(np.array(names, dtype=str), return_inverse=True)
    frames = np.asarray(fit.extras.get("frame", np.zeros(n)), dtype=np.int64)
    if "frame" not in fit.extras:
        for individual in range(len(who)):
            frames[which == individual] = np.arange((which == individual).sum())
    times, at = np.unique(frames, return_inverse=True)
    position = np.full((len(times), 3, len(fit.landmark_names), len(who)), np.nan)
    position[at, :, :, which] = fit.shapes.swapaxes(1, 2)
    return _library("xarray").Dataset(
        {"position": (("time", "space", "keypoints", "individuals"), position)},
        coords={
            "time": times / (fit.frame_rate or 1),
            "space": ["x", "y", "z"],
            "keypoints": list(fit.landmark_names),
            "individuals": list(who),
        },
        attrs={"unit": fit.unit, "y_axis": fit.y_axis, "fps": fit.frame_rate or "unknown"},
    )


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        fix = f"run `pip install {package}`"
        raise input_error("Fit", f"{package} is not installed", fix) from None
