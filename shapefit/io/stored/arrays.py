"""Fields of records as our own formats store them."""

from __future__ import annotations

from typing import Any

import numpy as np

from shapefit.io.extras import Array
from shapefit.io.layout import Dataset


def as_stored(dataset: Dataset, value: Any) -> Array:
    """Return a field of a record as it stands in a file: one point per row, texts as objects."""
    array = np.asarray(value, object) if dataset.kind == "text" else storable(np.asarray(value))
    array = array.astype(dataset.stored) if dataset.stored else array
    return array.swapaxes(-1, -2) if dataset.points else array


def storable(values: Array) -> Array:
    """Return texts as objects, numbers as they are."""
    return values.astype(object) if values.dtype.kind == "U" else values
