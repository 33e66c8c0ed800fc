"""Datasets of a result file that an evaluation asks for by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.evaluation.metric_table import Dataset
from shapefit.io.layout import RESULTS
from shapefit.io.records import ResultSet

FIELDS = {dataset.name: dataset.attribute for dataset in RESULTS.datasets}


def find_dataset(file: Path, results: ResultSet, wanted: Dataset) -> NDArray[Any] | None:
    """Return a dataset that a metric takes, in the paper's orientation; None if it is absent.

    Raises InputError where the dataset has another shape than the metric expects.
    """
    if wanted.name in FIELDS:
        known: NDArray[Any] | None = getattr(results, FIELDS[wanted.name])
        return known
    data = results.extras.get(wanted.name)
    if data is None:
        return None
    p = len(results.landmark_names)
    expected = (len(results), *(p if size == "p" else size for size in wanted.shape))
    if data.shape != expected:
        found = f"has the shape {data.shape}"
        raise input_error(f"{file}:/{wanted.name}", found, f"its shape must be {expected}")
    if wanted.labels:
        return np.asarray(data, dtype=np.bool_)
    numbers = np.asarray(data, dtype=np.float64)
    # Carried datasets come as they stand in the file, one landmark per row.
    return np.swapaxes(numbers, -1, -2) if wanted.points else numbers
