"""Files to arrays and back, with one landmark per row."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Literal, TypedDict, Unpack

from shapefit import io
from shapefit.api.arguments import Direction, File, unknown_arguments
from shapefit.api.dictionary import Dictionary
from shapefit.api.messages import warn
from shapefit.config.paths import find_dictionaries
from shapefit.errors import input_error
from shapefit.io.options import InputOptions
from shapefit.io.source import Source
from shapefit.records import Fit, Landmarks, Record, Shapes


class Reading(TypedDict, total=False):
    """Options of reading files; without any, files are read as they are.

    Attributes
    ----------
    format : str
        Format of the files; by default recognised by their content.
    keypoints : str
        Skeleton of files without names, such as "body_25".
    individual : str
        Read this individual alone.
    track : "nearest", "motion" or "none"
        How detections without identity are joined over frames.
    min_confidence : float
        Hide less confident landmarks.
    rename : mapping of str to str
        Landmarks to rename: name in the files -> new name.
    image_size : (width, height)
        Size of the images in pixels.
    y_axis : "down" or "up"
        Direction of y in the images.
    landmarks : tuple of str
        Landmarks to keep, in this order, by their new names.
    frames : (first, before the last)
        Frames to read; None is open.
    every : int
        Take every n-th of these frames.

    """

    format: str
    keypoints: str | None
    individual: str | None
    track: Literal["nearest", "motion", "none"]
    min_confidence: float
    rename: Mapping[str, str]
    image_size: tuple[float, float] | None
    y_axis: Direction | None
    landmarks: tuple[str, ...] | None
    frames: tuple[int | None, int | None]
    every: int


def read_shapes(*paths: File, **options: Unpack[Reading]) -> Shapes:
    """Read files of 3D shapes, in any format of `learn-dict`, as one set.

    Shapes that lack a landmark are left out.

    Parameters
    ----------
    *paths : path
        Files, or folders with one file per frame.
    **options : Reading
        How files are read, such as `rename={"LHip": "lhip"}`.

    Returns
    -------
    Shapes

    Raises
    ------
    InputError
        For files that cannot be read, and for unknown options.

    """
    how = _reading_options("read_shapes", options)
    return _read_whole(io.open_shapes([Path(path) for path in paths], how))


def read_landmarks(*paths: File, **options: Unpack[Reading]) -> Landmarks:
    """Read files of 2D landmarks, in any format of `fit`, as one set.

    Parameters
    ----------
    *paths : path
        Files, or folders with one file per frame.
    **options : Reading
        How files are read, such as `keypoints="body_25"`; `track="nearest"` joins
        detections over frames.

    Returns
    -------
    Landmarks

    Raises
    ------
    InputError
        For files that cannot be read, and for unknown options.

    """
    how = _reading_options("read_landmarks", options)
    return _read_whole(io.open_landmarks([Path(path) for path in paths], how))


def read_dictionary(path: File) -> Dictionary:
    """Read a dictionary from a file, or an installed one by its name.

    Parameters
    ----------
    path : path or str
        A file, or the name of an installed one, such as "people".

    Returns
    -------
    Dictionary

    """
    file = Path(path)
    installed = find_dictionaries()
    if not file.is_file():
        file = installed.get(str(path), file)
    if not file.exists():
        near = get_close_matches(str(path), installed, n=1)
        hint = f"did you mean `{near[0]}`?" if near else "correct the path"
        fix = f"{hint} Installed are: {', '.join(installed)}"
        raise input_error(file, "there is no such dictionary", fix)
    return Dictionary.of(io.read_dictionary(file))


def read_results(path: File) -> Fit:
    """Read a result of `fit`.

    Parameters
    ----------
    path : path
        HDF5 or CSV.

    Returns
    -------
    Fit
        Its certificate stays in the file, for `shapefit verify`.

    """
    return io.read_results(Path(path))


def write_shapes(path: File, shapes: Shapes) -> None:
    """Write shapes.

    Parameters
    ----------
    path : path
        HDF5, or CSV where the name ends in .csv.
    shapes : Shapes
        What is written.

    """
    io.write_shapes(Path(path), shapes.named())


def write_landmarks(path: File, landmarks: Landmarks) -> None:
    """Write landmarks.

    Parameters
    ----------
    path : path
        HDF5, or CSV where the name ends in .csv.
    landmarks : Landmarks
        What is written.

    """
    with io.landmark_writer(Path(path)) as writer:
        writer.append(landmarks.named().with_whole_points())


def write_dictionary(path: File, dictionary: Dictionary) -> None:
    """Write a dictionary to HDF5.

    Parameters
    ----------
    path : path
        File to write.
    dictionary : Dictionary
        What is written.

    """
    io.write_dictionary(Path(path), dictionary.model())


def write_results(path: File, result: Fit) -> None:
    """Write a fit as `fit -o` does.

    Parameters
    ----------
    path : path
        HDF5, or the format that the name ends in, such as .trc.
    result : Fit
        What is written.

    Warns
    -----
    UserWarning
        For what the command warns of, such as frames without a shape.

    """
    with io.result_writer(Path(path)) as writer:
        writer.append(result.named())
    warn(writer.summary.warnings)


def _read_whole(opened: Source[Record]) -> Record:
    """Return all items of an open source, and warn of what was left out."""
    with opened as source:
        warn(source.notes)
        return source.whole()


def _reading_options(function: str, options: Reading) -> InputOptions:
    """Return options to read files by; raises InputError for unknown ones."""
    known = vars(InputOptions())
    unknown = [key for key in options if key not in known]
    if unknown:
        raise unknown_arguments(function, unknown, known)
    return InputOptions(**options)
