"""Results of one method compared with the truth: errors, error bars, failures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit.arrays import Flags, Floats, Indices
from shapefit.config import EvalConfig
from shapefit.errors import InputError, abbreviate, input_error, listed
from shapefit.evaluation import metrics as m
from shapefit.evaluation.calibration import ErrorBars, measure_error_bars
from shapefit.evaluation.metrics import (
    METRICS,
    MIN_COMMON_LANDMARKS,
    in_blocks,
    similarity_error,
)
from shapefit.evaluation.report import ALL, NORMALISED, Quantity
from shapefit.geometry.joint_angles import measurable_angles, measure_angles
from shapefit.geometry.procrustes import aligned_distances, similarity_transform
from shapefit.geometry.rotations import rotation_angle
from shapefit.io.layout import RESULTS, UNKNOWN_UNIT
from shapefit.io.names import check_numbering, find_side_pairs, match_landmarks
from shapefit.io.skeletons import joint_columns
from shapefit.pipelines.items import (
    BY_FRAME,
    BY_ITEM,
    find_truth,
    join_match_keys,
    names_in_dataset,
    subsample,
)
from shapefit.records import Fit, Items, Shapes
from shapefit.records.columns import Array, columns_of, in_columns

ALWAYS_TAKEN = ("true_rotation", "rotation", "shape_correlation", "bounding_box")
"""Datasets that are taken beside those that metrics need."""

BY_JOINT = {
    column.name for column in columns_of(Fit) if {"p", "r"} & {*column.axes}
} - {"shapes", "landmark_names"} | {"corrupted"}
"""Datasets with an axis of joints, which results have for these, not for the input."""

OTHER_SIDE_BELOW = 0.75
"""Share of the error below which that of a mirrored truth, or of exchanged names, means
that these are right.
"""

MAX_SIZE_RATIO = 30.0
"""Factor between the sizes of shapes in one unit from which on it is in doubt: children
and adults differ by less.
"""

OTHER_FRAME_DEGREES = 45.0
"""By which rotations of another frame are off, beyond twice as much as the shapes."""

ANY_DIRECTION = np.array([0.0, 1.0, 0.0])
"""Passed as up where no angle to the vertical is used."""

LIMB_ENDS = {"lwrist", "rwrist", "lankle", "rankle"}
"""Joints by which people are told from tracked animals, which have paws."""

INSPECTED_IMAGES = 500
"""By which a mirrored truth, and one in another frame, are recognised."""

MetricData = Mapping[str, Any]
"""What metrics take, by name; None for what is absent."""


class MethodErrors(NamedTuple):
    """Errors of the n images of the results of one method.

    items and sequences (n), "" where the sequence is unknown; errors maps a metric and
    unit to (n,), nan where an image failed, infinite where it does not count, as in
    precision where nothing was labelled; failures maps the failed items to the reason;
    landmarks and angles are the errors of each landmark, once the shape is aligned, and
    of each joint angle; bars says how the truth lies in the error bars, where the
    method has them; objective (n) and the name of the method, where the file has them.
    """

    items: tuple[str, ...]
    sequences: tuple[str, ...]
    errors: Mapping[Quantity, Floats]
    failures: Mapping[str, str]
    warnings: tuple[str, ...]
    landmarks: PartErrors
    angles: PartErrors
    bars: ErrorBars | None
    objective: Floats | None
    method: str | None


class PartErrors(NamedTuple):
    """Errors of each landmark or joint angle.

    names (q); errors (n, q) by unit, nan where one side lacks the part.
    """

    names: tuple[str, ...]
    errors: Mapping[str, Floats]


def measure(
    file: Path, results: Fit, truth: Shapes, config: EvalConfig
) -> MethodErrors:
    """Measure every image of results in the metrics that their datasets allow.

    Images and true shapes are matched by `match` (by frame where no item is the same),
    landmarks by name. Of several individuals that match the same true shapes the one
    with the least error is measured. Raises InputError where no image or too few
    landmarks match, and where no metric can be measured.
    """
    return measure_matched(
        file, match_results(file, results, truth, config), truth, config
    )


def match_results(
    file: Path, results: Fit, truth: Shapes, config: EvalConfig
) -> MatchedResults:
    """Match results to the true shapes, and landmarks of both by name.

    Images with too few visible landmarks are left out. Raises InputError where no image
    or too few landmarks match.
    """
    results = _with_enough_visible(file, results, config.least_visible)
    _check_not_empty(file, results, truth, config.least_visible)
    return _match(file, results, truth, config.match)


def measure_matched(
    file: Path, matched: MatchedResults, truth: Shapes, config: EvalConfig
) -> MethodErrors:
    """Measure matched results in the metrics that their datasets allow.

    Raises InputError where no metric can be measured.
    """
    results, estimate, true = matched.results, matched.estimate, matched.true
    data = _find_datasets(file, matched, config)
    with np.errstate(all="ignore"):  # overflow is not an error to report
        warnings = [*matched.notes, *_warn_of_sides(estimate, true, matched.names)]
        metrics, notes = check_rotation_frames(config.metrics, data)
        warnings += [*notes, *_warn_of_units(results, truth, estimate, true)]
        scale = in_blocks(m.truth_scale, estimate, true)
        errors, lacking = _errors_of(
            file, metrics, data, scale, truth.unit, results.unit
        )
        warnings += lacking
        bars, notes = _find_bars(matched, data, scale, truth.unit)
        warnings += notes
        aligned = data["aligned_distances"]
        by_unit = {NORMALISED: aligned / scale[:, None]}
        by_unit.setdefault(truth.unit, aligned)
        landmarks = PartErrors(matched.names, by_unit)
    common = in_blocks(m.visible_in_both, estimate, true)
    for values in errors.values():
        values[~common.any(axis=-1)] = np.nan
    failures = _failure_reasons(results, matched.rows, common, errors)
    has_error = [item not in failures for item in results.items]
    is_fitted = np.array(has_error, dtype=np.bool_)
    for (metric, _), values in errors.items():
        if METRICS[metric].optional:
            values[np.isnan(values) & is_fitted] = np.inf
    method = results.attributes.get("method")
    return MethodErrors(
        items=tuple(results.items),
        sequences=_image_sequences(results, truth, matched.rows),
        errors=errors,
        failures=failures,
        warnings=tuple(f"{file}: {text}" for text in warnings),
        landmarks=landmarks,
        angles=_angle_errors(matched),
        bars=bars,
        objective=results.objective,
        method=method if isinstance(method, str) else None,
    )


def _with_enough_visible(file: Path, results: Fit, min_visible: int) -> Fit:
    """Return the images in which at least `min_visible` landmarks were observed."""
    if not min_visible:
        return results
    observed = find_dataset(file, results, "landmarks")
    count = np.zeros(len(results))
    if observed is not None:
        count = m.visible_in_both(observed, observed).sum(axis=-1)
    return results.take(count >= min_visible)


def _check_not_empty(
    file: Path, results: Fit, truth: Shapes, least_visible: int
) -> None:
    """Raise InputError where the results or the truth hold no shape to compare."""
    fault = "holds no shapes"
    if least_visible:
        fault += f" with {least_visible} observed `landmarks`"
    fix = "give results, and the truth of the same"
    if not len(results):
        raise input_error(file, fault, fix)
    if not len(truth):
        raise input_error("truth", fault, fix)


class MatchedResults(NamedTuple):
    """Results of n images beside their true shapes, in the landmarks that both have.

    rows (n,) of the true shapes, -1 for none; names of the p common landmarks; estimate
    and true (n, 3, p); notes for people.
    """

    results: Fit
    rows: Indices
    names: tuple[str, ...]
    estimate: Floats
    true: Floats
    notes: list[str]

    @property
    def columns(self) -> Indices:
        """Return the places (p,) of the common landmarks among those of the results."""
        return match_landmarks(self.results.landmark_names, self.names)


def _match(file: Path, results: Fit, truth: Shapes, match: str) -> MatchedResults:
    """Find the true shape of each image, and the landmarks that both have."""
    rows, is_by_frame = match_truth(file, results, truth, match)
    names = _common_landmarks(file, results.landmark_names, truth.landmark_names)
    # `take` gives them in the order of the core, an index gives them landmark by
    # landmark.
    estimate = results.as_columns().take(
        match_landmarks(results.landmark_names, names), axis=2
    )
    in_truth = match_landmarks(truth.landmark_names, names)
    true = truth.as_columns()[rows].take(in_truth, axis=2)
    true[rows < 0] = np.nan
    notes = [
        *check_numbering(
            results.landmark_names, truth.landmark_names, str(file), "the truth"
        ),
        *_describe_left_out("results", results.landmark_names, names),
        *_describe_left_out("truth", truth.landmark_names, names),
    ]
    if is_by_frame and results.sequences is not None:
        retained, left_out = _select_best_individual(
            results.sequences, rows, estimate, true
        )
        notes += left_out
        results = results.take(retained)
        rows = rows[retained]
        estimate = estimate[retained]
        true = true[retained]
    return MatchedResults(results, rows, names, estimate, true, notes)


def _describe_left_out(
    side: str, names: Sequence[str], common: Sequence[str]
) -> Iterator[str]:
    """Yield a note on landmarks that only one side has: `results` or `truth`."""
    alone = [name for name in names if name not in set(common)]
    if alone:
        yield f"landmarks in the {side} alone are left out: {abbreviate(alone)}"


def _find_datasets(
    file: Path, matched: MatchedResults, config: EvalConfig
) -> MetricData:
    """Return the datasets that metrics need, and ALWAYS_TAKEN, by name.

    None for absent ones.
    """
    with np.errstate(all="ignore"):  # overflow is not an error to report
        aligned = in_blocks(aligned_distances, matched.estimate, matched.true)
    is_known = ~np.isnan(aligned)
    aligned[is_known.sum(axis=1) < MIN_COMMON_LANDMARKS] = np.nan
    data: dict[str, Any] = {
        "estimate": matched.estimate,
        "truth": matched.true,
        "aligned_distances": aligned,
    }
    of_metrics = chain(*(METRICS[metric].needs for metric in config.metrics))
    for name in {*ALWAYS_TAKEN, *of_metrics} - data.keys():
        data[name] = find_dataset(file, matched.results, name)
    if config.truth_frame == "camera":
        data["true_rotation"] = np.tile(np.eye(3), (len(matched.results), 1, 1))
    return data


def _find_bars(
    matched: MatchedResults, data: MetricData, scale: Floats, unit: str
) -> tuple[ErrorBars | None, list[str]]:
    """Return where the truth lies in the error bars, None without bars; and notes.

    scale (n,): the size of the true shapes, in their unit.
    """
    deviation = matched.results.shape_sd
    if deviation is None:
        return None, []
    if data["true_rotation"] is None:
        return None, [
            "the error bars are not compared, without `true_rotation` or `truth_frame`"
        ]
    correlation = data["shape_correlation"]
    if correlation is not None:
        correlation = correlation.take(matched.columns, axis=2)
    square, width = in_blocks(
        measure_error_bars,
        matched.estimate,
        matched.true,
        data["true_rotation"],
        in_columns(deviation).take(matched.columns, axis=2),
        correlation,
    )
    return ErrorBars(square, {NORMALISED: width / scale[:, None], unit: width}), []


def _angle_errors(matched: MatchedResults) -> PartErrors:
    """Return the errors of joint angles in degrees; none but for people.

    Angles to the vertical are left out, which the frames of the two sides do not share.
    """
    joints = joint_columns(matched.names)
    if not LIMB_ENDS & joints.keys():
        return PartErrors((), {})
    angles = [angle for angle in measurable_angles(joints) if not angle.depends_on_up]
    if not angles:
        return PartErrors((), {})

    def turns(estimate: Floats, true: Floats) -> Floats:
        """Return the differences (n, a) of angles in degrees, the shorter way round."""
        estimated, _ = measure_angles(estimate, ANY_DIRECTION, joints, angles=angles)
        expected, _ = measure_angles(true, ANY_DIRECTION, joints, angles=angles)
        turn = np.abs(estimated - expected)
        return np.minimum(turn, 360.0 - turn)

    with np.errstate(all="ignore"):  # overflow is not an error to report
        errors = in_blocks(turns, matched.estimate, matched.true)
    return PartErrors(tuple(angle.name for angle in angles), {"deg": errors})


def _image_sequences(results: Fit, truth: Shapes, rows: Indices) -> tuple[str, ...]:
    """Return the sequence (n,) of each image, by the truth where results have none."""
    if results.sequences is not None:
        return tuple(name or ALL for name in results.sequences)
    if truth.sequences is None:
        return (ALL,) * len(rows)
    of_truth = [name or ALL for name in truth.sequences]
    return tuple("" if row < 0 else of_truth[row] for row in rows.tolist())


def match_truth(
    file: Path, results: Items, truth: Shapes, match: str
) -> tuple[Indices, bool]:
    """Return each image's row (n,) in the truth, -1 for none; and whether by frame.

    By frame where that is chosen, or where results of other tools, which have no
    status, share no item with the truth.
    """
    keys = join_match_keys([results])
    true_keys = join_match_keys([truth])
    if match not in (BY_ITEM, BY_FRAME):
        keys = keys._replace(items=names_in_dataset(results, match, file, "match"))
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
    """Return the landmarks that the truth has too; InputError where they are few."""
    common = tuple(name for name in names if name in set(true))
    if len(common) < MIN_COMMON_LANDMARKS:
        fault = f"the truth has {len(common)} of its landmarks ({abbreviate(names)})"
        fix = (
            f"at least {MIN_COMMON_LANDMARKS} must have the names that they have in the"
            " truth"
        )
        raise input_error(file, fault, f"{fix} ({abbreviate(true)})")
    return common


def _select_best_individual(
    sequences: Sequence[str], rows: Indices, estimate: Floats, true: Floats
) -> tuple[Indices, list[str]]:
    """Keep, of individuals with the same true shapes, the best; return rows, warnings.

    It is the one with the smallest median error; rows of its images are returned.
    """
    has_truth = rows >= 0
    names = np.array(sequences, str)
    is_omitted = np.zeros(len(rows), np.bool_)
    if len(np.unique(rows[has_truth])) < has_truth.sum():
        error = in_blocks(similarity_error, estimate, true)
        medians = {
            name: np.nanmedian([np.inf, *error[names == name]])
            for name in np.unique(names)
        }
        taken = np.array([], np.intp)
        for name in sorted(medians, key=medians.__getitem__):
            is_omitted |= (names == name) & np.isin(rows, taken)
            taken = np.union1d(taken, rows[(names == name) & has_truth])
    for name in np.unique(names[is_omitted]):
        is_of_name = names == name
        # Whoever is left out wherever there is a truth has no failed images.
        if is_omitted[is_of_name & has_truth].all():
            is_omitted |= is_of_name
    warnings = []
    if is_omitted.any():
        who = abbreviate(np.unique(names[is_omitted]).tolist())
        warnings.append(
            f"{who} left out: another individual fits the same true shapes better"
        )
    return np.flatnonzero(~is_omitted), warnings


def find_dataset(file: Path, results: Fit, name: str) -> Any:
    """Return a dataset that a metric takes, in the paper's orientation, or None.

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
    of_image = [p if size == "p" else size for size in m.CARRIED[name]]
    expected = (len(results), *of_image)
    if data.shape != expected or data.dtype.kind not in "biuf":
        fault = f"has the shape {data.shape} of {data.dtype}"
        raise input_error(
            f"{file}:/{name}", fault, f"give numbers of the shape {expected}"
        )


