"""Files to arrays and back, with one landmark per row."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from shapefit import io
from shapefit.api.dictionary import Dictionary
from shapefit.api.messages import warn
from shapefit.config.paths import find_dictionaries
from shapefit.errors import input_error, listed
from shapefit.io.options import InputOptions
from shapefit.records import Fit, Landmarks, Shapes

File = str | PathLike[str]


def read_shapes(*paths: File, **options: Any) -> Shapes:
    """Read files of 3D shapes, in any format of `learn-dict`, as one set.

    Shapes that lack a landmark are left out. options say how files are read, with the
    names of the config keys, such as `rename={"LHip": "lhip"}`. Raises InputError.
    """
    with io.open_shapes([Path(path) for path in paths], _input(options)) as source:
        warn(source.notes)
        return source.whole()


def read_landmarks(*paths: File, **options: Any) -> Landmarks:
    """Read files of 2D landmarks, in any format of `fit`, as one set.

    options say how files are read, with the names of the config keys, such as
    `keypoints="body_25"`; `track="nearest"` joins detections over frames. Raises
    InputError.
    """
    with io.open_landmarks([Path(path) for path in paths], _input(options)) as source:
        warn(source.notes)
        return source.whole()


def read_dictionary(path: File) -> Dictionary:
    """Read a dictionary: a file, or the installed one of that name, such as
    "people".
    """
    file = Path(path)
    if not file.is_file():
        file = find_dictionaries().get(str(path), file)
    return Dictionary.of(io.read_dictionary(file))


def read_results(path: File) -> Fit:
    """Read a result; the certificate stays in the file, for `shapefit verify`."""
    return io.read_results(Path(path))


def write_shapes(path: File, shapes: Shapes) -> None:
    """Write shapes to HDF5, or to CSV where the name ends in .csv."""
    io.write_shapes(Path(path), shapes.named())


def write_landmarks(path: File, landmarks: Landmarks) -> None:
    """Write landmarks to HDF5, or to CSV where the name ends in .csv."""
    with io.landmark_writer(Path(path)) as writer:
        writer.append(landmarks.named().with_whole_points())


def write_dictionary(path: File, dictionary: Dictionary) -> None:
    """Write a dictionary to HDF5."""
    io.write_dictionary(Path(path), dictionary.model())


def write_results(path: File, result: Fit) -> None:
    """Write a fit as `fit -o` does: HDF5, or the format that the name ends in, such as
    .trc.
    """
    with io.result_writer(Path(path)) as writer:
        writer.append(result.named())


def _input(options: Mapping[str, Any]) -> InputOptions:
    """Return how files are read; raises InputError for other options."""
    keys = vars(InputOptions())
    for key in options.keys() - keys.keys():
        raise input_error(key, "does not say how files are read", f"use {listed(keys)}")
    return InputOptions(**options)
