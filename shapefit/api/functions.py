"""`fit`, `learn` and `evaluate`: the pipelines of the commands, on arrays.

Keyword arguments are checked against the config of the command: same keys, defaults and
errors.
"""

from __future__ import annotations

import json
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shapefit.api.dictionary import Dictionary
from shapefit.api.files import read_dictionary
from shapefit.api.messages import unnamed, warn, with_names
from shapefit.config import FitConfig, load_config
from shapefit.dictionary import model
from shapefit.errors import counted, input_error
from shapefit.evaluation.report import ErrorSummary, group_sequences, summarise_errors
from shapefit.geometry.pinhole import CAMERA_MATRIX
from shapefit.io.dictionaries import check_given_dictionary
from shapefit.io.options import input_options
from shapefit.io.readers.arrays import of_array
from shapefit.io.readers.items import landmarks_of
from shapefit.io.source import source_of
from shapefit.pipelines.evaluate.measure import measure
from shapefit.pipelines.fit.calibration import SAMPLE_POOL, calibrate
from shapefit.pipelines.fit.choices import (
    are_long,
    choose_method,
    match_to_dictionary,
    warn_of_dictionary,
)
from shapefit.pipelines.fit.fit import lift_all, plan_fit
from shapefit.pipelines.fit.record import provenance
from shapefit.pipelines.fit.summary import Tally, warn_of_all
from shapefit.pipelines.learn_dict.from_3d import learn_from_shapes
from shapefit.pipelines.result import Counted, Result, merge_warnings
from shapefit.records import Fit, Landmarks, Shapes, concatenate

Made = TypeVar("Made")

FILES: Mapping[str, Mapping[str, Any]] = {
    "fit": {
        "landmarks": (Path("landmarks"),),
        "dictionary": Path("dictionary"),
        "output": Path("result"),
    },
    "learn-dict": {"shapes": (Path("shapes"),), "output": Path("dictionary")},
    "eval": {
        "results": {"result": (Path("result"),)},
        "truth": (Path("truth"),),
        "output": Path("report"),
    },
}
"""Keys of the commands whose place arrays take, and what stands for the files in
messages.
"""

FUNCTIONS = {"fit": "fit", "learn-dict": "learn", "eval": "evaluate"}

BARS = ("shape_sd", "shape_correlation", "shape_covariance", "p_value")
"""What the calibration of a report judges beside the errors."""


def fit(
    landmarks: Landmarks | ArrayLike,
    dictionary: Dictionary | str | PathLike[str],
    lam: float | Literal["auto"] | None = None,
    weights: ArrayLike | None = None,
    method: str | None = None,
    camera: Mapping[str, Any] | ArrayLike | None = None,
    *,
    config: str | PathLike[str] | None = None,
    keypoints: str | None = None,
    **options: Any,
) -> Fit:
    """Lift 2D landmarks to 3D shapes; equal bit for bit to what the command `fit`
    writes.

    landmarks: arrays (n, p, 2), NaN where unseen, or (n, p, 3) with a confidence; (p,
    2) of one image; or Landmarks with names. Arrays have the landmarks of the
    dictionary in its order (of "people" the first 15), or those of the skeleton that
    `keypoints` names, such as "coco_17". dictionary: one that was read or learned, a
    file, or an installed one, such as "people". weights (n, p) >= 0, 0 = hidden, in
    place of a confidence; lam and method as `lambda` and `method` of the command.
    camera: matrices (3, 3) or (n, 3, 3) for a perspective camera, or the section
    `camera` of the command, where `focal` may be such matrices. config: a YAML file,
    read as the command reads it, or the name of an installed one. options are further
    keys of the command, sections as mappings, such as `prior={"scale": 2}`
    (docs/config.md). Images without a shape are in `failures` of the result; what the
    command warns of is a Python warning. Raises InputError.
    """
    section: Any = {} if camera is None else camera
    section = dict(section) if isinstance(section, Mapping) else {"focal": section}
    matrices = section.get("focal") if np.ndim(section.get("focal")) >= 2 else None
    section |= {} if matrices is None else {"focal": "files"}
    given = {
        "lambda": lam,
        "method": method,
        "camera": section or None,
        "keypoints": keypoints,
    }
    read: FitConfig = config_of("fit", given | options, config)
    atoms = _dictionary(dictionary)
    images = _as_images(landmarks, read, atoms.marked(()).landmark_names)
    if weights is not None:
        images = replace(images, confidence=np.asarray(weights))
    if matrices is not None:
        images = _with_matrices(images, np.asarray(matrices))
    wanted, _ = choose_method(read, atoms, lambda: are_long(images.sequences))
    records = []
    failures: dict[str, str] = {}
    messages: dict[str, str | Counted] = {}
    tally = Tally()
    with source_of(images, "landmarks", wanted.rename) as source:
        match = match_to_dictionary(wanted, atoms, source.head.landmark_names)
        sample = source.first(SAMPLE_POOL)
        steps = calibrate(wanted, match, sample, source.count)
        calibration, announced = _run_to_end(steps)
        warn(result.line for result in announced)
        plan = plan_fit(wanted, match, calibration)
        of_dictionary = warn_of_dictionary(plan.config, match.dictionary)
        merge_warnings(messages, (*calibration.warnings, *of_dictionary))
        for batch in lift_all(source, plan):
            tally.add(batch.record)
            records.append(batch.record)
            for failure in batch.event.failures:
                failures[failure.item] = failure.reason
            merge_warnings(messages, batch.event.warnings)
    of_all = warn_of_all(tally, plan, source.head)
    warn((*messages.values(), *match.warnings(), *of_all))
    whole = concatenate(records)
    attributes = {**whole.attributes, **provenance(plan, {})}
    return replace(whole, attributes=attributes, failures=failures)


