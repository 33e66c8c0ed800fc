"""`fit` on arrays: the pipeline of the command, with the same numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from shapefit.api.arguments import (
    Automatic,
    BodyMeasure,
    Camera,
    Direction,
    File,
    Method,
    Outliers,
    Prior,
    Save,
    config_of,
    with_suggestions,
)
from shapefit.api.dictionary import Dictionary
from shapefit.api.files import read_dictionary
from shapefit.api.messages import show_progress, unnamed_error, warn, with_names
from shapefit.api.steps import run_to_end
from shapefit.arrays import Floats
from shapefit.config.commands.fit import FitConfig
from shapefit.dictionary import model
from shapefit.errors import input_error
from shapefit.geometry.pinhole import CAMERA_MATRIX
from shapefit.io.dictionaries import check_dictionary_in_memory
from shapefit.io.options import input_options
from shapefit.io.readers.arrays import poses_from_array
from shapefit.io.readers.items import poses_to_landmarks
from shapefit.io.source import hide_below, source_of
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
from shapefit.pipelines.result import Counted, merge_warnings
from shapefit.records import Fit, Landmarks, concatenate

FILES = {
    "landmarks": (Path("landmarks"),),
    "dictionary": Path("dictionary"),
    "output": Path("result"),
}
"""Keys of the command whose place arrays take, and what stands for them in messages."""


@with_suggestions
def fit(
    landmarks: Landmarks | ArrayLike,
    dictionary: Dictionary | File = "people",
    lam: float | Automatic | None = None,
    weights: ArrayLike | None = None,
    method: Method | None = None,
    camera: Camera | ArrayLike | None = None,
    *,
    config: File | None = None,
    progress: bool = False,
    keypoints: str | None = None,
    rename: Mapping[str, str] | None = None,
    min_confidence: float | Automatic | None = None,
    y_axis: Direction | None = None,
    image_size: tuple[float, float] | None = None,
    frame_rate: float | None = None,
    height: float | None = None,
    noise: float | None = None,
    outliers: Outliers | None = None,
    outlier_threshold: float | None = None,
    tolerance: float | Automatic | None = None,
    prior: Prior | None = None,
    skeleton: Mapping[BodyMeasure, float] | Automatic | None = None,
    leave_one_out: str | None = None,
    starts: int | None = None,
    signed: bool | None = None,
    save: Save | None = None,
    threads: int | None = None,
) -> Fit:
    """Lift 2D landmarks to 3D shapes, as the command `fit` does, bit for bit.

    What is not given is as in the config, or as the command chooses it.

    Parameters
    ----------
    landmarks : Landmarks, or array of shape (n, p, 2), (n, p, 3), (p, 2) or (p, 3)
        NaN where a landmark is hidden; a third number is a confidence. Arrays have the
        landmarks of the dictionary in its order (of "people" the first 15), or those of
        the skeleton `keypoints`; with it, they are the frames of one sequence.
    dictionary : Dictionary, path or str
        One that was read or learned, a file, or the name of an installed one.
    lam : float or "auto"
        Weight of the sum of spectral norms; the key `lambda`.
    weights : array of shape (n, p)
        Weights of the landmarks in place of a confidence, 0 where hidden.
    method : str
        How to lift; by default as the dictionary and the images suggest.
    camera : Camera, or array of shape (3, 3) or (n, 3, 3)
        The section `camera`, or matrices of a perspective camera.
    config : path or str
        YAML file, or the name of an installed config.
    progress : bool
        Show a progress bar.
    keypoints : str
        Skeleton that names the landmarks of an array, such as "coco_17".
    rename : mapping of str to str
        Landmarks to rename: given name -> name in the dictionary.
    min_confidence : float or "auto"
        Hide less confident landmarks.
    y_axis : "down" or "up"
        Direction of y in the images.
    image_size : (width, height)
        Size of the images in pixels.
    frame_rate : float
        Frames per second.
    height : float
        Height of the body in metres.
    noise : float
        Standard deviation of a landmark in pixels.
    outliers : str
        What becomes of wrong landmarks, without a prior.
    outlier_threshold : float
        Residual beyond which a landmark is an outlier.
    tolerance : float or "auto"
        Relative duality gap of a solved image.
    prior : Prior
        How landmarks are weighed against the prior.
    skeleton : mapping or "auto"
        Factors on a detector's head, hips and shoulders.
    leave_one_out : str
        Dataset with the training shape that the fit of an image must not use.
    starts : int
        Views from which alternate and mean-shape begin.
    signed : bool
        Whether coefficients may be negative, for methods that alternate.
    save : Save
        What the fit holds besides the shapes.
    threads : int
        Threads to solve with; 0 is one per core.

    Returns
    -------
    Fit
        Images without a shape are NaN, and `failures` says why.

    Raises
    ------
    InputError
        For every wrong argument at once, with what to give instead.

    Warns
    -----
    UserWarning
        For what the command warns of.

    Examples
    --------
    >>> fit = shapefit.fit(keypoints, keypoints="body_25", frame_rate=25)
    >>> fit.shapes.shape
    (36, 21, 3)

    """
    section, matrices = _split_camera(camera)
    given = {
        "lambda": lam,
        "method": method,
        "camera": section,
        "keypoints": keypoints,
        "rename": rename,
        "min_confidence": min_confidence,
        "y_axis": y_axis,
        "image_size": image_size,
        "frame_rate": frame_rate,
        "height": height,
        "noise": noise,
        "outliers": outliers,
        "outlier_threshold": outlier_threshold,
        "tolerance": tolerance,
        "prior": prior,
        "skeleton": skeleton,
        "leave_one_out": leave_one_out,
        "starts": starts,
        "signed": signed,
        "save": save,
        "threads": threads,
    }
    checked = config_of("fit", FitConfig, given, FILES, config)
    atoms = _internal_dictionary(dictionary)
    images = _as_images(landmarks, checked, atoms.drop_unmarked(()).landmark_names)
    if weights is not None:
        images = replace(images, confidence=np.asarray(weights))
    if matrices is not None:
        images = _with_camera_matrices(images, matrices)
    return _lift(images, atoms, checked, progress=progress)


def _split_camera(
    camera: Camera | ArrayLike | None,
) -> tuple[Camera | None, Floats | None]:
    """Split the argument `camera` into a section of the config and camera matrices."""
    if camera is None:
        return None, None
    given = {**camera} if isinstance(camera, Mapping) else {"focal": camera}
    section = cast("Camera", given)
    focal = np.asarray(section.get("focal"), object)
    if focal.ndim < 2:
        return section, None
    section["focal"] = "files"
    return section, focal.astype(np.float64)


def _with_camera_matrices(images: Landmarks, matrices: Floats) -> Landmarks:
    """Return images with a camera matrix (3, 3) of all, or with one each (n, 3, 3)."""
    if matrices.ndim == 2:
        return images.with_file_extras({CAMERA_MATRIX: matrices})
    return images.with_extras({CAMERA_MATRIX: matrices})


def _internal_dictionary(dictionary: Dictionary | File) -> model.Dictionary:
    """Return the internal form of a Dictionary, of a file or of an installed one.

    Raises InputError for what is none of these, and for one that no fit can use.
    """
    if not isinstance(dictionary, Dictionary | str | PathLike):
        shape = f" {np.shape(dictionary)}" if np.shape(dictionary) else ""
        fault = f"is no dictionary, but {type(dictionary).__name__}{shape}"
        fix = (
            "for arrays there is solve(W, B, lam); Dictionary(atoms=B) takes atoms (k,"
            " p, 3)"
        )
        raise input_error("dictionary", fault, fix)
    if not isinstance(dictionary, Dictionary):
        dictionary = read_dictionary(dictionary)
    internal = dictionary.model()
    check_dictionary_in_memory(internal, "dictionary")
    return internal


def _as_images(
    landmarks: Landmarks | ArrayLike, config: FitConfig, names: Sequence[str]
) -> Landmarks:
    """Return an array or Landmarks as Landmarks; unnamed ones are called `names` (p).

    Raises InputError for what is no array of numbers, and where landmarks without names
    are not as many as the names.
    """
    if not isinstance(landmarks, Landmarks):
        return _landmarks_of_array(landmarks, config, names)
    if config.y_axis not in (None, landmarks.y_axis):
        fault = f"y points {config.y_axis}, and {landmarks.y_axis} in the landmarks"
        fix = f"say it of these: landmarks.replaced(y_axis={config.y_axis!r})"
        raise input_error("fit.y_axis", fault, fix)
    if config.min_confidence:
        landmarks = hide_below(landmarks, config.min_confidence)
    return with_names(landmarks, names).with_whole_points()


def _landmarks_of_array(
    array: ArrayLike, config: FitConfig, names: Sequence[str]
) -> Landmarks:
    """Return an array (n, p, 2 or 3) or (p, 2 or 3) as Landmarks, as the config says.

    Those with confidences, of a skeleton or of one image are read as a detector's file
    is. Raises InputError as `_as_images`.
    """
    if isinstance(array, str | PathLike):
        fix = f"read it: shapefit.read_landmarks({str(array)!r}, track='nearest')"
        raise input_error("landmarks", "is the name of a file", fix)
    try:
        points = np.asarray(array, np.float64)
    except (TypeError, ValueError):
        fix = "give (n, p, 2), or (n, p, 3) with a confidence of 0 to 1"
        raise input_error("landmarks", "is no array of numbers", fix) from None
    of_detector = points.ndim == 2 or (points.ndim == 3 and points.shape[2] == 3)
    if of_detector and config.keypoints is None and points.shape[-2] != len(names):
        raise unnamed_error("landmarks", points.shape[-2], names)
    if not of_detector and config.keypoints is None:
        plain = Landmarks(points, y_axis=config.y_axis or "down")
        return with_names(plain, names).with_whole_points()
    place = Path("landmarks")
    if config.keypoints is None:
        poses = poses_from_array(place, points, landmark_names=tuple(names))
    else:
        poses = poses_from_array(place, points)
    images, notes = poses_to_landmarks(poses, input_options(config))
    warn(f"landmarks: {note}" for note in notes)
    return images


def _lift(
    images: Landmarks,
    dictionary: model.Dictionary,
    config: FitConfig,
    *,
    progress: bool,
) -> Fit:
    """Return the fit of images, as the command makes it of a file that holds them."""
    config, _ = choose_method(config, dictionary, lambda: are_long(images.sequences))
    records: list[Fit] = []
    failures: dict[str, str] = {}
    messages: dict[str, str | Counted] = {}
    tally = Tally()
    with source_of(images, "landmarks", config.rename) as source:
        match = match_to_dictionary(config, dictionary, source.head.landmark_names)
        sample = source.first(SAMPLE_POOL)
        steps = calibrate(config, match, sample, source.count)
        calibration, announced = run_to_end(steps)
        warn(result.line for result in announced)
        plan = plan_fit(config, match, calibration)
        of_dictionary = warn_of_dictionary(plan.config, match.dictionary)
        merge_warnings(messages, (*calibration.warnings, *of_dictionary))
        batches = show_progress(
            lift_all(source, plan),
            lambda batch: batch.event,
            wanted=progress,
            unit="image",
            total=source.count,
        )
        for batch in batches:
            tally.add(batch.record)
            records.append(batch.record)
            event = batch.event
            for failure in event.failures:
                failures[failure.item] = failure.reason
            merge_warnings(messages, event.warnings)
    of_all = warn_of_all(tally, plan, source.head)
    warn((*messages.values(), *match.warnings(), *of_all))
    whole = concatenate(records)
    attributes = {**whole.attributes, **provenance(plan, {})}
    return replace(whole, attributes=attributes, failures=failures)
