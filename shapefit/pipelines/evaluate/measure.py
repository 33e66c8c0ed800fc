"""One result file compared with the truth: matching, the errors, the error bars, what failed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.config import EvalConfig
from shapefit.errors import InputError, abbreviate, input_error, listed
from shapefit.evaluation import metrics as m
from shapefit.evaluation.calibration import ErrorBars, find_squares, join_bars
from shapefit.evaluation.metrics import FEWEST_LANDMARKS, METRICS, Dataset, in_blocks, similarity
from shapefit.evaluation.summaries import ALL, NORMALISED, Kind
from shapefit.geometry.procrustes import similarity_transform
from shapefit.geometry.rotations import rotation_angle
from shapefit.io.layout import INPUT_CORRELATION, INPUT_NAMES, INPUT_SD, INPUT_SHAPES, RESULTS
from shapefit.io.names import match_landmarks
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.pipelines import items

BOX_UNIT = "box"
"""Unit of distances in an image as shares of the diagonal of the object's box."""
WITH_JOINTS = ("landmarks", "confidence", "outliers", "corrupted", "shape_covariance")
"""Datasets with an axis of the joints, which results have for these but not for the input."""
MIRRORED = 0.75
"""Of the error, below which the error against the mirrored truth means a left-handed truth."""
FRAMES_DIFFER = 45.0
"""Degrees by which rotations are off more than twice as much as the shapes themselves."""
SAMPLE = 500
"""Images by which a mirrored truth, and one in another frame, are recognised."""

Indices = NDArray[np.intp]
Arrays = Mapping[Dataset, NDArray[Any] | None]


class Truth(NamedTuple):
    """The true shapes, and what images are matched with them by."""

    shapes: ShapeSet
    keys: items.Keys


@dataclass(frozen=True)
class Measured:
    """Errors of the n images of the results of one method.

    items and sequences (n), "" where the sequence is unknown; errors maps a metric and unit to
    (n,), nan where an image failed, infinite where it does not count, as in precision where nothing
    was labelled; failures maps the failed items to the reason; bars says how the truth lies in the
    error bars, where the method has them; objective (n) where the file has it.
    """

    files: tuple[Path, ...]
    items: tuple[str, ...]
    sequences: tuple[str, ...]
    errors: Mapping[Kind, Floats]
    failures: Mapping[str, str]
    warnings: tuple[str, ...]
    bars: ErrorBars | None
    objective: Floats | None


def join(files: Sequence[Measured]) -> Measured:
    """Return the files of one method as one; images do not count in metrics that a file lacks."""

    def all_of(name: str) -> tuple[Any, ...]:
        return tuple(each for file in files for each in getattr(file, name))

    def errors(kind: Kind) -> Floats:
        return np.concatenate([f.errors.get(kind, np.full(len(f.items), np.inf)) for f in files])

    objectives = [f.objective for f in files if f.objective is not None]
    return Measured(
        files=all_of("files"),
        items=all_of("items"),
        sequences=all_of("sequences"),
        errors={kind: errors(kind) for kind in dict.fromkeys(all_of("errors"))},
        failures={item: why for f in files for item, why in f.failures.items()},
        warnings=all_of("warnings"),
        bars=join_bars([f.bars for f in files], [len(f.items) for f in files]),
        objective=np.concatenate(objectives) if len(objectives) == len(files) else None,
    )


