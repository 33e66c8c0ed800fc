"""One result file beside the truth: which shape belongs to which image, the errors, what failed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.config import EvalConfig
from shapefit.convex.solver import Status
from shapefit.errors import InputError, abbreviate, input_error, listed
from shapefit.evaluation.calibration import ErrorBars, find_squares, join_bars
from shapefit.evaluation.metric_table import (
    BOX,
    CORRELATION,
    DEVIATION,
    ESTIMATE,
    FITTED,
    IMAGE,
    LANDMARKS,
    LENGTH,
    METRICS,
    ROTATION,
    TRUE_ROTATION,
    TRUTH,
    Dataset,
)
from shapefit.evaluation.metrics import (
    FEWEST_LANDMARKS,
    box_diagonal,
    in_blocks,
    similarity,
    truth_scale,
    visible_in_both,
)
from shapefit.evaluation.report import Run
from shapefit.evaluation.summaries import ALL, NORMALISED, ImageErrors, Kind, labels_of
from shapefit.geometry.normalisation import centroid
from shapefit.geometry.procrustes import coincide, similarity_transform
from shapefit.geometry.rotations import rotation_angle
from shapefit.io.layout import INPUT_CORRELATION, INPUT_NAMES, INPUT_SD, INPUT_SHAPES, RESULTS
from shapefit.io.names import match_landmarks
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.pipelines.items import (
    BY_FRAME,
    BY_ITEM,
    Keys,
    find_truth,
    keys_of,
    named_items,
    spread,
)

OF_THE_BOX = "box"
"""Unit of distances in an image as shares of the diagonal of the object's box."""

OF_JOINTS = ("landmarks", "confidence", "outliers", "corrupted", "shape_covariance")
"""Datasets with an axis of the joints, which the landmarks of the files have no part in."""

SOLVED = (Status.OPTIMAL.value, Status.CONVERGED.value)
"""Words of the images that the method finished within its tolerance."""


class Truth:
    """True shapes, found by their keys: head, all but the shapes; take(rows) reads some."""

    def __init__(
        self, head: ShapeSet, keys: Keys, take: Callable[[NDArray[np.intp]], ShapeSet]
    ) -> None:
        self.head = head
        self._keys = keys
        self._take = take

    def __len__(self) -> int:
        return len(self._keys.items)

    def find(self, file: Path, match: str, own: Keys) -> tuple[ShapeSet, NDArray[np.intp]]:
        """Return shapes, and the row among them of each image, -1 where there is none.

        Raises InputError where none has one; `file` has the images that they belong to.
        """
        if not len(self):
            fix = f"give the truth of the images of {file}"
            raise input_error("truth", "holds no shapes", fix)
        rows = find_truth(file, match, own, self._keys)
        unique, places = np.unique(rows, return_inverse=True)
        unknown = int(unique[0] < 0)
        return self._take(unique[unknown:]), places.reshape(-1) - unknown


@dataclass(frozen=True)
class Judged:
    """Errors of the n images of one result file.

    items and sequences (n), a sequence that nobody knows is empty; errors maps a metric and unit
    to (n,), nan where an image failed, infinite where it does not count, as in precision and recall
    where there is nothing to judge; failures
    maps the failed items to the reason; bars says how the truth lies in the error bars, where the
    method has them; run is what the file says of the fit.
    """

    file: Path
    items: tuple[str, ...]
    sequences: tuple[str, ...]
    errors: Mapping[Kind, Floats]
    failures: Mapping[str, str]
    warnings: tuple[str, ...]
    bars: ErrorBars | None
    run: Run

    def image_errors(self, method: str) -> list[ImageErrors]:
        """Return the errors in each metric and unit, of the images that count in it."""
        found, sequences = [], labels_of(self.sequences)
        for kind, values in self.errors.items():
            whole = ImageErrors(method, *kind, self.items, sequences, values)
            counts = ~np.isinf(values)
            if counts.any():
                found.append(whole if counts.all() else whole.take(np.flatnonzero(counts)))
        return found