def _warn_of_sides(estimate: Floats, truth: Floats, names: Sequence[str]) -> list[str]:
    """Return a warning where a mirrored truth or swapped sides fit far better, else [].

    Or one with the names of left and right exchanged. Shapes are (n, 3, p).
    """
    some = list(subsample(INSPECTED_IMAGES, len(estimate)))
    e = estimate[some]
    x = truth[some]
    exchanged = np.arange(len(names))
    for left, right in find_side_pairs(names):
        exchanged[[left, right]] = right, left

    def median_error(true: Floats) -> float:
        """Return the median error after a similarity, inf where one is unknown."""
        return float(np.median(np.nan_to_num(similarity_error(e, true), nan=np.inf)))

    error = median_error(x)
    mirrored = median_error(x * [[-1.0], [1.0], [1.0]])
    renamed = median_error(x[..., exchanged])
    if not min(mirrored, renamed) < OTHER_SIDE_BELOW * error < np.inf:
        return []
    if renamed <= mirrored:
        text = "the shapes fit the truth better when left and right are exchanged"
        fix = "are the names of the sides right? Exchange them by `rename`"
        return [f"{text} ({renamed:.3g} for {error:.3g}); {fix}"]
    text = "the shapes fit the truth better when it is mirrored"
    fix = "is it left-handed? Change the sign of one of its axes"
    return [f"{text} ({mirrored:.3g} for {error:.3g}); {fix}"]