def measure(file: Path, results: ResultSet, truth: Truth, config: EvalConfig) -> Measured:
    """Measure every image of a result file in the metrics that its datasets allow.

    Images and true shapes are matched by `match` (by frame where no item is the same), landmarks by
    name; those on one side only are ignored. Of several individuals that match the same true shapes
    the one with the least error is measured. Raises InputError where no image or too few landmarks
    match, and where no metric can be measured.
    """
    if not len(results):
        raise input_error(file, "holds no images", "check the run that wrote it")
    results, omitted = _with_visible(file, results, config.least_visible)
    rows, wanted, by_frame = _match(file, results, truth, config.match)
    names = common_landmarks(file, results.landmark_names, truth.shapes.landmark_names)
    columns = match_landmarks(results.landmark_names, names)
    # `take` gives them in the order of the core, an index gives them landmark by landmark.
    estimate = results.shapes.take(columns, axis=2)
    true = truth.shapes.shapes[rows].take(match_landmarks(truth.shapes.landmark_names, names), 2)
    true[rows < 0] = np.nan
    notes: list[str] = []
    for side, records in (("results", results), ("truth", truth.shapes)):
        if alone := [name for name in records.landmark_names if name not in set(names)]:
            notes.append(f"landmarks in the {side} alone are left out: {abbreviate(alone)}")
    if by_frame and results.sequences is not None:
        retained, others = _one_individual(results.sequences, rows, estimate, true)
        notes += others
        results, rows = results.take(retained), rows[retained]
        estimate, true = estimate[retained], true[retained]
        wanted = [wanted[row] for row in retained.tolist()]
    rotation = np.tile(np.eye(3), (len(results), 1, 1))
    if config.truth_frame == "object":
        rotation = find_dataset(file, results, m.TRUE_ROTATION)  # type: ignore[assignment]
    arrays = {m.ESTIMATE: estimate, m.TRUTH: true, m.TRUE_ROTATION: rotation}
    common = in_blocks(m.visible_in_both, estimate, true)
    with np.errstate(all="ignore"):  # overflow is not an error to report
        scale = in_blocks(m.truth_scale, estimate, true)
    metrics, unclear = _meaningful(config.metrics, arrays, results.rotation)
    units = (truth.shapes.unit, results.unit)
    errors, skipped = _errors(file, results, metrics, arrays, scale, units)
    bars, unjudged = _error_bars(file, results, columns, arrays, scale, units[0])
    notes += [*skipped, *unclear, *unjudged]
    for values in errors.values():
        values[~common.any(axis=-1)] = np.nan
    failures = _failures(results, wanted, rows, common, errors)
    lifted = np.array([item not in failures for item in results.items], dtype=np.bool_)
    for (metric, _), values in errors.items():
        if METRICS[metric].may_lack:
            values[np.isnan(values) & lifted] = np.inf
    if partial := int((common.any(axis=-1) & ~common.all(axis=-1)).sum()):
        lack = f"{partial} images lack some of the {len(names)} landmarks, there or in the truth"
        notes.append(f"{lack}; judged on the others")
    sequences = results.sequences
    if sequences is None and truth.shapes.sequences is not None:
        known = truth.shapes.sequences
        sequences = tuple(known[row] or ALL if row >= 0 else "" for row in rows)
    elif sequences is not None:
        sequences = tuple(sequence or ALL for sequence in sequences)
    return Measured(
        files=(file,),
        items=results.items,
        sequences=sequences or (ALL,) * len(results),
        errors=errors,
        failures=failures,
        # Results of the same images have one warning of those left out together.
        warnings=(*omitted, *(f"{file}: {text}" for text in notes)),
        bars=bars,
        objective=results.objective,
    )


def _with_visible(file: Path, results: ResultSet, least: int) -> tuple[ResultSet, list[str]]:
    """Return the images with at least so many observed landmarks, and a warning about the others.

    Raises InputError where there is no such image.
    """
    if not least:
        return results, []
    observed = find_dataset(file, results, m.LANDMARKS)
    count = np.zeros(len(results), int)
    if observed is not None:
        count = m.visible_in_both(observed, observed).sum(axis=-1)
    enough = np.flatnonzero(count >= least)
    if not len(enough):
        found = f"none of its {len(count)} images has {least} observed `landmarks`"
        raise input_error(file, found, f"set `least_visible` to {count.max()} or less")
    few = len(count) - len(enough)
    text = f"{few} of {len(count)} images left out: fewer than {least} observed landmarks"
    return results.take(enough), [text] if few else []


