"""One result file against the truth: which truth belongs to which image, and the errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, input_error
from shapefit.evaluation.averages import in_blocks, labels_of
from shapefit.evaluation.metric_table import METRICS, ROTATION, TRUE_ROTATION
from shapefit.evaluation.metrics import FEWEST_LANDMARKS, truth_scale, visible_in_both
from shapefit.evaluation.summary import ALL, ImageErrors, group_sequences
from shapefit.geometry.normalisation import centroid
from shapefit.geometry.procrustes import coincide
from shapefit.io.landmark_names import match_landmarks
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.pipelines.evaluate.measurement import Kind, datasets_of, find_dataset, measure
from shapefit.pipelines.items import named_items

Frame = Literal["object", "camera", "line-of-sight"]


@dataclass(frozen=True)
class Judgement:
    """Errors of the images of one result file.

    items and sequences (n), a sequence that nobody knows is empty; errors maps a metric and unit
    to (n,), nan where an image failed or, in precision and recall, has nothing to judge; failures
    maps the failed items to the reason; truth_rows (n) index `truth`, -1 where
    there is none; estimate and true (n, 3, p) are the shapes of the landmarks that both sides
    have, a true one nan where there is none; scale (n,) is the spread of the true ones;
    true_rotation (n, 3, 3), from the frame of the truth to that of the camera, None where nobody
    knows it.
    """

    file: Path
    items: tuple[str, ...]
    sequences: tuple[str, ...]
    errors: Mapping[Kind, Floats]
    failures: Mapping[str, str]
    warnings: tuple[str, ...]
    truth: ShapeSet
    truth_rows: NDArray[np.intp]
    landmarks: tuple[str, ...]
    estimate: Floats
    true: Floats
    scale: Floats
    true_rotation: Floats | None = None

    def failed(self) -> NDArray[np.bool_]:
        """Which images (n,) failed."""
        return np.array([item in self.failures for item in self.items], dtype=np.bool_)


def judge(
    file: Path,
    results: ResultSet,
    named: Callable[[Sequence[str]], ShapeSet],
    match: str,
    metrics: Sequence[str],
    *,
    frame: Frame = "object",
) -> Judgement:
    """Measure every image of a result file in the metrics that its datasets allow.

    `match` is "item", or the dataset of the results that names the true item of each image; `named`
    gives the true shapes of these names.
    Landmarks are matched by name; those that only one side has are left out. `frame` is that of the
    truth: its own, from which the dataset `true_rotation` turns it, that of the camera, or that of
    the camera turned to look straight at each shape. Raises InputError
    where no image or too few landmarks match, and where no metric can be measured.
    """
    if not len(results):
        raise input_error(file, "holds no images", "check the run that wrote it")
    keys = named_items(results, match, file, "match")
    truth = named(keys)
    rows = _truth_rows(file, keys, truth)
    names = common_landmarks(file, results.landmark_names, truth.landmark_names)
    warnings = _left_out(file, results, truth, names)
    # `take` gives them in the order of the core, an index gives them landmark by landmark.
    estimate = results.shapes.take(match_landmarks(results.landmark_names, names), axis=2)
    true = truth.shapes[rows].take(match_landmarks(truth.landmark_names, names), axis=2)
    true[rows < 0] = np.nan

    rotation = find_rotation(file, results, true, frame)
    wanted = [dataset for metric in metrics for dataset in datasets_of(metric)]
    data = {dataset: find_dataset(file, results, dataset) for dataset in wanted}
    data[TRUE_ROTATION] = rotation
    with np.errstate(all="ignore"):  # overflow is not an error to report
        scale = in_blocks(truth_scale, estimate, true)
    errors: dict[Kind, Floats] = {}
    unmeasured: list[str] = []
    for metric in metrics:
        lacking = [dataset for dataset in METRICS[metric].datasets if data[dataset] is None]
        if lacking:
            datasets = " and ".join(f"`{dataset.name}`" for dataset in lacking)
            unmeasured.append(f"no {metric} without the dataset {datasets}")
            continue
        with np.errstate(all="ignore"):
            measured = measure(metric, estimate, true, scale, data, (truth.unit, results.unit))
        errors |= {kind: np.where(np.isfinite(v), v, np.nan) for kind, v in measured.items()}
    if not errors:
        found = "; ".join(unmeasured)
        raise input_error(file, found, "add the metric `similarity`, which needs only shapes")
    warnings += [f"{file}: {metric}" for metric in unmeasured]

    judged = in_blocks(visible_in_both, estimate, true)
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
        truth=truth,
        truth_rows=rows,
        landmarks=names,
        estimate=estimate,
        true=true,
        scale=scale,
        true_rotation=rotation,
    )


def find_rotation(file: Path, results: ResultSet, true: Floats, frame: Frame) -> Floats | None:
    """Rotation (n, 3, 3) from the frame of the truth (n, 3, p) to that of the camera.

    None where the results should state it and do not. For the line of sight it takes the centroid
    of the truth onto the optical axis, by the smallest turn.
    """
    if frame == "object":
        return find_dataset(file, results, TRUE_ROTATION)
    if frame == "camera":
        return np.tile(np.eye(3), (len(results), 1, 1))
    ray = centroid(true, visible_in_both(true, true))
    length = np.linalg.norm(ray, axis=1)
    somewhere = (length > 0) & np.isfinite(length)
    x, y, z = np.where(somewhere[:, None], ray, [0.0, 0.0, 1.0]).T / np.where(somewhere, length, 1)
    depth, none = np.where(z < 0, -1.0, 1.0), np.zeros(len(ray))
    K = np.stack([none, none, -depth * x, none, none, -depth * y, depth * x, depth * y, none])
    K = K.T.reshape(-1, 3, 3)
    turn: Floats = np.eye(3) + K + K @ K / (1 + np.abs(z))[:, None, None]
    return turn


def _truth_rows(file: Path, keys: Sequence[str], truth: ShapeSet) -> NDArray[np.intp]:
    """Index of the truth of each image, -1 where there is none."""
    if not len(truth):
        raise input_error("truth", "holds no shapes", f"give the truth of the images of {file}")
    if tuple(keys) == truth.items:
        return np.arange(len(keys))
    index = {item: row for row, item in enumerate(truth.items)}
    rows = np.array([index.get(key, -1) for key in keys], dtype=np.intp)
    if (rows < 0).all():
        found = f"none of its {len(keys)} images is in the truth, which has no '{keys[0]}'"
        fix = f"give the truth of these images, or set `match` (an item: '{truth.items[0]}')"
        raise input_error(file, found, fix)
    return rows


def _left_out(file: Path, results: ResultSet, truth: ShapeSet, common: Sequence[str]) -> list[str]:
    """Warnings about the landmarks that one side has alone."""
    sides = {"results": results.landmark_names, "truth": truth.landmark_names}
    alone = {side: [n for n in names if n not in set(common)] for side, names in sides.items()}
    return [
        f"{file}: landmarks in the {side} alone are left out: {abbreviate(names)}"
        for side, names in alone.items()
        if names
    ]


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
        if judged[i].sum() < FEWEST_LANDMARKS:
            return f"only {judged[i].sum()} landmarks are known on both sides"
        lost = [kind for kind, values in certain.items() if np.isnan(values[i])]
        empty = np.isfinite(results.shapes[i]).all() and coincide(results.shapes[i])
        if empty and all(ROTATION in METRICS[metric].needs for metric, _ in lost):
            return "no rotation (deg): the shape is empty, with all its landmarks at one point"
        kinds = [f"{metric} ({unit})" for metric, unit in lost]
        return (
            f"a value needed for {', '.join(kinds)} is nan, or true landmarks are all at one point"
        )

    certain = {kind: v for kind, v in errors.items() if not METRICS[kind[0]].of_labels}
    failed = ~judged.any(axis=-1)
    for values in certain.values():
        failed |= np.isnan(values)
    return {results.items[i]: reason(i) for i in np.flatnonzero(failed).tolist()}


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


def image_errors(name: str, judgement: Judgement) -> list[ImageErrors]:
    """Return what one file of a method says about each metric and unit."""
    found = []
    failed = judgement.failed()
    for kind, values in judgement.errors.items():
        rows = rows_judged(kind, values, failed)
        items = tuple(judgement.items[row] for row in rows)
        sequences = labels_of([judgement.sequences[row] for row in rows])
        if items:
            found.append(ImageErrors(name, *kind, items, sequences, values[rows]))
    return found


def rows_judged(kind: Kind, values: Floats, failed: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Images (n,) that count in a metric, by their errors (n,) in it.

    Those that leave labels undefined are no images of theirs, unless they failed.
    """
    return np.flatnonzero(failed | ~np.isnan(values) | (not METRICS[kind[0]].of_labels))


def find_grouping(
    groups: Mapping[str, str], errors: Sequence[ImageErrors]
) -> tuple[dict[str, tuple[str, ...]], tuple[str, ...]]:
    """Sequences of each group (name -> glob), and warnings about what matches nothing.

    Raises InputError where no sequence is in any group.
    """
    sequences = dict.fromkeys(s for e in errors for s in e.sequences.names if s)
    grouping = group_sequences(groups, sequences)
    empty = [group for group, members in grouping.items() if not members]
    if len(empty) == len(grouping):
        found = f"no sequence matches any group; the sequences are {abbreviate(list(sequences))}"
        raise input_error("groups", found, "correct the globs, or leave `groups` out")
    grouped = {member for members in grouping.values() for member in members}
    outside = [sequence for sequence in sequences if sequence not in grouped]
    warnings = [f"group {g}: no sequence matches {groups[g]!r}" for g in empty]
    if outside:
        warnings.append(f"sequences in no group, only in per_image.csv: {abbreviate(outside)}")
    return grouping, tuple(warnings)