def _with_matrices(images: Landmarks, matrices: NDArray[Any]) -> Landmarks:
    """Return images with a camera matrix (3, 3) of all, or one of each (n, 3, 3)."""
    if matrices.ndim == 2:
        return images.with_file_extras({CAMERA_MATRIX: matrices})
    return images.with_extras({CAMERA_MATRIX: matrices})


def _dictionary(given: Dictionary | str | PathLike[str]) -> model.Dictionary:
    """Return the internal Dictionary of one that is given, or of a name or file.

    Raises InputError for what is none of these, and for one that no fit can use.
    """
    if not isinstance(given, Dictionary | str | PathLike):
        shape = f" {np.shape(given)}" if np.shape(given) else ""
        fault = f"is no dictionary, but {type(given).__name__}{shape}"
        fix = (
            "for arrays there is solve(W, B, lam); Dictionary(atoms=B) takes atoms (k,"
            " p, 3)"
        )
        raise input_error("dictionary", fault, fix)
    atoms = (given if isinstance(given, Dictionary) else read_dictionary(given)).model()
    check_given_dictionary(atoms, "dictionary")
    return atoms


def _as_images(
    landmarks: Landmarks | ArrayLike, config: FitConfig, names: Sequence[str]
) -> Landmarks:
    """Return arrays as Landmarks with these names (p) of landmarks; Landmarks stay.

    Names of their own stay too. Arrays with confidences, of a skeleton or of one image
    are read as a detector's file is: by `y_axis`, `min_confidence` and `image_size` of
    the config. Raises InputError for what is no array of numbers, and where landmarks
    without names are not as many as the names.
    """
    if not isinstance(landmarks, Landmarks):
        try:
            points = np.asarray(landmarks, np.float64)
        except (TypeError, ValueError):
            fix = "give (n, p, 2), or (n, p, 3) with a confidence of 0 to 1"
            raise input_error("landmarks", "is no array of numbers", fix) from None
        of_detector = points.ndim == 2 or (points.ndim == 3 and points.shape[2] == 3)
        if of_detector and config.keypoints is None and points.shape[-2] != len(names):
            raise unnamed("landmarks", points.shape[-2], names)
        if of_detector or config.keypoints is not None:
            named: dict[str, Any] = (
                {} if config.keypoints else {"landmark_names": tuple(names)}
            )
            poses = of_array(Path("landmarks"), points, **named)
            return landmarks_of(poses, input_options(config))[0]
        landmarks = Landmarks(points)
    return with_names(landmarks, names).with_whole_points()


def learn(
    shapes: Shapes | ArrayLike,
    k: int | None = None,
    beta: float | None = None,
    **options: Any,
) -> Dictionary:
    """Learn a dictionary from 3D shapes; equal bit for bit to what `learn-dict` writes.

    shapes (n, p, 3), or Shapes with names, sequences, edges or a mesh; k, beta and
    options are keys of the command, such as `method="exemplars"` (docs/config.md).
    Shapes that cannot be used, and what else the command warns of, are Python warnings.
    Raises InputError.
    """
    # Other methods do not have these keys: their defaults count as not given.
    coding = {
        key: value for key, value in {"k": k, "beta": beta}.items() if value is not None
    }
    config = config_of("learn-dict", coding | options)
    source = source_of(_shapes(shapes).named(), "shapes", config.rename)
    warn(source.notes)
    training = source.whole()
    made, results = _run_to_end(learn_from_shapes(training, config, {}))
    from shapefit.lifting.posterior.p_value import with_p_value_table

    dictionary = with_p_value_table(made)
    failures = [failure for result in results for failure in result.failures]
    if failures:
        unused = f"{failures[0].item}, for one: {failures[0].reason}"
        warn([f"{counted(len(failures), 'shape')} cannot be used; {unused}"])
    warn(message for result in results for message in result.warnings)
    return Dictionary.of(dictionary)