def _match(
    file: Path, results: ResultSet, truth: Truth, match: str
) -> tuple[Indices, list[str], bool]:
    """Return the true shape (n,) of each image, -1 for none, its name (n,), and if by frame.

    By frame where that is asked for, or where results of other tools, which have no status, share
    no item with the truth.
    """
    if not len(truth.shapes):
        raise input_error("truth", "holds no shapes", f"give the truth of the images of {file}")
    keys = items.keys_of([results])
    if match not in (items.BY_ITEM, items.BY_FRAME):
        keys = replace(keys, items=items.named_items(results, match, file, "match"))
    if match != items.BY_FRAME:
        try:
            rows = items.find_truth(file, match, keys, truth.keys)
            return rows, [f"item '{item}'" for item in keys.items], False
        except InputError:
            if match != items.BY_ITEM or results.status is not None:
                raise
    rows = items.find_truth(file, items.BY_FRAME, keys, truth.keys)
    return rows, [f"frame '{frame}'" for frame in keys.by_frame()[1]], True


def _one_individual(
    sequences: Sequence[str], rows: Indices, estimate: Floats, true: Floats
) -> tuple[Indices, list[str]]:
    """Return the images whose true shape no sequence with a smaller median error has; a warning."""
    left, names = np.zeros(len(rows), np.bool_), np.array(sequences, str)
    taken = np.array([], np.intp)
    if len(np.unique(rows[rows >= 0])) < (rows >= 0).sum():
        error = in_blocks(similarity, estimate, true)
        medians = {name: np.nanmedian([np.inf, *error[names == name]]) for name in np.unique(names)}
        for name in sorted(medians, key=medians.__getitem__):
            left |= (names == name) & np.isin(rows, taken)
            taken = np.union1d(taken, rows[(names == name) & (rows >= 0)])
    who = abbreviate(np.unique(names[left]).tolist())
    text = f"{who} left out: another individual fits the same true shapes better"
    return np.flatnonzero(~left), [text] if left.any() else []


def common_landmarks(file: Path, own: Sequence[str], true: Sequence[str]) -> tuple[str, ...]:
    """Return the landmarks of a file that the truth has too, in the order of the file.

    Raises InputError where these are fewer than three.
    """
    common = tuple(name for name in own if name in set(true))
    if len(common) < FEWEST_LANDMARKS:
        found = f"the truth has {len(common)} of its landmarks ({abbreviate(own)})"
        fix = f"at least {FEWEST_LANDMARKS} must have the names that they have in the truth"
        raise input_error(file, found, f"{fix} ({abbreviate(true)})")
    return common


def find_dataset(file: Path, results: ResultSet, wanted: Dataset) -> NDArray[Any] | None:
    """Return a dataset that a metric takes, in the paper's orientation; None if it is absent.

    Raises InputError where the dataset has another shape than the metric expects.
    """
    data = results.columns.get(wanted.name)
    if data is None and wanted is m.FITTED and results.scale is not None:
        # Without a camera the landmarks fitted are x and y of the shapes.
        return None if "focal" in results.columns else results.shapes[:, :2]
    if data is None or wanted.name in RESULTS.datasets:
        return data
    p = len(results.landmark_names)
    expected = (len(results), *(p if size == "p" else size for size in wanted.shape))
    if data.shape != expected or data.dtype.kind not in "biuf":
        found = f"has the shape {data.shape} of {data.dtype}"
        raise input_error(f"{file}:/{wanted.name}", found, f"give numbers of the shape {expected}")
    if wanted.labels:
        return np.asarray(data, dtype=np.bool_)
    numbers = np.asarray(data, dtype=np.float64)
    # Carried datasets come as they are in the file, one landmark per row.
    return np.swapaxes(numbers, 1, 2) if numbers.ndim == 3 and wanted.shape[0] == "p" else numbers


