"""Datasets of a result file that an evaluation asks for, and the images that they let it judge."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.evaluation.metric_table import LANDMARKS, Dataset
from shapefit.evaluation.metrics import visible_in_both
from shapefit.io.layout import RESULTS
from shapefit.io.records import ResultSet

LEAST_VISIBLE = "least_visible"

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


def visible_enough(file: Path, results: ResultSet, least: int) -> tuple[ResultSet, tuple[str, ...]]:
    """Return the images with at least so many observed landmarks, and a warning about the others.

    Raises InputError where the file has no observed landmarks, or no such image.
    """
    if not least:
        return results, ()
    observed = find_dataset(file, results, LANDMARKS)
    if observed is None:
        fix = f"fit to a file that ends in .h5, or leave out `{LEAST_VISIBLE}`"
        raise input_error(
            file, f"has no dataset 'landmarks', which `{LEAST_VISIBLE}` counts in", fix
        )
    count = visible_in_both(observed, observed).sum(axis=-1)
    enough = count >= least
    if not enough.any():
        found = f"none of its {len(results)} images has {least} observed landmarks"
        fix = f"set `{LEAST_VISIBLE}` to {max(count, default=0)} or less"
        raise input_error(file, found, fix)
    if enough.all():
        return results, ()
    # Without the name of the file: results of the same images have one warning together.
    warning = (
        f"{(~enough).sum()} of {len(results)} images left out: fewer than {least} observed "
        "landmarks"
    )
    return results.take(np.flatnonzero(enough)), (warning,)