def _warn_of_units(
    results: Fit, truth: Shapes, estimate: Floats, true: Floats
) -> list[str]:
    """Return a warning where results and truth in one unit differ far in size, else [].

    estimate and true (n, 3, p). Results in pixels may state how many metres these are.
    """
    unit = results.unit
    metres = results.metres_per_unit
    if metres is not None and truth.unit == "m":
        unit = "m"
        estimate = estimate * np.reshape(metres, (-1, 1, 1))
    if unit != truth.unit or unit in ("px", UNKNOWN_UNIT, NORMALISED):
        return []
    is_common: Flags = np.asarray(np.isfinite(estimate + true).all(axis=1))
    has_common = np.asarray(is_common.any(axis=1))
    if not has_common.any():
        return []

    def size(points: Floats) -> Floats:
        """Return the sizes (n,) of shapes over the landmarks that both have."""
        of_common = np.where(is_common[:, None], points, np.nan)[has_common]
        spread = np.nanstd(of_common, axis=2)
        return np.asarray(spread.mean(axis=1))

    ratio = float(np.nanmedian(size(true) / size(estimate)))
    if not (ratio > MAX_SIZE_RATIO or 0 < ratio < 1 / MAX_SIZE_RATIO):
        return []
    times = f"{ratio:,.0f} times" if ratio > 1 else f"1 / {1 / ratio:,.0f} of"
    text = f"the truth is {times} the size of the results, and both state {unit}"
    return [f"{text}: one of them has another unit, and errors in {unit} are wrong"]


