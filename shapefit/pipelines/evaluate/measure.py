"""Results of one method compared with the truth: matching, the errors, the error bars,
failures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.config import EvalConfig
from shapefit.errors import InputError, abbreviate, input_error, listed
from shapefit.evaluation import metrics as m
from shapefit.evaluation.calibration import ErrorBars, find_squares
from shapefit.evaluation.metrics import (
    METRICS,
    MIN_COMMON_LANDMARKS,
    in_blocks,
    similarity,
)
from shapefit.evaluation.report import ALL, NORMALISED, Quantity
from shapefit.geometry.procrustes import similarity_transform
from shapefit.geometry.rotations import rotation_angle
from shapefit.io.layout import RESULTS, UNKNOWN_UNIT
from shapefit.io.names import check_numbering, match_landmarks, pairs_of_sides
from shapefit.pipelines.items import (
    BY_FRAME,
    BY_ITEM,
    find_truth,
    keys_of,
    named_items,
    subsample,
)
from shapefit.records import Fit, Items, Shapes
from shapefit.records.columns import Array, columns_of, in_columns

FOR_ALL = ("true_rotation", "rotation", "shape_correlation", "bounding_box")
"""Datasets that are taken beside those that metrics need."""
OF_JOINTS = {
    column.name for column in columns_of(Fit) if {"p", "r"} & {*column.axes}
} - {"shapes", "landmark_names"} | {"corrupted"}
"""Datasets with an axis of the joints, which results have for these but not for the
input.
"""
MIRRORED = 0.75
"""Of the error, below which the error against the mirrored truth means a left-handed
truth.
"""
FAR = 30.0
"""Factor between the sizes of shapes in one unit from which on it is in doubt: children
and adults differ by less.
"""
FRAMES_DIFFER = 45.0
"""Degrees by which rotations are off more than twice as much as the shapes themselves.
"""
SAMPLE = 500
"""Images by which a mirrored truth, and one in another frame, are recognised."""

Indices = NDArray[np.intp]
Arrays = Mapping[str, Any]


class Measured(NamedTuple):
    """Errors of the n images of the results of one method.

    items and sequences (n), "" where the sequence is unknown; errors maps a metric and
    unit to (n,), nan where an image failed, infinite where it does not count, as in
    precision where nothing was labelled; failures maps the failed items to the reason;
    bars says how the truth lies in the error bars, where the method has them; objective
    (n) where the file has it.
    """

    items: tuple[str, ...]
    sequences: tuple[str, ...]
    errors: Mapping[Quantity, Floats]
    failures: Mapping[str, str]
    warnings: tuple[str, ...]
    bars: ErrorBars | None
    objective: Floats | None


def measure(file: Path, results: Fit, truth: Shapes, config: EvalConfig) -> Measured:
    """Measure every image of results in the metrics that their datasets allow.

    Images and true shapes are matched by `match` (by frame where no item is the same),
    landmarks by name. Of several individuals that match the same true shapes the one
    with the least error is measured. Raises InputError where no image or too few
    landmarks match, and where no metric can be measured.
    """
    results = _with_observed(file, results, config.least_visible)
    _check_filled(file, results, truth, config.least_visible)
    pairs = _pair(file, results, truth, config.match)
    data = _find_datasets(file, pairs, config)
    with np.errstate(all="ignore"):  # overflow is not an error to report
        metrics, frames = _comparable(config.metrics, data)
        doubts = [
            *_find_sides(pairs.estimate, pairs.true, pairs.names),
            *frames,
            *_find_units(pairs, truth.unit),
        ]
        scale = in_blocks(m.truth_scale, pairs.estimate, pairs.true)
        units = truth.unit, pairs.results.unit
        errors, lacking = _errors(file, metrics, data, scale, *units)
        bars, without_bars = _find_bars(pairs, data, scale, truth.unit)
    common = in_blocks(m.visible_in_both, pairs.estimate, pairs.true)
    failures = _mark_failed(pairs, common, errors)
    notes = (*pairs.notes, *doubts, *lacking, *without_bars)
    return Measured(
        items=tuple(pairs.results.items),
        sequences=_sequences_of(pairs, truth),
        errors=errors,
        failures=failures,
        warnings=tuple(f"{file}: {text}" for text in notes),
        bars=bars,
        objective=pairs.results.objective,
    )


class Pairs(NamedTuple):
    """n images of results, each with its true shape.

    rows (n,) of the truth, -1 for none; names (p,) of the landmarks that both have;
    estimate and true (n, 3, p), nan where there is none; notes are warnings.
    """

    results: Fit
    rows: Indices
    names: tuple[str, ...]
    estimate: Floats
    true: Floats
    notes: tuple[str, ...]


def _with_observed(file: Path, results: Fit, least: int) -> Fit:
    """Return the results of images in which so many landmarks were observed."""
    if not least:
        return results
    observed = find_dataset(file, results, "landmarks")
    if observed is None:
        return results.take(slice(0))
    count = m.visible_in_both(observed, observed).sum(axis=-1)
    return results.take(np.flatnonzero(count >= least))


def _check_filled(file: Path, results: Fit, truth: Shapes, least: int) -> None:
    """Raise InputError where there are no results or no truth."""
    fault = "holds no shapes"
    if least:
        fault += f" with {least} observed `landmarks`"
    if not len(results):
        raise input_error(file, fault, "give results, and the truth of the same")
    if not len(truth):
        raise input_error("truth", fault, "give results, and the truth of the same")


def _pair(file: Path, results: Fit, truth: Shapes, match: str) -> Pairs:
    """Match images and true shapes, and their landmarks by name. Raises InputError
    where no image, or too few landmarks, match.
    """
    rows, by_frame = match_truth(file, results, truth, match)
    names = _common_landmarks(file, results.landmark_names, truth.landmark_names)
    # `take` gives them in the order of the core, an index gives them landmark by
    # landmark.
    columns = match_landmarks(results.landmark_names, names)
    estimate = results.as_columns().take(columns, axis=2)
    matching = match_landmarks(truth.landmark_names, names)
    true = truth.as_columns()[rows].take(matching, 2)
    true[rows < 0] = np.nan
    notes = [
        *check_numbering(
            results.landmark_names, truth.landmark_names, str(file), "the truth"
        )
    ]
    for side, records in (("results", results), ("truth", truth)):
        if alone := [name for name in records.landmark_names if name not in set(names)]:
            notes.append(
                f"landmarks in the {side} alone are left out: {abbreviate(alone)}"
            )
    if not by_frame or results.sequences is None:
        return Pairs(results, rows, names, estimate, true, tuple(notes))
    retained, others = _one_individual(results.sequences, rows, estimate, true)
    return Pairs(
        results=results.take(retained),
        rows=rows[retained],
        names=names,
        estimate=estimate[retained],
        true=true[retained],
        notes=(*notes, *others),
    )


def _find_datasets(file: Path, pairs: Pairs, config: EvalConfig) -> dict[str, Any]:
    """Return what the metrics take, None for what the results lack."""
    data: dict[str, Any] = {"estimate": pairs.estimate, "truth": pairs.true}
    needed = {*FOR_ALL, *chain(*(METRICS[metric].needs for metric in config.metrics))}
    for name in needed - data.keys():
        data[name] = find_dataset(file, pairs.results, name)
    if config.truth_frame == "camera":
        data["true_rotation"] = np.tile(np.eye(3), (len(pairs.results), 1, 1))
    return data


def _find_bars(
    pairs: Pairs, data: Arrays, scale: Floats, unit: str
) -> tuple[ErrorBars | None, list[str]]:
    """Return how the truth lies in the error bars, None where it cannot be compared;
    and a warning of that.
    """
    results, rotation = pairs.results, data["true_rotation"]
    if results.shape_sd is None:
        return None, []
    if rotation is None:
        text = "the error bars are not compared, without `true_rotation` or"
        return None, [f"{text} `truth_frame`"]
    columns = match_landmarks(results.landmark_names, pairs.names)
    deviation = in_columns(results.shape_sd).take(columns, axis=2)
    correlation = data["shape_correlation"]
    if correlation is not None:
        correlation = correlation.take(columns, axis=2)
    square, width = in_blocks(
        find_squares, pairs.estimate, pairs.true, rotation, deviation, correlation
    )
    widths = {NORMALISED: width / scale[:, None], unit: width}
    return ErrorBars(square, widths), []


def _mark_failed(
    pairs: Pairs, common: Flags, errors: Mapping[Quantity, Floats]
) -> dict[str, str]:
    """Return why images without one or more errors have none, and mark these in the
    errors: nan where an image failed, infinite where an optional metric does not count.
    """
    for values in errors.values():
        values[~common.any(axis=-1)] = np.nan
    failures = _failures(pairs.results, pairs.rows, common, errors)
    lifted = np.array([item not in failures for item in pairs.results.items], np.bool_)
    for (metric, _), values in errors.items():
        if METRICS[metric].optional:
            values[np.isnan(values) & lifted] = np.inf
    return failures


def _sequences_of(pairs: Pairs, truth: Shapes) -> tuple[str, ...]:
    """Return the sequence of each image, by the truth where the results have none."""
    if pairs.results.sequences is not None:
        return tuple(name or ALL for name in pairs.results.sequences)
    if truth.sequences is None:
        return (ALL,) * len(pairs.rows)
    of_truth = [name or ALL for name in truth.sequences]
    return tuple("" if row < 0 else of_truth[row] for row in pairs.rows.tolist())


def match_truth(
    file: Path, results: Items, truth: Shapes, match: str
) -> tuple[Indices, bool]:
    """Return the true shape (n,) of each image, -1 for none, and whether it is by
    frame.

    By frame where that is chosen, or where results of other tools, which have no
    status, share no item with the truth.
    """
    keys, true_keys = keys_of([results]), keys_of([truth])
    if match not in (BY_ITEM, BY_FRAME):
        keys = keys._replace(items=named_items(results, match, file, "match"))
    if match != BY_FRAME:
        try:
            return find_truth(file, match, keys, true_keys), False
        except InputError:
            if match != BY_ITEM or results.column("status") is not None:
                raise
    return find_truth(file, BY_FRAME, keys, true_keys), True


def _common_landmarks(
    file: Path, names: Sequence[str], true: Sequence[str]
) -> tuple[str, ...]:
    """Return the landmarks that the truth has too. Raises InputError where they are too
    few.
    """
    common = tuple(name for name in names if name in set(true))
    if len(common) < MIN_COMMON_LANDMARKS:
        fault = f"the truth has {len(common)} of its landmarks ({abbreviate(names)})"
        fix = (
            f"at least {MIN_COMMON_LANDMARKS} must have the names that they have in the"
            " truth"
        )
        raise input_error(file, fault, f"{fix} ({abbreviate(true)})")
    return common


def _one_individual(
    sequences: Sequence[str], rows: Indices, estimate: Floats, true: Floats
) -> tuple[Indices, list[str]]:
    """Return the images whose true shape no sequence with a smaller median error has; a
    warning.
    """
    omitted, names = np.zeros(len(rows), np.bool_), np.array(sequences, str)
    taken = np.array([], np.intp)
    if len(np.unique(rows[rows >= 0])) < (rows >= 0).sum():
        error = in_blocks(similarity, estimate, true)
        medians = {
            name: np.nanmedian([np.inf, *error[names == name]])
            for name in np.unique(names)
        }
        for name in sorted(medians, key=medians.__getitem__):
            omitted |= (names == name) & np.isin(rows, taken)
            taken = np.union1d(taken, rows[(names == name) & (rows >= 0)])
    who = abbreviate(np.unique(names[omitted]).tolist())
    text = f"{who} left out: another individual fits the same true shapes better"
    return np.flatnonzero(~omitted), [text] if omitted.any() else []


def find_dataset(file: Path, results: Fit, name: str) -> Any:
    """Return a dataset that a metric takes, in the paper's orientation; None if it is
    absent.

    Raises InputError where it has another shape than the metric needs.
    """
    data = results.column(name)
    if data is None and name == "landmarks_fitted" and results.scale is not None:
        # Without a camera the landmarks fitted are x and y of the shapes.
        if results.focal is not None:
            return None
        return results.as_columns()[:, :2]
    if data is None:
        return None
    if name in m.CARRIED:
        _check_carried(file, results, name, data)
        data = np.asarray(data, dtype=np.float64)
    listed = RESULTS.columns.get(name)
    if listed is not None and listed.has_points:
        return in_columns(np.asarray(data, dtype=np.float64))
    return data


def _check_carried(file: Path, results: Fit, name: str, data: Array) -> None:
    """Raise InputError for a dataset of another shape than a metric needs."""
    p = len(results.landmark_names)
    expected = (len(results), *(p if size == "p" else size for size in m.CARRIED[name]))
    if data.shape != expected or data.dtype.kind not in "biuf":
        fault = f"has the shape {data.shape} of {data.dtype}"
        raise input_error(
            f"{file}:/{name}", fault, f"give numbers of the shape {expected}"
        )


def _find_sides(estimate: Floats, truth: Floats, names: Sequence[str]) -> list[str]:
    """Say where shapes (n, 3, p) fit the truth much better with the names of left and
    right exchanged, or else mirrored.
    """
    some = list(subsample(SAMPLE, len(estimate)))
    e, x = estimate[some], truth[some]
    exchanged = np.arange(len(names))
    for left, right in pairs_of_sides(names):
        exchanged[[left, right]] = right, left

    def median_error(true: Floats) -> float:
        return float(np.median(np.nan_to_num(similarity(e, true), nan=np.inf)))

    error = median_error(x)
    mirrored = median_error(x * [[-1.0], [1.0], [1.0]])
    other = median_error(x[..., exchanged])
    if not min(mirrored, other) < MIRRORED * error < np.inf:
        return []
    if other <= mirrored:
        text = "the shapes fit the truth better when left and right are exchanged"
        fix = "are the names of the sides right? Exchange them by `rename`"
        return [f"{text} ({other:.3g} for {error:.3g}); {fix}"]
    text = "the shapes fit the truth better when it is mirrored"
    fix = "is it left-handed? Change the sign of one of its axes"
    return [f"{text} ({mirrored:.3g} for {error:.3g}); {fix}"]


def _find_units(pairs: Pairs, true_unit: str) -> list[str]:
    """Say where shapes in the same unit differ in size by far: one unit is not stated
    right.

    Results in pixels may state how many metres these are.
    """
    unit = pairs.results.unit
    metres = pairs.results.metres_per_unit
    estimate, true = pairs.estimate, pairs.true
    if metres is not None and true_unit == "m":
        unit = "m"
        estimate = estimate * np.reshape(metres, (-1, 1, 1))
    if unit != true_unit or unit in ("px", UNKNOWN_UNIT, NORMALISED):
        return []
    seen: Flags = np.asarray(np.isfinite(estimate + true).all(axis=1, keepdims=True))
    sizes = [
        np.nanstd(np.where(seen, points, np.nan), axis=2).mean(axis=1)
        for points in (true, estimate)
    ]
    ratio = float(np.nanmedian(sizes[0] / sizes[1]))
    if not (ratio > FAR or 0 < ratio < 1 / FAR):
        return []
    times = f"{ratio:,.0f} times" if ratio > 1 else f"1 / {1 / ratio:,.0f} of"
    text = f"the truth is {times} the size of the results, and both state {unit}"
    return [f"{text}: one of them has another unit, and errors in {unit} are wrong"]


def _comparable(
    metrics: Sequence[str], data: Mapping[str, Any]
) -> tuple[Sequence[str], list[str]]:
    """Return the metrics without `rotation` where dictionary and truth have different
    frames.

    Then shapes fit the truth with a small rotation, and their stated rotations are far
    from the true ones. And say so.
    """
    some = list(subsample(SAMPLE, len(data["estimate"])))
    names = ("estimate", "truth", "true_rotation", "rotation")
    e, x, R, stated = (
        data[name] if data[name] is None else data[name][some] for name in names
    )
    notes: list[str] = []
    if R is None or stated is None:
        return metrics, notes
    whole = np.isfinite(np.concatenate([e, x, R, stated], axis=2)).all(axis=(1, 2))
    if "rotation" in metrics and whole.any():
        turn = similarity_transform(e[whole], R[whole] @ x[whole]).rotation
        shapes = float(np.median(rotation_angle(turn, np.eye(3))))
        angle = float(np.median(rotation_angle(R[whole], stated[whole])))
        if angle > 2 * shapes + FRAMES_DIFFER:
            metrics = [metric for metric in metrics if metric != "rotation"]
            text = (
                f"no rotation: off by {angle:.0f} degrees, and the shapes by"
                f" {shapes:.0f}"
            )
            notes.append(f"{text}: dictionary and truth have different frames")
    return metrics, notes


def _errors(
    file: Path,
    metrics: Sequence[str],
    data: Arrays,
    scale: Floats,
    unit: str,
    image_unit: str,
) -> tuple[dict[Quantity, Floats], list[str]]:
    """Errors (n,) in each metric and unit, and a warning about metrics that lack a
    dataset.

    scale (n,) as `truth_scale` has it; unit is that of the truth. Raises InputError
    where all metrics lack something.
    """
    errors: dict[Quantity, Floats] = {}
    lacking: dict[str, list[str]] = {}
    for name in metrics:
        metric = METRICS[name]
        if absent := [
            f"`{dataset}`" for dataset in metric.needs if data[dataset] is None
        ]:
            lacking |= {name: absent} if name != "expected" else {}
            continue
        error: Floats = in_blocks(
            metric.function, *(data[dataset] for dataset in metric.needs)
        )
        by_unit = {metric.unit: error}
        if metric.unit == m.LENGTH:  # once, where the unit of the truth is `normalised`
            by_unit = {NORMALISED: error, unit: error} | {NORMALISED: error / scale}
        elif metric.unit == m.IMAGE_LENGTH:
            box = m.box_diagonal(data["landmarks"], data["bounding_box"])
            by_unit = {image_unit: error, "box": error / box}
        for of_unit, values in by_unit.items():
            errors[name, of_unit] = np.where(np.isfinite(values), values, np.nan)
    absent = [*dict.fromkeys(chain(*lacking.values()))]
    text = (
        f"no {listed(lacking, 'and')} without {listed(absent, 'and')}"
        if lacking
        else ""
    )
    if not errors:
        raise input_error(
            file, text, "add the metric `similarity`, which needs only shapes"
        )
    return errors, [text] if lacking else []


def _failures(
    results: Fit, rows: Indices, common: Flags, errors: Mapping[Quantity, Floats]
) -> dict[str, str]:
    """Why each image without one or more errors has none; rows (n,) of its true
    shape.
    """
    certain = {kind: v for kind, v in errors.items() if not METRICS[kind[0]].optional}
    failed = np.any([~common.any(axis=-1), *map(np.isnan, certain.values())], axis=0)
    reasons = {}
    for i in np.flatnonzero(failed).tolist():
        lost = [
            f"{name} ({unit})" for (name, unit), v in certain.items() if np.isnan(v[i])
        ]
        reason = (
            f"{common[i].sum()} landmarks are on both sides, and no {', '.join(lost)}"
        )
        if rows[i] < 0:
            reason = "it has no true shape"
        elif not np.isfinite(results.shapes[i]).any():
            status = "" if results.status is None else f" (status {results.status[i]})"
            reason = f"the results hold no shape{status}"
        reasons[results.items[i]] = reason
    return reasons


def with_shapes_of(results: Fit, names: Sequence[str]) -> Fit:
    """Return the result with its joints or with the input's landmarks, whichever fit
    the names.

    Where a fit lifted a detector's landmarks with a dictionary of joints, its result
    has both.
    """
    if results.input_landmark_names is None or results.input_shapes is None:
        return results
    detected = results.input_landmark_names
    if len(set(detected) & set(names)) <= len(set(results.landmark_names) & set(names)):
        return results
    return replace(
        results.without(OF_JOINTS),
        shapes=results.input_shapes,
        shape_sd=results.input_shape_sd,
        shape_correlation=results.input_shape_correlation,
        landmark_names=detected,
    )
