"""Datasets of a result file that an evaluation asks for by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io.extras import LABELS
from shapefit.io.records import ResultSet


def find_dataset(file: Path, results: ResultSet, name: str) -> NDArray[Any] | None:
    """Return a dataset that a metric takes, in the paper's orientation; None if it is absent.

    Points (n, 2, p), rotations (n, 3, 3), boxes (n, 4) or labels (n, p), which are booleans.
    Raises InputError where the dataset has another shape than that.
    """
    if name == "rotation":
        return results.rotation
    if name == "landmarks_fitted":
        return results.landmarks_fitted
    data = results.extras.get(name)
    if data is None:
        return None
    expected = (len(results), *_shape(name, len(results.landmark_names)))
    if data.shape != expected:
        found = f"has the shape {data.shape}"
        raise input_error(f"{file}:/{name}", found, f"its shape must be {expected}")
    if name in LABELS:
        return np.asarray(data, dtype=np.bool_)
    numbers = np.asarray(data, dtype=np.float64)
    # Carried datasets come as they stand in the file, one landmark a row.
    return np.swapaxes(numbers, -1, -2) if name == "landmarks" else numbers


def _shape(name: str, p: int) -> tuple[int, ...]:
    """Shape, within one image, of a dataset as it stands in the file."""
    if name in LABELS:
        return (p,)
    return {"true_rotation": (3, 3), "bounding_box": (4,), "landmarks": (p, 2)}[name]