def check_rotation_frames(
    metrics: Sequence[str], data: MetricData
) -> tuple[Sequence[str], list[str]]:
    """Return metrics without `rotation` if object frames differ, and a note on that.

    The frames are those of dictionary and truth. If they differ, shapes fit the truth
    with a small rotation, and their stated rotations are far from the true ones.
    """
    if "rotation" not in metrics:
        return metrics, []
    if data["true_rotation"] is None or data["rotation"] is None:
        return metrics, []
    some = list(subsample(INSPECTED_IMAGES, len(data["estimate"])))
    e = data["estimate"][some]
    x = data["truth"][some]
    R = data["true_rotation"][some]
    stated = data["rotation"][some]
    is_whole = np.isfinite(np.concatenate([e, x, R, stated], axis=2)).all(axis=(1, 2))
    if not is_whole.any():
        return metrics, []
    turned = R[is_whole] @ x[is_whole]
    turn = similarity_transform(e[is_whole], turned).rotation
    of_shapes = float(np.median(rotation_angle(turn, np.eye(3))))
    angle = float(np.median(rotation_angle(R[is_whole], stated[is_whole])))
    if angle <= 2 * of_shapes + OTHER_FRAME_DEGREES:
        return metrics, []
    others = [metric for metric in metrics if metric != "rotation"]
    return others, [
        f"no rotation: off by {angle:.0f} degrees, and the shapes by {of_shapes:.0f}:"
        " dictionary and truth have different frames"
    ]


