"""Fits as tables: joints in metres, a data frame of pandas, a dataset of xarray."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from shapefit.api.messages import warn
from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.io.options import OutputOptions
from shapefit.io.writers.motion import find_motions, warnings_of
from shapefit.io.writers.tables import metres_columns
from shapefit.records import Fit
from shapefit.records.columns import Array, Singles, present_columns
from shapefit.timeline import JITTER

MAX_HEIGHT = 3.0
"""Of a body, in metres; more is another unit."""

if TYPE_CHECKING:
    import pandas
    import xarray

    from shapefit.geometry.cameras import Up


def to_metres(
    fit: Fit, *, height: float | None, unit: str | None, up: Up | None
) -> np.recarray[tuple[int], np.dtype[np.void]]:
    """Return the joints of a fit in metres, a row for each joint of each image."""
    if height is not None and not _is_height(height):
        fault = f"{height!r} is not the height of a body in metres"
        fix = f"give a number above 0, up to {MAX_HEIGHT:g}"
        raise input_error("Fit.to_metres.height", fault, fix)
    options = OutputOptions(height=height, unit=unit, up=up)
    motions = find_motions(fit.named(), options, "Fit.to_metres")
    warn(warnings_of(motions))
    parts: list[Mapping[str, Array]] = []
    for motion in motions:
        columns = metres_columns(motion)
        count = len(columns["x"])
        trusted = columns["trusted"] == "true"
        sequence = np.full(count, motion.name)
        parts.append({**columns, "trusted": trusted, "sequence": sequence})
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    kinds = [(name, array.dtype) for name, array in arrays.items()]
    return np.rec.fromarrays([*arrays.values()], dtype=kinds)


def _is_height(height: float) -> bool:
    """Whether a value is the height of a body in metres, as `convert` takes it."""
    is_number = isinstance(height, int | float | np.integer | np.floating)
    return is_number and 0 < height <= MAX_HEIGHT


def to_pandas(fit: Fit) -> pandas.DataFrame:
    """Return a DataFrame of a fit, a row for each landmark of each image."""
    import pandas

    fit = fit.named()
    n, p = fit.shapes.shape[:2]
    columns: dict[str, Array] = {
        "item": np.repeat(np.array(fit.items, dtype=object), p),
        "landmark": np.tile(np.array(fit.landmark_names, dtype=object), n),
    }
    for axis, values in zip("xyz", fit.shapes.reshape(n * p, 3).T, strict=True):
        columns[axis] = values
    if fit.shape_sd is not None:
        deviations = fit.shape_sd.reshape(n * p, 3).T
        for axis, values in zip("xyz", deviations, strict=True):
            columns[f"sd_{axis}"] = values
    sequences = None if fit.sequences is None else np.array(fit.sequences, dtype=object)
    per_image = {
        "frame": fit.frames,
        "time": _image_times(fit),
        "sequence": sequences,
        "trusted": fit.trusted,
        "reasons": fit.reasons,
    }
    for name, of_image in per_image.items():
        if of_image is not None:
            columns[name] = np.repeat(of_image, p)
    table = pandas.DataFrame(columns)
    table.attrs.update(_attributes(fit))
    return table


def _image_times(fit: Fit) -> Floats | None:
    """Return the times (n,) of images in seconds, or as frames without a frame rate.

    Stated times count where frames disagree; None where neither is known.
    """
    if fit.frames is None:
        return fit.times
    rate = fit.frame_rate or 1.0
    times: Floats = fit.frames / rate
    if fit.times is None:
        return times
    is_off = np.abs(fit.times - times) * rate > JITTER
    return np.where(is_off, fit.times, times)


def _attributes(fit: Fit) -> dict[str, str | float]:
    """Return the attributes of a table: unit, direction of y, and frame rate."""
    attributes: dict[str, str | float] = {"unit": fit.unit, "y_axis": fit.y_axis}
    if fit.frame_rate is not None:
        attributes["frame_rate"] = fit.frame_rate
    return attributes


DIMENSIONS: Mapping[tuple[str | int, ...], tuple[str, ...]] = {
    ("n",): ("item",),
    ("n", "p"): ("item", "landmark"),
    ("n", "p", 2): ("item", "landmark", "plane"),
    ("n", "p", 3): ("item", "landmark", "space"),
}
"""Names of the axes of columns that a dataset of xarray has."""


def to_xarray(fit: Fit) -> xarray.Dataset:
    """Return a dataset of the columns of a fit that belong to items and landmarks."""
    import xarray

    fit = fit.named()
    variables: dict[str, tuple[tuple[str, ...], Array]] = {}
    for column, values in present_columns(fit):
        # correlations have three numbers, and none of them is along an axis of space
        if column.axes not in DIMENSIONS or column.kind == Singles:
            continue
        if column.field != "items":
            plain = np.asarray(values, str if column.is_text else None)
            variables[column.name] = (DIMENSIONS[column.axes], plain)
    coordinates = {
        "item": [*fit.items],
        "landmark": [*fit.landmark_names],
        "plane": ["x", "y"],
        "space": ["x", "y", "z"],
    }
    return xarray.Dataset(variables, coordinates, _attributes(fit))
