"""C3D, the binary files of marker motion capture, read by ezc3d (the extra `c3d`)."""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import abbreviate, counted, input_error
from shapefit.geometry.normalisation import as_metres
from shapefit.io.foreign.motion_text import unique_names
from shapefit.io.foreign.recording import Recording, all_individuals
from shapefit.io.inputs import check_fits
from shapefit.io.layout import UNKNOWN_UNIT

BLOCK = 512
"""Bytes of a block, in which the format counts."""

INTEL = 84
"""The processor whose numbers are written little end first, as all of today's are."""

MOST_FRAMES = 65535

EXPANDS = 16
"""Times its size that a file takes in memory, at most, while ezc3d reads it."""

COMPUTED = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")
"""Lists of labels under POINT that are no points: what a model computed is stored beside them."""

NOBODY = "unassigned"
"""The individual that has the points without a subject, where there are several subjects."""


def read_c3d(paths: tuple[Path, ...]) -> Recording:
    """Return the markers of a C3D file, in metres where it names its unit.

    A point is missing where its residual is negative or its place NaN. Labels `subject:name` are
    landmarks of an individual. Frames have the numbers that ezc3d gives them, one less than those
    in the header. Raises InputError where ezc3d is not installed or cannot read the file.
    """
    path = paths[0]
    check_whole(path)
    check_fits(str(path), EXPANDS * path.stat().st_size, "what it holds")
    file = _read(path)
    parameters: Mapping[str, Any] = file["parameters"].get("POINT", {})
    points = np.asarray(file["data"]["points"], dtype=np.float64)[:3].transpose(2, 1, 0)
    residual = np.asarray(file["data"]["meta_points"]["residuals"])[0].T
    factor, unit = as_metres(_decoded(_first(parameters, "UNITS", "")))
    points = factor * np.where((residual >= 0)[..., None], points, np.nan)
    labels = _labels(parameters, points.shape[1])
    computed = set().union(*(_texts(parameters, name) for name in COMPUTED))
    markers = [place for place, label in enumerate(labels) if label not in computed]
    notes: tuple[str, ...] = ()
    if len(markers) < len(labels):
        left = [label for label in labels if label in computed]
        text = f"left out, computed by a model, not seen ({abbreviate(left)})"
        notes = (f"{counted(len(left), 'point')} {text}",)
    names, more = unique_names([labels[place] for place in markers])
    individuals, landmarks, rows = by_subject(names)
    if len(points) == MOST_FRAMES:
        notes += (f"has {MOST_FRAMES} frames, as many as its header can count; it may hold more",)
    rate = float(_first(parameters, "RATE", 0.0))
    start = int(file["header"]["points"]["first_frame"])
    n, p, subjects = len(points), len(landmarks), max(len(individuals), 1)

    every = np.full((n, subjects, p, 3), np.nan)
    for marker, (subject, landmark) in zip(markers, rows, strict=True):
        every[:, subject, landmark] = points[:, marker]
    return Recording(
        name=str(path),
        video=path.stem,
        **all_individuals(every, None, [str(start + frame) for frame in range(n)]),
        landmark_names=landmarks,
        individual_names=individuals,
        frame_count=n,
        frame_rate=rate if np.isfinite(rate) and rate > 0 else None,
        unit=unit or UNKNOWN_UNIT,
        notes=notes + more,
    )


def by_subject(
    names: tuple[str, ...],
) -> tuple[tuple[str, ...], tuple[str, ...], list[tuple[int, int]]]:
    """Return individuals, landmarks, and the (individual, landmark) of every name.

    Without a subject in any name there are no individuals; with one, it has all the points.
    """
    parts = [name.rpartition(":") for name in names]
    subjects = list(dict.fromkeys(subject for subject, _, _ in parts if subject))
    if not subjects:
        return (), names, [(0, place) for place in range(len(names))]
    if len(subjects) > 1 and any(not subject for subject, _, _ in parts):
        subjects.append(NOBODY)
    plain = [
        name if subject else whole for whole, (subject, _, name) in zip(names, parts, strict=True)
    ]
    pairs = [subject or subjects[-1] for subject, _, _ in parts]
    if len(set(zip(pairs, plain, strict=True))) < len(names):
        return (), names, [(0, place) for place in range(len(names))]
    landmarks = tuple(dict.fromkeys(plain))
    place = {name: number for number, name in enumerate(landmarks)}
    rows = [
        (subjects.index(subject), place[name]) for subject, name in zip(pairs, plain, strict=True)
    ]
    return tuple(subjects), landmarks, rows


def check_whole(path: Path) -> None:
    """Raise InputError for a file shorter than its own header says, which ezc3d may not survive."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(BLOCK)
        points, analog, first, last = struct.unpack("<HHHH", head[2:10])
        scale, start = struct.unpack("<fH", head[12:18])
        file.seek(BLOCK * (head[0] - 1))
        section = file.read(4)
    if len(section) < 4:
        raise input_error(path, "is cut off before its parameters", "give a whole C3D file")
    if section[3] != INTEL:
        return
    number_bytes = 4 if scale < 0 else 2
    frames = max(last - first + 1, 0)
    needed = BLOCK * max(start - 1, 0) + frames * (4 * points + analog) * number_bytes
    if size < needed:
        found = f"has {size} bytes, and its header announces {needed}"
        raise input_error(path, found, "give a whole C3D file")


def _read(path: Path) -> Any:
    try:
        ezc3d = import_module("ezc3d")
    except ImportError as error:
        found = "is a C3D file, which ezc3d reads, and that is not installed"
        raise input_error(path, found, "run `pip install ezc3d`") from error
    try:
        return ezc3d.c3d(os.fspath(path))
    except MemoryError:
        raise
    except Exception as error:  # ezc3d has many kinds of error for damaged files
        found = f"cannot be read by ezc3d ({error})"
        raise input_error(path, found, "give a whole C3D file") from error


def _labels(parameters: Mapping[str, Any], count: int) -> list[str]:
    """Return the labels of all points; LABELS2 and so on continue LABELS beyond 255."""
    labels = _texts(parameters, "LABELS")
    more = 2
    while len(labels) < count and f"LABELS{more}" in parameters:
        labels += _texts(parameters, f"LABELS{more}")
        more += 1
    return (labels + [""] * count)[:count]


def _texts(parameters: Mapping[str, Any], name: str) -> list[str]:
    return [_decoded(text).strip() for text in parameters.get(name, {}).get("value", ())]


def _decoded(text: object) -> str:
    """Return a text as ezc3d gives it; where it is not UTF-8 it is Latin-1, as is common."""
    found = str(text).encode("utf-8", "surrogateescape")
    try:
        return found.decode()
    except UnicodeDecodeError:
        return found.decode("latin-1")


def _first(parameters: Mapping[str, Any], name: str, default: Any) -> Any:
    values: NDArray[Any] | list[Any] = parameters.get(name, {}).get("value", ())
    return values[0] if len(values) else default