def join(files: Sequence[Judged]) -> Judged:
    """Return the files of one method as one; images do not count in metrics that a file lacks."""

    def joined(arrays: Iterable[Floats | None], missing: float) -> Floats:
        pairs = zip(files, arrays, strict=True)
        return np.concatenate(
            [np.full(len(one.items), missing) if own is None else own for one, own in pairs]
        )

    bars = [one.bars for one in files if one.bars is not None]
    return replace(
        files[0],
        items=tuple(item for one in files for item in one.items),
        sequences=tuple(name for one in files for name in one.sequences),
        errors={
            kind: joined((one.errors.get(kind) for one in files), np.inf)
            for kind in dict.fromkeys(kind for one in files for kind in one.errors)
        },
        failures={item: why for one in files for item, why in one.failures.items()},
        bars=join_bars(bars) if bars else None,
    )


def judge(file: Path, results: ResultSet, truth: Truth, config: EvalConfig) -> Judged:
    """Measure every image of a result file in the metrics that its datasets allow.

    Images and true shapes are matched by `match` (by frame where no item is the same), landmarks by
    name; those that only one side has are left out. Of several individuals that are matched with
    one, that with the least error is judged. Raises InputError where no image or too few landmarks
    match, and where no metric can be measured.
    """
    if not len(results):
        raise input_error(file, "holds no images", "check the run that wrote it")
    run = _run_of(results)
    results, too_few = take_visible(file, results, config.least_visible)
    results, own, shapes, rows, sought = _match(file, results, truth, config.match)
    names = common_landmarks(file, results.landmark_names, shapes.landmark_names)
    # `take` gives them in the order of the core, an index gives them landmark by landmark.
    places = match_landmarks(results.landmark_names, names)
    estimate = results.shapes.take(places, axis=2)
    true = shapes.shapes[rows].take(match_landmarks(shapes.landmark_names, names), axis=2)
    true[rows < 0] = np.nan
    others = list[str]()
    if sought == BY_FRAME:
        kept, others = _one_individual(results, rows, estimate, true)
    if others:
        results, rows, estimate, true = results.take(kept), rows[kept], estimate[kept], true[kept]
        own = replace(keys_of([results]), items=[own.items[row] for row in kept.tolist()])
    rotation = _true_rotation(file, results, true, config.truth_frame)
    with np.errstate(all="ignore"):  # overflow is not an error to report
        scale = in_blocks(truth_scale, estimate, true)
    arrays = {ESTIMATE: estimate, TRUTH: true, TRUE_ROTATION: rotation}
    units = (shapes.unit, results.unit)
    metrics, doubts = _meaningful(results, config.metrics, estimate, true, rotation)
    errors, unmeasured = _measure(file, results, metrics, arrays, scale, units)
    judged = in_blocks(visible_in_both, estimate, true)
    for values in errors.values():
        values[~judged.any(axis=-1)] = np.nan
    bars, unjudged = _judge_bars(file, results, places, arrays, scale, units[0])
    sequences = _sequences(results, shapes, rows)
    failures = _failures(results, sought, own, rows, judged, errors)
    lifted = np.array([item not in failures for item in results.items], dtype=np.bool_)
    for (metric, _), values in errors.items():
        if METRICS[metric].of_labels or METRICS[metric].optional:
            values[np.isnan(values) & lifted] = np.inf
    return Judged(
        file=file,
        items=results.items,
        sequences=sequences,
        errors=errors,
        failures=failures,
        warnings=(
            *too_few,
            *_left_out(file, results, shapes, names),
            *unmeasured,
            *(f"{file}: {doubt}" for doubt in (*others, *doubts)),
            *_partial(file, judged),
            *unjudged,
        ),
        bars=None if bars is None else replace(bars, sequences=sequences),
        run=run,
    )