def _errors_of(
    file: Path,
    metrics: Sequence[str],
    data: MetricData,
    scale: Floats,
    unit: str,
    image_unit: str,
) -> tuple[dict[Quantity, Floats], list[str]]:
    """Return errors (n,) in each metric and unit, and a warning on what is lacking.

    scale (n,) as `truth_scale` has it; unit is that of the truth. Raises InputError
    where all metrics lack something.
    """
    errors: dict[Quantity, Floats] = {}
    lacking: dict[str, list[str]] = {}
    for name in metrics:
        metric = METRICS[name]
        absent = [f"`{dataset}`" for dataset in metric.needs if data[dataset] is None]
        if absent:
            if name != "expected":
                lacking[name] = absent
            continue
        arrays = [data[dataset] for dataset in metric.needs]
        error: Floats = in_blocks(metric.function, *arrays)
        by_unit = {metric.unit: error}
        if metric.unit == m.LENGTH:
            by_unit = {NORMALISED: error / scale}
            # but once, where the unit of the truth is `normalised`
            by_unit.setdefault(unit, error)
        elif metric.unit == m.IMAGE_LENGTH:
            box = m.box_diagonal(data["landmarks"], data["bounding_box"])
            by_unit = {image_unit: error, "box": error / box}
        for of_unit, values in by_unit.items():
            errors[name, of_unit] = np.where(np.isfinite(values), values, np.nan)
    warnings = []
    if lacking:
        absent = [*dict.fromkeys(chain(*lacking.values()))]
        warnings = [f"no {listed(lacking, 'and')} without {listed(absent, 'and')}"]
    if not errors:
        fix = "add the metric `similarity`, which needs only shapes"
        raise input_error(file, "".join(warnings), fix)
    return errors, warnings


