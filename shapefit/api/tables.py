"""Fits as tables: joints in metres, and a data frame of pandas."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from shapefit.api.messages import warn
from shapefit.io.options import OutputOptions
from shapefit.io.writers.motion import find_motions
from shapefit.io.writers.tables import metres_columns
from shapefit.records import Fit
from shapefit.timeline import JITTER

if TYPE_CHECKING:
    from shapefit.geometry.cameras import Up


def to_metres(
    fit: Fit, *, height: float | None, unit: str | None, up: Up | None
) -> np.recarray[Any, Any]:
    """Return the joints of a fit in metres, a row for each joint of each image."""
    options = OutputOptions(height=height, unit=unit, up=up)
    motions = find_motions(fit.named(), options, "Fit.to_metres")
    texts = dict.fromkeys(text for motion in motions for text in motion.warnings)
    warn(texts, LEVEL)
    parts = []
    for motion in motions:
        columns = metres_columns(motion)
        columns["trusted"] = [answer == "true" for answer in columns["trusted"]]
        parts.append(columns | {"sequence": [motion.name] * len(columns["x"])})
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    kinds = [(name, array.dtype) for name, array in arrays.items()]
    return np.rec.fromarrays([*arrays.values()], dtype=kinds)


LEVEL = 4
"""Calls between a warning and the user: `warn`, `to_metres` here, and that of Fit."""


def to_pandas(fit: Fit) -> Any:
    """Return a DataFrame of a fit, a row for each landmark of each image."""
    import pandas  # type: ignore[import-untyped]

    fit = fit.named()
    n, p = fit.shapes.shape[:2]
    columns: dict[str, Any] = {
        "item": np.repeat(np.array(fit.items, dtype=object), p),
        "landmark": np.tile(np.array(fit.landmark_names, dtype=object), n),
    }
    for axis, values in zip("xyz", fit.shapes.reshape(n * p, 3).T, strict=True):
        columns[axis] = values
    if fit.shape_sd is not None:
        deviations = fit.shape_sd.reshape(n * p, 3).T
        for axis, values in zip("xyz", deviations, strict=True):
            columns[f"sd_{axis}"] = values
    times = fit.times
    if fit.frames is not None:
        rate = fit.frame_rate or 1.0
        times = fit.frames / rate
        if fit.times is not None:
            off = np.abs(fit.times - times) * rate > JITTER
            times = np.where(off, fit.times, times)
    per_image = {
        "frame": fit.frames,
        "time": times,
        "sequence": fit.sequences,
        "trusted": fit.trusted,
        "reasons": fit.reasons,
    }
    for name, of_image in per_image.items():
        if of_image is not None:
            columns[name] = np.repeat(of_image, p)
    return pandas.DataFrame(columns)