def _match(
    file: Path, results: ResultSet, truth: Truth, match: str
) -> tuple[ResultSet, Keys, ShapeSet, NDArray[np.intp], str]:
    """Return the results, their keys, true shapes, the row of each image among them, and by what.

    By frame where that is asked for, or where items are and both sides have none in common.
    """
    own = keys_of([results])
    if match == BY_FRAME:
        return results, own, *truth.find(file, match, own), BY_FRAME
    if match != BY_ITEM:
        own = replace(own, items=named_items(results, match, file, "match"))
    try:
        return results, own, *truth.find(file, match, own), BY_ITEM
    except InputError:
        if match != BY_ITEM or results.status is not None:
            raise
        return results, own, *truth.find(file, BY_FRAME, own), BY_FRAME


def _one_individual(
    results: ResultSet, rows: NDArray[np.intp], estimate: Floats, true: Floats
) -> tuple[NDArray[np.intp], list[str]]:
    """Return the images of which no other is matched with the same true shape, with less error.

    And which individuals are left out for that: those of sequences with a larger median error after
    a similarity.
    """
    everyone = np.arange(len(rows))
    if results.sequences is None or len(np.unique(rows[rows >= 0])) == (rows >= 0).sum():
        return everyone, []
    error, sequences = in_blocks(similarity, estimate, true), np.array(results.sequences, str)
    medians = {
        str(name): float(np.nanmedian([np.inf, *error[sequences == name]]))
        for name in np.unique(sequences)
    }
    taken, kept, left = set[int](), list[int](), dict[str, None]()
    for name in sorted(medians, key=medians.__getitem__):
        own = np.flatnonzero(sequences == name)
        fine = [row for row in own.tolist() if rows[row] < 0 or rows[row] not in taken]
        taken |= set(rows[own].tolist())
        kept += fine
        left |= {name: None} if len(fine) < len(own) else {}
    if len(kept) == len(rows):  # two images of one sequence have the same true shape
        return everyone, []
    best = min(medians, key=medians.__getitem__)
    said = f"{abbreviate(list(left))} left out: {best} fits the same true shapes better"
    return np.sort(kept), [said]


MIRRORED = 0.75
"""Of the error, below which that of a mirrored truth says that it is left-handed."""
FRAMES_DIFFER = 45.0
"""Degrees by which rotations are off more than twice as much as the shapes themselves."""
SAMPLE = 500
"""Images that doubts about the truth rest on."""


def _meaningful(
    results: ResultSet,
    metrics: Sequence[str],
    estimate: Floats,
    true: Floats,
    rotation: Floats | None,
) -> tuple[tuple[str, ...], list[str]]:
    """Return the metrics without `rotation` where it means nothing, and what is doubtful.

    Shapes that fit the truth when they are turned little, with rotations that are far from the true
    ones, are of a dictionary with another frame than that of the truth.
    """
    chosen = spread(SAMPLE, len(estimate))
    e, x = estimate[list(chosen)], true[list(chosen)]
    with np.errstate(all="ignore"):
        error = np.nan_to_num(similarity(e, x), nan=np.inf)
        mirrored = np.nan_to_num(similarity(e, x * [[-1.0], [1.0], [1.0]]), nan=np.inf)
    said, least, most = [], float(np.median(mirrored)), float(np.median(error))
    if least < MIRRORED * most < np.inf:
        said.append(
            f"the shapes fit the truth better when it is mirrored ({least:.3g} for {most:.3g}); is "
            "it left-handed? Change the sign of one of its axes"
        )
    stated = results.rotation
    if "rotation" not in metrics or rotation is None or stated is None:
        return tuple(metrics), said
    R, S = rotation[list(chosen)], stated[list(chosen)]
    whole = np.isfinite(e).all(axis=(1, 2)) & np.isfinite(x).all(axis=(1, 2))
    with np.errstate(invalid="ignore"):  # entries of a rotation are at most 1
        whole &= (np.abs(S) < 2).all(axis=(1, 2)) & np.isfinite(R).all(axis=(1, 2))
    if not whole.any():
        return tuple(metrics), said
    turn = similarity_transform(e[whole], R[whole] @ x[whole]).rotation
    shapes = float(np.median(rotation_angle(turn, np.eye(3))))
    angle = float(np.median(rotation_angle(R[whole], S[whole])))
    if angle <= 2 * shapes + FRAMES_DIFFER:
        return tuple(metrics), said
    said.append(
        f"no rotation: those of the results are {angle:.0f} degrees off and their shapes "
        f"{shapes:.0f}, so that dictionary and truth have different frames"
    )
    return tuple(metric for metric in metrics if metric != "rotation"), said