def _shapes(given: Shapes | Fit | ArrayLike) -> Shapes:
    """Return arrays as Shapes, and a fit as Shapes without its further columns."""
    if isinstance(given, Shapes):
        return given
    if not isinstance(given, Fit):
        return Shapes(np.asarray(given))
    return Shapes(
        given.shapes,
        landmark_names=given.landmark_names,
        items=given.items,
        sequences=given.sequences,
        frames=given.frames,
        times=given.times,
        edges=given.edges,
        unit=given.unit,
        frame_rate=given.frame_rate,
    )


def _run_to_end(steps: Generator[Result, None, Made]) -> tuple[Made, list[Result]]:
    """Run a generator to its end; return what it returns, and all that it yields."""
    results: list[Result] = []
    try:
        while True:
            results.append(next(steps))
    except StopIteration as stop:
        return stop.value, results


@dataclass(frozen=True, repr=False)
class Evaluation:
    """Errors of n images: errors maps a metric and its unit to (n,), nan where it is
    undefined.

    items and sequences (n); summaries as in report.csv: of the group `all`, or of each
    group, and of each sequence; failures maps the images without one or more errors to
    the reason.
    """

    items: tuple[str, ...]
    sequences: tuple[str, ...]
    errors: Mapping[tuple[str, str], NDArray[np.float64]]
    summaries: tuple[ErrorSummary, ...]
    failures: Mapping[str, str]

    def mean(self, metric: str, unit: str | None = None) -> float:
        """Return the mean over the groups' means in a metric, in its first unit if none
        is given.

        Raises ValueError where nothing was measured in it.
        """
        rows = [s for s in self.summaries if s.metric == metric and s.sequence is None]
        rows = [s for s in rows if s.unit == (unit or rows[0].unit)]
        if not rows:
            raise ValueError(
                f"no {metric} was measured" + (f" in {unit}" if unit else "")
            )
        return float(np.mean([row.mean for row in rows]))


def evaluate(
    result: Fit | Shapes | ArrayLike,
    truth: Shapes | ArrayLike,
    metrics: Sequence[str] | None = None,
    match: str | None = None,
    **options: Any,
) -> Evaluation:
    """Compare a fit with the true shapes; errors and sums equal those that `eval`
    writes.

    result: a Fit, or shapes (n, p, 3) from elsewhere; truth (n, p, 3), in the order of
    the images, or Shapes, matched by `match` and landmarks by name; metrics as of the
    command, those that the result lacks the datasets for left out with a warning;
    options are `groups`, `least_visible` and `rename`. Raises InputError.
    """
    if beyond := options.keys() - {"groups", "least_visible", "rename"}:
        fix = "use `groups`, `least_visible` or `rename`, or the command line"
        raise input_error(f"evaluate.{min(beyond)}", "is a key of reports only", fix)
    config = config_of("eval", {"metrics": metrics, "match": match} | options)
    if isinstance(result, Fit):
        estimated = result
    else:
        given = _shapes(result)
        estimated = replace(Fit.of_shapes(given), extras=given.extras)
    true = _shapes(truth)
    numbered = true.landmark_names or estimated.landmark_names
    if numbered:
        true = with_names(true, numbered)
    shapes = source_of(true.named(), "truth", config.rename, gaps=True).whole()
    record = with_names(estimated, shapes.landmark_names).without(BARS)
    if not _shapes(truth).items:
        if len(true) != len(record):
            fault = f"has {len(true)} shapes for {len(record)} images"
            raise input_error(
                "truth", fault, "give one for each, or name them: Shapes(..., items)"
            )
        shapes = replace(shapes, items=record.items)
    measured = measure(Path("result"), record, shapes, config)
    grouping = group_sequences(config.groups, measured.sequences)
    warn(measured.warnings)
    return Evaluation(
        items=measured.items,
        sequences=measured.sequences,
        errors=measured.errors,
        summaries=tuple(
            summarise_errors("result", measured.sequences, measured.errors, grouping)
        ),
        failures=measured.failures,
    )


def config_of(
    command: str, given: Mapping[str, Any], config: str | PathLike[str] | None = None
) -> Any:
    """Return the config that the arguments of a function make, over those of a config
    file.

    Raises InputError for each problem, with the name of its argument.
    """
    prefix = f"{FUNCTIONS[command]}."
    for key in given.keys() & {*FILES[command], "data", "export"}:
        fix = (
            "it is for files: use the command line, or the functions of shapefit that"
            " write"
        )
        raise input_error(f"{prefix}{key}", f"there is no argument `{key}`", fix)
    path = None if config is None else Path(config)
    arguments, placeholders = plain(given), FILES[command]
    return load_config(
        command, path, arguments=arguments, prefix=prefix, placeholders=placeholders
    )


def plain(value: Any) -> Any:
    """Return a value in types of YAML: NumPy's arrays as lists, and paths as texts."""

    def as_text_or_numbers(part: Any) -> Any:
        return part.tolist() if isinstance(part, np.ndarray | np.generic) else str(part)

    return json.loads(json.dumps(value, default=as_text_or_numbers))
