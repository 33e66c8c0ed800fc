"""One result file against the truth: which truth belongs to which image, and the errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.evaluation import metrics as measures
from shapefit.evaluation.report import NORMALISED
from shapefit.evaluation.summary import ALL
from shapefit.geometry.rotations import rotation_angle
from shapefit.io.records import ResultSet, ShapeSet, match_landmarks

Floats = NDArray[np.float64]
Kind = tuple[str, str]

BY_ITEM = "item"

NEEDS: Mapping[str, tuple[str, ...]] = {
    "similarity": (),
    "camera": ("true_rotation",),
    "rotation": ("true_rotation", "rotation"),
    "reprojection": ("landmarks", "landmarks_fitted"),
}
"""Datasets of the result file, besides the shapes, that each metric takes."""


@dataclass(frozen=True)
class Judgement:
    """Errors of the images of one result file.

    items and sequences (n), a sequence that nobody knows is empty; errors maps a metric and unit
    to (n,), nan where an image failed; failures maps the items without one or more of the errors
    to the reason; truth_rows (n) index the truth of each image, -1 where there is none.
    """

    file: Path
    items: tuple[str, ...]
    sequences: tuple[str, ...]
    errors: Mapping[Kind, Floats]
    failures: Mapping[str, str]
    warnings: tuple[str, ...]
    truth_rows: NDArray[np.intp]


def judge(
    file: Path, results: ResultSet, truth: ShapeSet, match: str, metrics: Sequence[str]
) -> Judgement:
    """Measure every image of a result file in the metrics that its datasets allow.

    `match` is "item", or the dataset of the results that names the true item of each image.
    Landmarks are matched by name; those that only one side has are left out. Raises InputError
    where no image or too few landmarks match, and where no metric can be measured.
    """
    keys = _truth_items(file, results, match)
    rows = _truth_rows(file, keys, truth)
    names, warnings = _common_landmarks(file, results, truth)
    estimate = results.shapes[:, :, match_landmarks(results.landmark_names, names)]
    true = truth.shapes[:, :, match_landmarks(truth.landmark_names, names)][rows]
    true[rows < 0] = np.nan

    errors: dict[Kind, Floats] = {}
    for metric in metrics:
        data = [find_dataset(file, results, need) for need in NEEDS[metric]]
        lacking = [need for need, d in zip(NEEDS[metric], data, strict=True) if d is None]
        if lacking:
            warnings.append(
                f"{file}: no {metric} error, the file has no {' and no '.join(lacking)}"
            )
            continue
        errors |= _measure(metric, estimate, true, data, (truth.unit, results.unit))
    if not errors:
        found = f"none of the metrics {', '.join(metrics)} can be measured"
        raise input_error(file, found, "add `similarity`, which needs nothing but shapes")

    judged = measures.visible_in_both(estimate, true)
    for values in errors.values():
        values[~judged.any(axis=-1)] = np.nan
    partial = int((judged.any(axis=-1) & ~judged.all(axis=-1)).sum())
    if partial:
        warnings.append(
            f"{file}: {partial} images lack some of the {len(names)} landmarks, there or in the "
            "truth; judged on the others"
        )
    return Judgement(
        file=file,
        items=results.items,
        sequences=_sequences(results, truth, rows),
        errors=errors,
        failures=_failures(results, keys, rows, judged, errors),
        warnings=tuple(warnings),
        truth_rows=rows,
    )


def _truth_items(file: Path, results: ResultSet, match: str) -> tuple[str, ...]:
    """Name of the true item of each image."""
    if not len(results):
        raise input_error(file, "holds no images", "check the run that wrote it")
    if match == BY_ITEM:
        return results.items
    named = results.extras.get(match)
    if named is None:
        others = ", ".join([BY_ITEM, *sorted(results.extras)])
        raise input_error(file, f"has no dataset '{match}'", f"set `match` to one of: {others}")
    if np.shape(named) != (len(results),):
        found = f"has the shape {np.shape(named)}"
        fix = f"`match` takes a dataset of {len(results)} items of the truth, one an image"
        raise input_error(f"{file}:/{match}", found, fix)
    return tuple(map(str, named))


def _truth_rows(file: Path, keys: Sequence[str], truth: ShapeSet) -> NDArray[np.intp]:
    """Index of the truth of each image, -1 where there is none."""
    index = {item: row for row, item in enumerate(truth.items)}
    rows = np.array([index.get(key, -1) for key in keys], dtype=np.intp)
    if (rows < 0).all():
        found = f"none of its {len(keys)} images is in the truth, which has no '{keys[0]}'"
        fix = f"give the truth of these images, or set `match` (an item: '{truth.items[0]}')"
        raise input_error(file, found, fix)
    return rows


def _common_landmarks(
    file: Path, results: ResultSet, truth: ShapeSet
) -> tuple[tuple[str, ...], list[str]]:
    """Landmarks that both sides have, and warnings about the others."""
    ours, theirs = results.landmark_names, truth.landmark_names
    common = tuple(name for name in ours if name in set(theirs))
    if len(common) < measures.FEWEST_LANDMARKS:
        found = f"the truth has {len(common)} of its landmarks ({abbreviate(ours)})"
        fix = (
            f"at least {measures.FEWEST_LANDMARKS} must have the names that they have in the "
            f"truth ({abbreviate(theirs)})"
        )
        raise input_error(file, found, fix)
    sides = {"results": ours, "truth": theirs}
    alone = {side: [n for n in names if n not in set(common)] for side, names in sides.items()}
    return common, [
        f"{file}: landmarks left out, only the {side} have them: {abbreviate(names)}"
        for side, names in alone.items()
        if names
    ]


def find_dataset(file: Path, results: ResultSet, name: str) -> NDArray[Any] | None:
    """Return a dataset that a metric needs, as (n, d, p) or (n, 3, 3); None if it is absent.

    Raises InputError where it has another shape than the metric takes.
    """
    if name == "rotation":
        return results.rotation
    if name == "landmarks_fitted":
        return results.landmarks_fitted
    data = results.extras.get(name)
    if data is None:
        return None
    shape = (3, 3) if name == "true_rotation" else (len(results.landmark_names), 2)
    expected = (len(results), *shape)
    if data.shape != expected:
        found = f"has the shape {data.shape}"
        raise input_error(f"{file}:/{name}", found, f"its shape must be {expected}")
    numbers = np.asarray(data, dtype=np.float64)
    # Carried datasets come as they stand in the file, one landmark a row.
    return numbers if name == "true_rotation" else np.swapaxes(numbers, -1, -2)


def _measure(
    metric: str,
    estimate: Floats,
    true: Floats,
    data: Sequence[Any],
    units: tuple[str, str],
) -> dict[Kind, Floats]:
    """Errors in one metric, in one unit or two.

    data are the datasets that `NEEDS` lists, units those of the truth and of the images.
    """
    if metric == "rotation":
        return {(metric, "deg"): rotation_angle(*data)}
    if metric == "reprojection":
        observed, fitted = data
        return {(metric, units[1]): measures.reprojection(fitted, observed)}
    measure = measures.camera if metric == "camera" else measures.similarity
    error = measure(estimate, true, *data)
    normalised = error / measures.truth_scale(estimate, true)
    return {(metric, NORMALISED): normalised} | (
        {} if units[0] == NORMALISED else {(metric, units[0]): error}
    )


def _sequences(results: ResultSet, truth: ShapeSet, rows: NDArray[np.intp]) -> tuple[str, ...]:
    """Sequence of each image: of the results, else of the truth, else one for all.

    One without a name is called `all` too; the empty text stands for an image without truth.
    """
    if results.sequences is not None:
        return tuple(sequence or ALL for sequence in results.sequences)
    if truth.sequences is not None:
        return tuple(truth.sequences[row] or ALL if row >= 0 else "" for row in rows)
    return (ALL,) * len(results)


def _failures(
    results: ResultSet,
    keys: Sequence[str],
    rows: NDArray[np.intp],
    judged: NDArray[np.bool_],
    errors: Mapping[Kind, Floats],
) -> dict[str, str]:
    """Why each image without one or more errors has none."""

    def reason(i: int) -> str:
        if rows[i] < 0:
            return f"the truth has no item '{keys[i]}'"
        if not np.isfinite(results.shapes[i]).any():
            status = "" if results.status is None else f" (status {results.status[i]})"
            return f"the results hold no shape{status}"
        if judged[i].sum() < measures.FEWEST_LANDMARKS:
            return f"only {judged[i].sum()} landmarks are known on both sides"
        kinds = [f"{kind[0]} ({kind[1]})" for kind, v in errors.items() if np.isnan(v[i])]
        return f"what {', '.join(kinds)} needs is nan, or true landmarks are all on one point"

    failed = np.isnan(list(errors.values())).any(axis=0)
    return {results.items[i]: reason(i) for i in np.flatnonzero(failed).tolist()}


def abbreviate(names: Sequence[str]) -> str:
    """Name the first five, and count the others."""
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