def find_dataset(file: Path, results: ResultSet, wanted: Dataset) -> NDArray[Any] | None:
    """Return a dataset that a metric takes, in the paper's orientation; None if it is absent.

    Raises InputError where the dataset has another shape than the metric expects.
    """
    if wanted is FITTED and results.scale is not None and "focal" not in results.columns:
        return results.columns.get(wanted.name, results.shapes[:, :2])
    if wanted.name in RESULTS.datasets:
        return results.columns.get(wanted.name)
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


def with_shapes_of(results: ResultSet, names: Sequence[str]) -> ResultSet:
    """Return the result with its joints or with the input's landmarks, whichever fit the names.

    Where a fit lifted a detector's landmarks with a dictionary of joints, its result has both.
    """
    known = results.columns
    if INPUT_NAMES not in known or INPUT_SHAPES not in known:
        return results
    own = tuple(map(str, known[INPUT_NAMES]))
    if len(set(own) & set(names)) <= len(set(results.landmark_names) & set(names)):
        return results
    sd, correlation = results.per_item.get(INPUT_SD), results.per_item.get(INPUT_CORRELATION)
    apart = results.without((*OF_JOINTS, CORRELATION.name, "landmarks_fitted", "dual"))
    shown = apart.replaced(
        shapes=np.swapaxes(known[INPUT_SHAPES], 1, 2),
        shape_sd=None if sd is None else np.swapaxes(sd, 1, 2),
        landmark_names=own,
    )
    return shown if correlation is None else shown.with_columns({CORRELATION.name: correlation})


def take_visible(file: Path, results: ResultSet, least: int) -> tuple[ResultSet, tuple[str, ...]]:
    """Return the images with at least so many observed landmarks, and a warning about the others.

    Raises InputError where the file has no observed landmarks, or no such image.
    """
    if not least:
        return results, ()
    observed = find_dataset(file, results, LANDMARKS)
    if observed is None:
        fix = "fit to a file that ends in .h5, or leave out `least_visible`"
        found = "has no dataset 'landmarks', which `least_visible` counts in"
        raise input_error(file, found, fix)
    count = visible_in_both(observed, observed).sum(axis=-1)
    enough = count >= least
    if not enough.any():
        found = f"none of its {len(results)} images has {least} observed landmarks"
        raise input_error(file, found, f"set `least_visible` to {max(count, default=0)} or less")
    if enough.all():
        return results, ()
    # Without the name of the file: results of the same images have one warning together.
    left_out = f"{(~enough).sum()} of {len(results)} images left out"
    return results.take(np.flatnonzero(enough)), (
        f"{left_out}: fewer than {least} observed landmarks",
    )


def common_landmarks(file: Path, own: Sequence[str], true: Sequence[str]) -> tuple[str, ...]:
    """Return the landmarks of a file that the truth has too, in the order of the file.

    Raises InputError where these are fewer than three.
    """
    common = tuple(name for name in own if name in set(true))
    if len(common) < FEWEST_LANDMARKS:
        found = f"the truth has {len(common)} of its landmarks ({abbreviate(own)})"
        fix = (
            f"at least {FEWEST_LANDMARKS} must have the names that they have in the truth "
            f"({abbreviate(true)})"
        )
        raise input_error(file, found, fix)
    return common