def _failure_reasons(
    results: Fit, rows: Indices, common: Flags, errors: Mapping[Quantity, Floats]
) -> dict[str, str]:
    """Return item -> why it lacks an error; rows (n,) of true shapes, -1 for none."""
    certain = {
        quantity: values
        for quantity, values in errors.items()
        if not METRICS[quantity[0]].optional
    }
    is_apart = ~common.any(axis=-1)
    is_failed = np.any([is_apart, *map(np.isnan, certain.values())], axis=0)
    reasons = {}
    for i in np.flatnonzero(is_failed).tolist():
        if rows[i] < 0:
            reason = "it has no true shape"
        elif not np.isfinite(results.shapes[i]).any():
            status = "" if results.status is None else f" (status {results.status[i]})"
            reason = f"the results hold no shape{status}"
        else:
            lost = [
                f"{name} ({unit})"
                for (name, unit), values in certain.items()
                if np.isnan(values[i])
            ]
            count = common[i].sum()
            reason = f"{count} landmarks are on both sides, and no {', '.join(lost)}"
        reasons[results.items[i]] = reason
    return reasons


def with_shapes_of(results: Fit, names: Sequence[str]) -> Fit:
    """Return a fit whose shapes are its joints, or the detector's landmarks.

    They are those of which more are among `names`. Where a fit lifted a detector's
    landmarks with a dictionary of joints, its result has both.
    """
    if results.input_landmark_names is None or results.input_shapes is None:
        return results
    detected = results.input_landmark_names
    common_detected = set(detected) & set(names)
    common_joints = set(results.landmark_names) & set(names)
    if len(common_detected) <= len(common_joints):
        return results
    return replace(
        results.without(BY_JOINT),
        shapes=results.input_shapes,
        shape_sd=results.input_shape_sd,
        shape_correlation=results.input_shape_correlation,
        landmark_names=detected,
    )