def _meaningful(
    metrics: Sequence[str], arrays: Arrays, stated: Floats | None
) -> tuple[tuple[str, ...], list[str]]:
    """Return the metrics without `rotation` where it means nothing, and what is wrong.

    Shapes that fit the truth with a small rotation, while their stated rotations (n, 3, 3) are far
    from the true ones, come from a dictionary with another frame than the truth.
    """
    estimate: Any = arrays[m.ESTIMATE]
    some = list(items.subsample(SAMPLE, len(estimate)))
    every = (estimate, arrays[m.TRUTH], arrays[m.TRUE_ROTATION], stated)
    e, x, R, S = (None if array is None else array[some] for array in every)
    assert e is not None
    assert x is not None
    reasons: list[str] = []
    with np.errstate(all="ignore"):
        error, mirrored = (
            float(np.median(np.nan_to_num(similarity(e, x * [[sign], [1.0], [1.0]]), nan=np.inf)))
            for sign in (1.0, -1.0)
        )
    if mirrored < MIRRORED * error < np.inf:
        reasons.append(
            f"the shapes fit the truth better when it is mirrored ({mirrored:.3g} for {error:.3g})"
            "; is it left-handed? Change the sign of one of its axes"
        )
    if "rotation" not in metrics or R is None or S is None:
        return tuple(metrics), reasons
    whole = np.isfinite(np.concatenate([e, x, R, S], axis=2)).all(axis=(1, 2))
    whole &= (np.abs(S) < 2).all(axis=(1, 2))  # entries are at most 1
    if whole.any():
        turn = similarity_transform(e[whole], R[whole] @ x[whole]).rotation
        shapes = float(np.median(rotation_angle(turn, np.eye(3))))
        angle = float(np.median(rotation_angle(R[whole], S[whole])))
        if angle > 2 * shapes + FRAMES_DIFFER:
            reasons.append(
                f"no rotation: those of the results are {angle:.0f} degrees off and their shapes "
                f"{shapes:.0f}, so that dictionary and truth have different frames"
            )
            metrics = [metric for metric in metrics if metric != "rotation"]
    return tuple(metrics), reasons


def _errors(
    file: Path,
    results: ResultSet,
    metrics: Sequence[str],
    arrays: Arrays,
    scale: Floats,
    units: tuple[str, str],
) -> tuple[dict[Kind, Floats], list[str]]:
    """Errors (n,) in each metric and unit, and warnings about metrics that lack a dataset.

    arrays holds the shapes and the true rotation; scale (n,) as `truth_scale` has it; units are
    those of the truth and of the images. Raises InputError where all metrics lack something.
    """
    errors: dict[Kind, Floats] = {}
    skipped: dict[str, str] = {}
    for name in metrics:
        metric = METRICS[name]
        needs = [*metric.needs, *((m.LANDMARKS, m.BOX) if metric.unit == m.IMAGE else ())]
        data = {d: arrays[d] if d in arrays else find_dataset(file, results, d) for d in needs}
        lacking = [f"`{d.name}`" for d in metric.needs if data[d] is None]
        if lacking:
            if not metric.optional:
                skipped[name] = f"no {name} without the dataset {' and '.join(lacking)}"
            continue
        with np.errstate(all="ignore"):
            error: Floats = in_blocks(metric.function, *(data[d] for d in metric.needs))
            by_unit = {metric.unit: error}
            if metric.unit == m.LENGTH:  # once, where the unit of the truth is `normalised`
                by_unit = {NORMALISED: error, units[0]: error} | {NORMALISED: error / scale}
            elif metric.unit == m.IMAGE:
                box = m.box_diagonal(data[m.LANDMARKS], data[m.BOX])  # type: ignore[arg-type]
                by_unit = {units[1]: error, BOX_UNIT: error / box}
        for unit, values in by_unit.items():
            errors[name, unit] = np.where(np.isfinite(values), values, np.nan)
    if not errors:
        fix = "add the metric `similarity`, which needs only shapes"
        raise input_error(file, "; ".join(skipped.values()), fix)
    if len(skipped) > 1 and results.rotation is None and results.landmarks_fitted is None:
        return errors, [f"holds shapes alone: no {listed(skipped, 'and')}"]  # as TRC and tables do
    return errors, list(skipped.values())