def _run_of(results: ResultSet) -> Run:
    """Return what a file says of its fit; seconds that are no time are None."""
    seconds, status = results.attributes.get("solve_seconds"), results.status
    timed = isinstance(seconds, int | float) and np.isfinite(seconds) and seconds >= 0
    return Run(
        images=len(results),
        objective=results.objective,
        solved=None if status is None else int(np.isin(status.astype(str), SOLVED).sum()),
        seconds=float(seconds) if timed else None,  # type: ignore[arg-type]
    )


def _true_rotation(file: Path, results: ResultSet, true: Floats, frame: str) -> Floats | None:
    """Rotation (n, 3, 3) from the frame of the truth (n, 3, p) to that of the camera.

    None where the results should state it and do not. `line-of-sight` takes the centroid of the
    truth onto the optical axis by the smallest turn, for images that were fitted without a camera.
    """
    if frame == "object":
        return find_dataset(file, results, TRUE_ROTATION)
    none = np.tile(np.eye(3), (len(results), 1, 1))
    if frame == "camera":
        return none
    ray = centroid(true, visible_in_both(true, true))
    length = np.linalg.norm(ray, axis=1)
    turned = (length > 0) & np.isfinite(length)
    if "focal" in results.columns:
        turned &= ~np.isfinite(results.columns["focal"]).all(axis=1)
    x, y, z = np.where(turned[:, None], ray, [0.0, 0.0, 1.0]).T / np.where(turned, length, 1)
    depth, zero = np.where(z < 0, -1.0, 1.0), np.zeros(len(ray))
    K = np.stack([zero, zero, -depth * x, zero, zero, -depth * y, depth * x, depth * y, zero])
    K = K.T.reshape(-1, 3, 3)
    turn: Floats = none + K + K @ K / (1 + np.abs(z))[:, None, None]
    return turn


def _measure(
    file: Path,
    results: ResultSet,
    metrics: Sequence[str],
    arrays: Mapping[Dataset, NDArray[Any] | None],
    scale: Floats,
    units: tuple[str, str],
) -> tuple[dict[Kind, Floats], list[str]]:
    """Errors (n,) in each metric and unit, and warnings about metrics that lack a dataset.

    arrays holds the shapes and the true rotation; scale (n,) as `truth_scale` has it; units are
    those of the truth and of the images. Raises InputError where all metrics lack something.
    """
    errors: dict[Kind, Floats] = {}
    unmeasured = []
    skipped: list[str] = []
    for metric in metrics:
        known = METRICS[metric]
        further = (*known.datasets, *((LANDMARKS, BOX) if known.unit == IMAGE else ()))
        data = {each: find_dataset(file, results, each) for each in further} | dict(arrays)
        lacking = [dataset for dataset in known.datasets if data[dataset] is None]
        if lacking:
            datasets = " and ".join(f"`{dataset.name}`" for dataset in lacking)
            if not known.optional:
                skipped.append(metric)
                unmeasured.append(f"no {metric} without the dataset {datasets}")
            continue
        with np.errstate(all="ignore"):
            error: Floats = in_blocks(known.load(), *(data[dataset] for dataset in known.needs))
            if known.unit == LENGTH:  # once, where the unit of the truth is `normalised`
                measured = {NORMALISED: error / scale}
                measured |= {} if units[0] == NORMALISED else {units[0]: error}
            elif known.unit == IMAGE:
                measured = {units[1]: error, OF_THE_BOX: error / _diagonal(data)}
            else:
                measured = {known.unit: error}
        for unit, values in measured.items():
            errors[metric, unit] = np.where(np.isfinite(values), values, np.nan)
    if not errors:
        fix = "add the metric `similarity`, which needs only shapes"
        raise input_error(file, "; ".join(unmeasured), fix)
    if len(skipped) > 1 and results.rotation is None and results.landmarks_fitted is None:
        unmeasured = [f"holds shapes alone: no {listed(skipped, 'and')}"]  # as TRC and tables do
    return errors, [f"{file}: {text}" for text in unmeasured]


