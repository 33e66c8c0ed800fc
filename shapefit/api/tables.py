"""A fit as tables: joints in metres, and a table of pandas."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from shapefit.io.options import OutputOptions
from shapefit.io.writers.motion import find_motions
from shapefit.io.writers.tables import metres_columns
from shapefit.pipelines.result import Note

if TYPE_CHECKING:
    from shapefit.api.records import Fit
    from shapefit.geometry.cameras import Up


def to_metres(
    fit: Fit,
    *,
    height: float | None = None,
    unit: str | None = None,
    up: Up | None = None,
) -> np.recarray[Any, Any]:
    """Return joints in metres: a row per frame and landmark, as `convert -o x.metres.csv` writes.

    Columns: frame, time (s, or frames without a frame rate), landmark, x, y, z, sd of the distance
    to the point, trusted, sequence; nan in gaps. height of the body in metres, by default that of
    the fit; unit and up as of `convert`. Raises InputError where nothing says how large the shapes
    are.
    """
    height = stated_height(fit) if height is None else height
    options = OutputOptions(height=height, unit=unit, up=up)
    motions = find_motions(fit.record(), options, "Fit.to_metres")
    warn(dict.fromkeys(text for motion in motions for text in motion.warnings))
    parts = []
    for motion in motions:
        columns = metres_columns(motion)
        columns["trusted"] = [answer == "true" for answer in columns["trusted"]]
        parts.append(columns | {"sequence": [motion.name] * len(columns["x"])})
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    kinds = [(name, array.dtype) for name, array in arrays.items()]
    return np.rec.fromarrays([*arrays.values()], dtype=kinds)


def stated_height(fit: Fit) -> float | None:
    """Return the height in metres that a fit was given."""
    height: float | None = json.loads(str(fit.attributes.get("config", "{}"))).get("height")
    return height


def to_pandas(fit: Fit) -> Any:
    """Return a pandas.DataFrame with a row per landmark and image: item, landmark, x, y, z, more.

    time is in s where the frame rate is known, else in frames.
    """
    import pandas  # type: ignore[import-untyped]

    n, p = len(fit), fit.shapes.shape[1]
    columns: dict[str, Any] = {
        "item": np.repeat(np.array(fit.items, dtype=object), p),
        "landmark": np.tile(np.array(fit.landmark_names, dtype=object), n),
    }
    columns |= dict(zip("xyz", fit.shapes.reshape(n * p, 3).T, strict=True))
    if fit.shape_sd is not None:
        deviations = fit.shape_sd.reshape(n * p, 3).T
        columns |= dict(zip(("sd_x", "sd_y", "sd_z"), deviations, strict=True))
    frames = fit.extras.get("frame")
    per_image = {
        "frame": frames,
        "time": None if frames is None else np.asarray(frames) / (fit.frame_rate or 1),
        "sequence": fit.sequences,
        "trusted": fit.trusted,
        "reasons": fit.reasons,
    }
    columns |= {name: np.repeat(v, p) for name, v in per_image.items() if v is not None}
    return pandas.DataFrame(columns)


def warn(messages: Iterable[object], level: int = 3) -> None:
    """Issue a Python warning for each message, at the caller of the function; notes are none."""
    for message in messages:
        if not isinstance(message, Note):
            warnings.warn(str(message), stacklevel=level)