def _error_bars(
    file: Path,
    results: ResultSet,
    columns: Indices,
    arrays: Arrays,
    scale: Floats,
    unit: str,
) -> tuple[ErrorBars | None, list[str]]:
    """Return how the truth lies in the error bars of the landmarks `columns`, None without any.

    And a warning where there are some, but no rotation of the truth to the camera.
    """
    deviation = find_dataset(file, results, m.DEVIATION)
    if deviation is None:
        return None, []
    if arrays[m.TRUE_ROTATION] is None:
        lacking = f"without the dataset `{m.TRUE_ROTATION.name}` or a `truth_frame`"
        return None, [f"the error bars are not judged, {lacking}"]
    correlation = find_dataset(file, results, m.CORRELATION)
    with np.errstate(all="ignore"):
        square, width = in_blocks(
            find_squares,
            *(arrays[m.ESTIMATE], arrays[m.TRUTH], arrays[m.TRUE_ROTATION]),
            deviation.take(columns, axis=2),
            None if correlation is None else correlation.take(columns, axis=2),
        )
        return ErrorBars(square, {NORMALISED: width / scale[:, None], unit: width}), []


def _failures(
    results: ResultSet,
    wanted: Sequence[str],
    rows: Indices,
    common: Flags,
    errors: Mapping[Kind, Floats],
) -> dict[str, str]:
    """Why each image without one or more errors has none.

    wanted (n), what it is matched by; rows (n,) of its true shape; common (n, p) landmarks.
    """
    certain = {kind: v for kind, v in errors.items() if not METRICS[kind[0]].may_lack}

    def reason(i: int) -> str:
        if rows[i] < 0:
            return f"the truth has no {wanted[i]}"
        if not np.isfinite(results.shapes[i]).any():
            status = "" if results.status is None else f" (status {results.status[i]})"
            return f"the results hold no shape{status}"
        if common[i].sum() < FEWEST_LANDMARKS:
            return f"only {common[i].sum()} landmarks are known on both sides"
        lost = [f"{metric} ({unit})" for (metric, unit), v in certain.items() if np.isnan(v[i])]
        return f"a value needed for {', '.join(lost)} is nan, or all landmarks are at one point"

    failed = ~common.any(axis=-1)
    for values in certain.values():
        failed |= np.isnan(values)
    return {results.items[i]: reason(i) for i in np.flatnonzero(failed).tolist()}


def with_shapes_of(results: ResultSet, names: Sequence[str]) -> ResultSet:
    """Return the result with its joints or with the input's landmarks, whichever fit the names.

    Where a fit lifted a detector's landmarks with a dictionary of joints, its result has both.
    """
    columns = results.columns
    if INPUT_NAMES not in columns or INPUT_SHAPES not in columns:
        return results
    own = tuple(map(str, columns[INPUT_NAMES]))
    if len(set(own) & set(names)) <= len(set(results.landmark_names) & set(names)):
        return results
    sd, correlation = results.per_item.get(INPUT_SD), results.per_item.get(INPUT_CORRELATION)
    without = (*WITH_JOINTS, m.CORRELATION.name, "landmarks_fitted", "dual")
    shown = results.without(without).replaced(
        shapes=np.swapaxes(columns[INPUT_SHAPES], 1, 2),
        shape_sd=None if sd is None else np.swapaxes(sd, 1, 2),
        landmark_names=own,
    )
    return shown if correlation is None else shown.with_columns({m.CORRELATION.name: correlation})