def _diagonal(data: Mapping[Dataset, NDArray[Any] | None]) -> Floats:
    """Diagonal (n,) of the given boxes (n, 4), x y w h, else of those of the observed landmarks.

    nan where it is 0 or unknown.
    """
    boxes, observed = data[BOX], data[LANDMARKS]
    if boxes is None:
        assert observed is not None  # a metric in an image takes them
        return box_diagonal(observed)
    diagonal = np.hypot(boxes[:, 2], boxes[:, 3])
    return np.where(diagonal > 0, diagonal, np.nan)


def _judge_bars(
    file: Path,
    results: ResultSet,
    own: NDArray[np.intp],
    arrays: Mapping[Dataset, NDArray[Any] | None],
    scale: Floats,
    unit: str,
) -> tuple[ErrorBars | None, list[str]]:
    """Return how the truth lies in the error bars of the landmarks `own`, None without any.

    And a warning where there are some, but no rotation of the truth to the camera.
    """
    deviation = find_dataset(file, results, DEVIATION)
    if deviation is None:
        return None, []
    if arrays[TRUE_ROTATION] is None:
        lacking = f"without the dataset `{TRUE_ROTATION.name}` or a `truth_frame`"
        return None, [f"{file}: the error bars are not judged, {lacking}"]
    correlation = find_dataset(file, results, CORRELATION)
    with np.errstate(all="ignore"):  # overflow is not an error to report
        square, width = in_blocks(
            find_squares,
            *(arrays[ESTIMATE], arrays[TRUTH], arrays[TRUE_ROTATION]),
            deviation.take(own, axis=2),
            None if correlation is None else correlation.take(own, axis=2),
        )
        widths = {NORMALISED: width / scale[:, None], unit: width}
    return ErrorBars((), square, widths), []


def _left_out(file: Path, results: ResultSet, truth: ShapeSet, common: Sequence[str]) -> list[str]:
    """Warnings about the landmarks that one side has alone."""
    sides = {"results": results.landmark_names, "truth": truth.landmark_names}
    alone = {side: [n for n in names if n not in set(common)] for side, names in sides.items()}
    return [
        f"{file}: landmarks in the {side} alone are left out: {abbreviate(names)}"
        for side, names in alone.items()
        if names
    ]


def _partial(file: Path, judged: Flags) -> list[str]:
    """Warn of images of which some landmarks (n, p) are judged."""
    partial = int((judged.any(axis=-1) & ~judged.all(axis=-1)).sum())
    lack = f"lack some of the {judged.shape[1]} landmarks, there or in the truth"
    return [f"{file}: {partial} images {lack}; judged on the others"] if partial else []


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
    sought: str,
    own: Keys,
    rows: NDArray[np.intp],
    judged: Flags,
    errors: Mapping[Kind, Floats],
) -> dict[str, str]:
    """Why each image without one or more errors has none."""

    def reason(i: int) -> str:
        if rows[i] < 0:
            names = own.by_frame()[1] if sought == BY_FRAME else own.items
            return f"the truth has no {sought} '{names[i]}'"
        if not np.isfinite(results.shapes[i]).any():
            status = "" if results.status is None else f" (status {results.status[i]})"
            return f"the results hold no shape{status}"
        if judged[i].sum() < FEWEST_LANDMARKS:
            return f"only {judged[i].sum()} landmarks are known on both sides"
        lost = [kind for kind, values in certain.items() if np.isnan(values[i])]
        empty = np.isfinite(results.shapes[i]).all() and coincide(results.shapes[i])
        if empty and all(ROTATION in METRICS[metric].needs for metric, _ in lost):
            return "no rotation (deg): the shape is empty, with all its landmarks at one point"
        kinds = ", ".join(f"{metric} ({unit})" for metric, unit in lost)
        return f"a value needed for {kinds} is nan, or true landmarks are all at one point"

    certain = {
        kind: values
        for kind, values in errors.items()
        if not (METRICS[kind[0]].of_labels or METRICS[kind[0]].optional)
    }
    failed = ~judged.any(axis=-1)
    for values in certain.values():
        failed |= np.isnan(values)
    return {results.items[i]: reason(i) for i in np.flatnonzero(failed).tolist()}
