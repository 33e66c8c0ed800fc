"""Landmarks to 3D shapes, as the command `fit`."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shapefit.config import FitConfig
from shapefit.errors import input_error
from shapefit.face.files import read_dictionary
from shapefit.face.options import config_of, plain
from shapefit.face.records import (
    Dictionary,
    Fit,
    Landmarks,
    Names,
    dictionary_model,
    fit_of,
    landmark_set,
)
from shapefit.io.dictionaries import check_given_dictionary
from shapefit.io.foreign.arrays import of_array
from shapefit.io.foreign.items import landmarks_of
from shapefit.io.options import InputOptions, Track, input_options
from shapefit.io.records import LandmarkSet, concatenate
from shapefit.io.source import source_of
from shapefit.pipelines.fit.prepare import (
    FIRST,
    Default,
    are_long,
    choose_by_dictionary,
    fits,
    prepare,
    set_up,
    warn_of_dictionary,
)
from shapefit.pipelines.fit.report import Report
from shapefit.pipelines.fit.run import attributes_of, lift_source
from shapefit.pipelines.joints import name_warnings
from shapefit.pipelines.outcome import Counted, Note, add_up

PLACE = Path("landmarks")
WANTED = "give (n, p, 2) or (n, p, 3) with a confidence of 0 to 1, or a list of (people, p, 2 or 3)"

CAMERA = "camera_matrix"
"""Dataset that holds the matrices given as `camera`."""

FILES = {
    "landmarks": (Path("landmarks"),),
    "dictionary": Path("dictionary"),
    "output": Path("result"),
}
"""What stands for the files of the command in messages."""


def fit(
    landmarks: Landmarks | ArrayLike | Sequence[ArrayLike],
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
    """Lift 2D landmarks to 3D shapes; equal bit for bit to what the command `fit` writes.

    landmarks: arrays (n, p, 2), NaN where unseen, or (n, p, 3) with a confidence; (p, 2) of one
    image; a list of frames (people, p, 2 or 3); or Landmarks with names. Arrays have the landmarks
    of the dictionary in its order (of "people" the first 15), or those of the skeleton that
    `keypoints` names, such as "coco_17". dictionary: one that was read or learned, a file, or an
    installed one, such as "people". weights (n, p) >= 0, 0 = hidden, in place of a confidence; lam
    and method as `lambda` and `method` of the command. camera: matrices (3, 3) or (n, 3, 3) for a
    refinement under perspective, or the section `camera` of the command, where `intrinsics` may be
    such matrices.
    config: a YAML file or an installed config; by default that which suits the dictionary. A
    dictionary that suits none and has a prior is fitted by it: method "posterior", or "sequences".
    options are further keys of the command, sections as mappings, such as
    `outliers={"method": "ransac"}` (docs/config.md). Images without a shape are in `failures` of
    the result; what the command warns of is a Python warning. Raises InputError.
    """
    if not isinstance(dictionary, Dictionary):
        dictionary = read_dictionary(dictionary)
    atoms = dictionary_model(dictionary)
    check_given_dictionary(atoms, "dictionary")
    section, matrices = _camera(camera)
    given = {"lambda": lam, "method": method, "camera": section, "keypoints": keypoints}
    given = {key: value for key, value in given.items() if value is not None}

    def reading(track: Track) -> InputOptions:
        config = config_of(FitConfig, "fit", given, options, FILES, final=False)
        return input_options(config.input, track)

    names = atoms.marked(()).landmark_names
    images = _with_weights(_images(landmarks, keypoints, names, reading), weights)
    if config is None:
        default = choose_by_dictionary(
            atoms.provenance,
            method,
            lambda: are_long(images.sequences),
            prior=atoms.prior is not None,
        )
        config = default.config
    else:
        default = Default()
    wanted = config_of(FitConfig, "fit", given, options, FILES, config)
    if default.method is not None and fits(default, wanted):
        given["method"] = default.method
        wanted = config_of(FitConfig, "fit", given, options, FILES, config)
    if matrices is not None:
        images = images.with_columns({CAMERA: matrices})
    records, seconds = [], 0.0
    failures: dict[str, str] = {}
    with source_of(images, "landmarks", wanted.input.rename) as source:
        estimates = prepare(wanted, atoms, lambda: source.first(FIRST))
        setup = set_up(estimates.apply(wanted), atoms, source.head.landmark_names)
        report = Report(setup)
        of_dictionary = warn_of_dictionary(setup.config, setup.dictionary)
        messages: dict[str, str | Counted] = {
            text: text for text in (*estimates.warnings, *of_dictionary)
        }
        doubts = name_warnings(source.head.landmark_names, setup.dictionary.landmark_names)
        for batch in lift_source(source, setup):
            outcome = report.add(batch.images, batch.lifting, batch.record)
            records.append(batch.record)
            seconds += batch.seconds
            failures |= {failure.item: failure.reason for failure in outcome.failures}
            add_up(messages, outcome.warnings)
    for message in (*messages.values(), *doubts, *report.warnings):
        if not isinstance(message, Note):
            warnings.warn(str(message), stacklevel=2)
    whole = concatenate(records)
    attributes = attributes_of(setup, estimates, {}, seconds, len(whole))
    return fit_of(whole.replaced(attributes=attributes), failures)


def _images(
    landmarks: Any, keypoints: str | None, names: Names, reading: Callable[[Track], InputOptions]
) -> LandmarkSet:
    """Return landmarks as the package has them, with these names (p) where they have none.

    Arrays with confidences, of a skeleton, of one image or of several people are read as files of a
    detector are. Raises InputError for arrays of other shapes.
    """
    if isinstance(landmarks, Landmarks):
        return landmark_set(landmarks, names)
    crowd = isinstance(landmarks, list) and any(np.ndim(frame) == 3 for frame in landmarks)
    points, further = in_one_array(landmarks) if crowd else (_array(landmarks), {})
    with_confidence = points.ndim == 3 and points.shape[2] == 3
    if not (crowd or keypoints is not None or points.ndim == 2 or with_confidence):
        return landmark_set(points, names)
    options = reading("nearest" if crowd else "none")
    if options.keypoints is None:
        if points.shape[-2] != len(names):
            found = f"has {points.shape[-2]} landmarks without names, not {len(names)}"
            raise input_error("landmarks", found, 'name them, as in `keypoints="coco_17"`')
        further |= {"landmark_names": tuple(names)}
    return landmarks_of(of_array(PLACE, points, **further), options)[0]


def in_one_array(frames: Sequence[ArrayLike]) -> tuple[NDArray[Any], dict[str, Any]]:
    """Return frames (people, p, 2 or 3), with any number of people each, as one array.

    Beside it stands of which frame each is. Raises InputError where they differ in their landmarks.
    """
    arrays = [_array(frame) for frame in frames]
    whole = [array for array in arrays if array.size]
    if len({array.shape[1:] for array in whole}) != 1 or whole[0].ndim != 3:
        raise input_error("landmarks", "frames that differ in their landmarks", WANTED)
    people = [len(array) if array.size else 0 for array in arrays]
    frame = np.repeat(np.arange(len(arrays)), people)
    labels = [str(number) for number in frame]
    return np.concatenate(whole), {"frames": frame.tolist(), "labels": labels, "images": True}


def _array(landmarks: ArrayLike) -> NDArray[Any]:
    try:
        return np.asarray(landmarks, np.float64)
    except (TypeError, ValueError):
        raise input_error("landmarks", "is no array of numbers", WANTED) from None


def _camera(
    camera: Mapping[str, Any] | ArrayLike | None,
) -> tuple[dict[str, Any] | None, np.ndarray[Any, Any] | None]:
    """Return the section `camera` of the config, and matrices that it names."""
    if camera is None:
        return None, None
    section = dict(camera) if isinstance(camera, Mapping) else {"intrinsics": camera}
    section.setdefault("model", "perspective")
    matrices = section.get("intrinsics")
    if matrices is None or isinstance(matrices, str):
        return plain(section), None
    return plain(section | {"intrinsics": CAMERA}), np.asarray(matrices)


def _with_weights(images: LandmarkSet, weights: ArrayLike | None) -> LandmarkSet:
    if weights is None:
        return images
    values = np.asarray(weights, dtype=np.float64)
    expected = (len(images), len(images.landmark_names))
    if values.shape != expected:
        raise input_error("weights", f"has the shape {values.shape}", f"it must be {expected}")
    return images.replaced(confidence=values)
