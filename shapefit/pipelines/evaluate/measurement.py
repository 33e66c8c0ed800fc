"""From the datasets of a result to its errors in one metric, in its unit or two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import input_error
from shapefit.evaluation.averages import in_blocks
from shapefit.evaluation.metric_table import (
    BOX,
    CORRELATION,
    ESTIMATE,
    IMAGE,
    LANDMARKS,
    LENGTH,
    METRICS,
    TRUTH,
    Dataset,
)
from shapefit.evaluation.metrics import box_diagonal, visible_in_both
from shapefit.evaluation.report import NORMALISED
from shapefit.io.layout import RESULTS
from shapefit.io.records import ResultSet
from shapefit.pipelines.joints import (
    INPUT_CORRELATION,
    INPUT_NAMES,
    INPUT_SD,
    INPUT_SHAPES,
)

LEAST_VISIBLE = "least_visible"

FIELDS = {dataset.name: dataset.attribute for dataset in RESULTS.datasets}


def find_dataset(file: Path, results: ResultSet, wanted: Dataset) -> NDArray[Any] | None:
    """Return a dataset that a metric takes, in the paper's orientation; None if it is absent.

    Raises InputError where the dataset has another shape than the metric expects.
    """
    if wanted.name in FIELDS:
        known: NDArray[Any] | None = getattr(results, FIELDS[wanted.name])
        return known
    data = results.columns.get(wanted.name)
    if data is None:
        return None
    p = len(results.landmark_names)
    expected = (len(results), *(p if size == "p" else size for size in wanted.shape))
    if data.shape != expected:
        found = f"has the shape {data.shape}"
        raise input_error(f"{file}:/{wanted.name}", found, f"its shape must be {expected}")
    if wanted.labels:
        return np.asarray(data, dtype=np.bool_)
    if data.dtype.kind not in "biuf":
        raise input_error(f"{file}:/{wanted.name}", f"holds {data.dtype}", "it must hold numbers")
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


OF_JOINTS = ("landmarks", "confidence", "outliers", "corrupted", "shape_covariance")
"""Datasets with an axis of the joints, which the landmarks of the files have no part in."""


def as_named(results: ResultSet, names: Sequence[str]) -> ResultSet:
    """Return the result with the shapes of the landmarks that more of the names are of.

    Where a fit lifted a detector's landmarks with a dictionary of joints, its result has both.
    """
    extras = results.columns
    if INPUT_NAMES not in extras or INPUT_SHAPES not in extras:
        return results
    own = tuple(map(str, extras[INPUT_NAMES]))
    if len(set(own) & set(names)) <= len(set(results.landmark_names) & set(names)):
        return results
    per_item = {name: v for name, v in results.further.items() if name not in OF_JOINTS}
    per_item.pop(CORRELATION.name, None)
    if INPUT_CORRELATION in extras:
        per_item[CORRELATION.name] = extras[INPUT_CORRELATION]
    sd = results.per_item(INPUT_SD)
    return results.replaced(
        shapes=np.swapaxes(extras[INPUT_SHAPES], 1, 2),
        shape_sd=None if sd is None else np.swapaxes(sd, 1, 2),
        landmark_names=own,
        landmarks_fitted=None,
        dual=None,
        columns=per_item,
        of_file=results.of_file,
    )


Kind = tuple[str, str]
"""A metric and its unit."""

OF_THE_BOX = "box"
"""Unit of distances in an image as shares of the diagonal of the object's box."""


def datasets_of(metric: str) -> tuple[Dataset, ...]:
    """Return all datasets of a result file that a metric can take; those in an image also a box."""
    known = METRICS[metric]
    return (*known.datasets, *((LANDMARKS, BOX) if known.unit == IMAGE else ()))


def measure(
    metric: str,
    estimate: Floats,
    true: Floats,
    scale: Floats,
    data: Mapping[Dataset, NDArray[Any] | None],
    units: tuple[str, str],
) -> dict[Kind, Floats]:
    """Errors (n,) in one metric, in one unit or two.

    estimate and true (n, 3, p), scale (n,) as `truth_scale` has it; data holds the datasets of the
    metric, all that it needs; units are those of the truth and of the images.
    """
    known = METRICS[metric]
    arrays = {**data, ESTIMATE: estimate, TRUTH: true}
    error: Floats = in_blocks(known.load(), *(arrays[dataset] for dataset in known.needs))
    if known.unit == LENGTH:
        return in_both_units(metric, error, scale, units[0])
    if known.unit != IMAGE:
        return {(metric, known.unit): error}
    boxed = error / _diagonal(arrays[BOX], arrays[LANDMARKS])
    return {(metric, units[1]): error, (metric, OF_THE_BOX): boxed}


def in_both_units(metric: str, error: Floats, scale: Floats, unit: str) -> dict[Kind, Floats]:
    """Return an error in the unit of the truth both as a share of the scale and as it is.

    A truth whose own unit is `normalised` is given once.
    """
    return {(metric, NORMALISED): error / scale} | (
        {} if unit == NORMALISED else {(metric, unit): error}
    )


def _diagonal(boxes: NDArray[Any] | None, observed: NDArray[Any] | None) -> Floats:
    """Diagonal (n,) of the given boxes (n, 4), x y w h, else of those of the observed landmarks.

    nan where it is 0 or unknown.
    """
    if boxes is None:
        assert observed is not None  # a metric in an image takes them
        return box_diagonal(observed)
    diagonal = np.hypot(boxes[:, 2], boxes[:, 3])
    return np.where(diagonal > 0, diagonal, np.nan)
