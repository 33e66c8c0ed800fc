"""Points of motion capture: TRC, anipose's CSV, and C3D, which ezc3d reads (the extra `c3d`)."""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.errors import abbreviate, counted, input_error
from shapefit.geometry.normalisation import as_metres
from shapefit.io.inputs import check_fits
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.columns import anipose_landmarks
from shapefit.io.readers.poses import Poses, make_unique, of_frames, parsing, require
from shapefit.io.readers.text_table import Table, read_text

HEAD_LINES = 12
"""Within which the names of the markers stand; five as a rule, more with empty lines between."""

AT_ORIGIN = "points at exactly 0, 0, 0 taken for missing"
TOO_FEW = "frames are announced in the header, but not there"


def read_trc(paths: tuple[Path, ...]) -> Poses:
    """Return the markers of a TRC file.

    A point is missing where a coordinate is empty or nan, and where all three are exactly 0.
    Raises InputError for a header without markers, and for frames that are no numbers.
    """
    path = paths[0]
    text = read_text(path)
    header = _read_header(path, text.split("\n")[:HEAD_LINES])
    names, notes = make_unique(header.labels)
    table = Table(path, header.delimiter, text)
    columns = [f"{name} {axis}" for name in names for axis in "XYZ"]
    table.skip(header.lines, ["Frame#", "Time", *columns])
    table.padded = True
    ((_, row),) = table.first_rows(1) or [(0, [])]
    if len(row) == 1:
        table.delimiter = None  # only the header has tabs
    numbers, (firsts,), _ = table.read(range(2, 2 + len(columns)), [0])
    labels = [first or str(frame) for frame, first in enumerate(firsts)]
    factor, unit = as_metres(header.values.get("units", ""))
    points = factor * numbers.reshape(len(labels), len(names), 3)
    origin = np.asarray((points == 0).all(axis=2))
    points[origin] = np.nan
    lost = {TOO_FEW: int(header.number("numframes")) - len(labels), AT_ORIGIN: int(origin.sum())}
    notes += tuple(f"{number} {what}" for what, number in lost.items() if number > 0)
    return of_frames(
        path,
        points,
        labels=labels,
        video=path.stem,
        landmark_names=names,
        frame_rate=header.number("datarate") or None,
        unit=unit or UNKNOWN_UNIT,
        notes=notes,
    )


@dataclass(frozen=True)
class Header:
    """What stands above the frames; `lines` is the number of its lines."""

    delimiter: str
    values: dict[str, str]
    labels: list[str]
    lines: int

    def number(self, name: str) -> float:
        """Return a value as a number; 0 where it is none, or below 0."""
        return _number(self.values.get(name, ""))


def _read_header(path: Path, lines: Sequence[str]) -> Header:
    """Read what stands above the frames. Raises InputError where there are no markers."""
    firsts = [line.replace(",", "\t").split("\t")[0].strip().lower() for line in lines]
    place = next((i for i, first in enumerate(firsts) if first in ("frame#", "frame")), None)
    if place is None:
        fix = "give a TRC file whose fourth line is `Frame#  Time  NAME ...`"
        raise input_error(path, "has no line with the names of markers", fix)
    delimiter = "\t" if "\t" in lines[place] else ","
    values: dict[str, str] = {}
    if "datarate" in firsts:
        at = firsts.index("datarate")
        keys, cells = (line.split(delimiter) for line in lines[at : at + 2])
        values = {k.strip().lower(): c.strip() for k, c in zip(keys, cells, strict=False)}
    cells = [cell.strip() for cell in lines[place].split(delimiter)[2:]]
    axes = 0
    if place + 1 < len(lines) and not firsts[place + 1] and lines[place + 1].strip():
        axes = sum(bool(cell.strip()) for cell in lines[place + 1].split(delimiter)[2:])
        place += 1
    given = [cell for cell in cells if cell]
    markers = axes // 3 or int(_number(values.get("nummarkers", ""))) or len(given)
    side_by_side = len(given) == markers and cells[: len(given)] == given and markers > 1
    labels = given if side_by_side else cells[::3][:markers]
    labels += [""] * (min(markers, max(len(cells), axes)) - len(labels))
    if not labels or not (given or axes):
        raise input_error(f"{path}:{place + 1}", "there are no markers", "give a TRC with markers")
    return Header(delimiter, values, labels, place + 1)


def _number(cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        return 0.0
    return max(value, 0.0) if np.isfinite(value) else 0.0


def read_anipose(paths: tuple[Path, ...]) -> Poses:
    """Read the 3D points that anipose writes: x, y, z, error, cameras and score of each landmark.

    They are in the unit of anipose; the score is their confidence. Raises InputError for rows of
    another width, and cells that are no numbers.
    """
    path = paths[0]
    table = Table(path)
    ((line, cells),) = table.first_rows(1)
    columns = [cell.strip() for cell in cells]
    table.skip(line, columns)
    names = anipose_landmarks(columns)
    place = {name: number for number, name in enumerate(columns)}
    left = [name[:-2] for name in columns if name.endswith("_x") and name[:-2] not in names]
    scored = all(f"{name}_score" in place for name in names)
    wanted = [f"{name}_{axis}" for name in names for axis in "xyz"]
    wanted += [f"{name}_score" for name in names if scored] + ["fnum"] * ("fnum" in place)
    values, _, _ = table.read([place[name] for name in wanted])
    points, scores = np.split(values[:, : 4 * len(names)], [3 * len(names)], axis=1)
    labels = None
    if "fnum" in place and np.isfinite(values[:, -1]).all():
        labels = [f"{number:.15g}" for number in values[:, -1].tolist()]
    scores = np.where(np.isfinite(scores), np.clip(scores, 0, None), np.nan)
    return of_frames(
        path,
        points.reshape(len(values), len(names), 3),
        scores if scored else None,
        labels,
        video=path.stem,
        landmark_names=names,
        notes=(f"points left out: {abbreviate(left)}",) if left else (),
    )


BLOCK = 512
"""Bytes of a block, in which C3D counts."""

INTEL = 84
"""The processor whose numbers are written little end first, as all of today's are."""

MOST_FRAMES = 65535

EXPANDS = 16
"""Times its size that a file takes in memory, at most, while ezc3d reads it."""

COMPUTED = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")
"""Lists of labels under POINT that are no points: what a model computed is stored beside them."""

NOBODY = "unassigned"
"""The individual that has the points without a subject, where there are several subjects."""

WHOLE = "give a whole C3D file"


def read_c3d(paths: tuple[Path, ...]) -> Poses:
    """Return the markers of a C3D file, in metres where it names its unit.

    A point is missing where its residual is negative or its place NaN. Labels `subject:name` are
    landmarks of an individual. Frames have the numbers that ezc3d gives them, one less than those
    in the header. Raises InputError where ezc3d is not installed or cannot read the file.
    """
    path = paths[0]
    _check_whole(path)
    check_fits(str(path), EXPANDS * path.stat().st_size, "what it holds")
    file = _read_c3d(path)
    parameters: Mapping[str, Any] = file["parameters"].get("POINT", {})
    points = np.asarray(file["data"]["points"], dtype=np.float64)[:3].transpose(2, 1, 0)
    residual = np.asarray(file["data"]["meta_points"]["residuals"])[0].T
    factor, unit = as_metres((_texts(parameters, "UNITS") or [""])[0])
    points = factor * np.where((residual >= 0)[..., None], points, np.nan)
    n, count, _ = points.shape
    labels = _labels(parameters, count)
    computed = set().union(*(_texts(parameters, name) for name in COMPUTED))
    left = [label for label in labels if label in computed]
    notes: tuple[str, ...] = ()
    if left:
        text = f"left out, computed by a model, not seen ({abbreviate(left)})"
        notes = (f"{counted(len(left), 'point')} {text}",)
    markers = [place for place, label in enumerate(labels) if label not in computed]
    names, more = make_unique([labels[place] for place in markers])
    individuals, landmarks, places = _by_subject(names)
    if n == MOST_FRAMES:
        notes += (f"has {MOST_FRAMES} frames, as many as its header can count; it may hold more",)
    (rate,) = np.ravel(parameters.get("RATE", {}).get("value", ()))[:1] or [0.0]
    start = int(file["header"]["points"]["first_frame"])
    every = np.full((n, max(len(individuals), 1), len(landmarks), 3), np.nan)
    for marker, (subject, landmark) in zip(markers, places, strict=True):
        every[:, subject, landmark] = points[:, marker]
    return of_frames(
        path,
        every,
        labels=[str(start + frame) for frame in range(n)],
        video=path.stem,
        landmark_names=landmarks,
        individuals=individuals or None,
        frame_rate=float(rate) if np.isfinite(rate) and rate > 0 else None,
        unit=unit or UNKNOWN_UNIT,
        notes=notes + more,
    )


def _by_subject(
    names: tuple[str, ...],
) -> tuple[tuple[str, ...], tuple[str, ...], list[tuple[int, int]]]:
    """Return individuals, landmarks, and the (individual, landmark) of every name.

    Without a subject in any name there are no individuals; with one, it has all the points.
    """
    parts = [name.rpartition(":")[::2] for name in names]
    subjects = list(dict.fromkeys(subject for subject, _ in parts if subject))
    if len(subjects) > 1 and not all(subject for subject, _ in parts):
        subjects.append(NOBODY)
    pairs = [(subject or subjects[-1], name) for subject, name in parts] if subjects else []
    if len(set(pairs)) < len(names):
        return (), names, [(0, place) for place in range(len(names))]
    landmarks = tuple(dict.fromkeys(name for _, name in pairs))
    places = [(subjects.index(subject), landmarks.index(name)) for subject, name in pairs]
    return tuple(subjects), landmarks, places


def _check_whole(path: Path) -> None:
    """Raise InputError for a file shorter than its own header says, which ezc3d may not survive."""
    size = path.stat().st_size
    with parsing(path, WHOLE), path.open("rb") as file:
        head = file.read(BLOCK)
        points, analog, first, last = struct.unpack("<HHHH", head[2:10])
        scale, start = struct.unpack("<fH", head[12:18])
        file.seek(BLOCK * (head[0] - 1))
        section = file.read(4)
        require(len(section) == 4, "is cut off before its parameters")
        frames, number_bytes = max(last - first + 1, 0), 4 if scale < 0 else 2
        needed = BLOCK * max(start - 1, 0) + frames * (4 * points + analog) * number_bytes
        whole = section[3] != INTEL or size >= needed
        require(whole, f"has {size} bytes, and its header announces {needed}")


def _read_c3d(path: Path) -> Any:
    try:
        return import_module("ezc3d").c3d(os.fspath(path))
    except ImportError as error:
        found = "is a C3D file, which ezc3d reads, and that is not installed"
        raise input_error(path, found, "run `pip install ezc3d`") from error
    except MemoryError:
        raise
    except Exception as error:  # ezc3d has many kinds of error for damaged files
        raise input_error(path, f"cannot be read by ezc3d ({error})", WHOLE) from error


def _labels(parameters: Mapping[str, Any], count: int) -> list[str]:
    """Return the labels of all points; LABELS2 and so on continue LABELS beyond 255."""
    lists = ("LABELS", *(f"LABELS{number}" for number in range(2, len(parameters))))
    labels = [label for name in lists for label in _texts(parameters, name)]
    return (labels + [""] * count)[:count]


def _texts(parameters: Mapping[str, Any], name: str) -> list[str]:
    """Return texts; where they are not UTF-8, which ezc3d leaves as bytes, they are Latin-1."""
    found = []
    for text in parameters.get(name, {}).get("value", ()):
        data = str(text).encode("utf-8", "surrogateescape")
        try:
            found.append(data.decode().strip())
        except UnicodeDecodeError:
            found.append(data.decode("latin-1").strip())
    return found
