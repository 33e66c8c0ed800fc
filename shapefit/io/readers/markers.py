"""Points of motion capture: TRC, the CSV of anipose and of Vicon, and C3D, which ezc3d reads."""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, counted, input_error
from shapefit.geometry.normalisation import as_metres
from shapefit.io.inputs import check_fits
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.poses import Poses, make_unique, of_frames, parsing, require
from shapefit.io.readers.text import Table, decode, read_text, split_rows

HEAD_LINES = 12
"""Within which the names of TRC markers stand; five as a rule, more with empty lines between."""


def read_trc(paths: tuple[Path, ...]) -> Poses:
    """Return the markers of a TRC file.

    A point is missing where a coordinate is empty or nan, and where all three are exactly 0.
    Raises InputError for a header without markers, and for cells that are no numbers.
    """
    path = paths[0]
    text = read_text(path)
    head = text.split("\n")[:HEAD_LINES]
    delimiter = "\t" if "\t" in text else ","
    cells = [[cell.strip() for cell in line.split(delimiter)] for line in (*head, "")]
    firsts = [row[0].lower() for row in cells]
    last = next((n for n, first in enumerate(firsts) if first in ("frame#", "frame")), None)
    if last is None:
        fix = "give a TRC file whose fourth line is `Frame#  Time  NAME ...`"
        raise input_error(path, "has no line with the names of markers", fix)
    about: dict[str, str] = {}
    if "datarate" in firsts:
        at = firsts.index("datarate")
        about = dict(zip(map(str.lower, cells[at]), cells[at + 1], strict=False))
    named = cells[last][2:]
    below = cells[last + 1] if not cells[last + 1][0] else []  # X1 Y1 Z1 X2 ...
    axes = sum(map(bool, below[2:]))
    last += any(below)
    given = [name for name in named if name]
    count = axes // 3 or int(_positive(about.get("nummarkers"))) or len(given)
    adjacent = len(given) == count > 1 and named[: len(given)] == given  # without cells between
    labels = given if adjacent else named[::3][:count]
    labels += [""] * (min(count, max(len(named), axes)) - len(labels))
    if not labels or not (given or axes):
        raise input_error(f"{path}:{last + 1}", "there are no markers", "give a TRC with markers")
    names, notes = make_unique(labels)
    rows = [row for row in split_rows(path, text, delimiter) if row[0] > last + 1]
    columns = ["Frame#", "Time", *(f"{name} {axis}" for name in names for axis in "XYZ")]
    table = Table(path, rows, columns, delimiter, padded=True)
    if rows and len(table.cells(0)) == 1:
        table.delimiter = None  # only the header has tabs
    values, (frames,), _ = table.read(range(2, len(columns)), [0])
    factor, unit = as_metres(about.get("units", ""))
    points = factor * values.reshape(len(rows), len(names), 3)
    origin = np.asarray((points == 0).all(axis=2))
    lost = int(_positive(about.get("numframes")) - len(rows))
    if lost > 0:
        notes += (f"{lost} frames are announced in the header, but not there",)
    if origin.any():
        notes += (f"{int(origin.sum())} points at exactly 0, 0, 0 taken for missing",)
    return of_frames(
        path,
        np.where(origin[..., None], np.nan, points),
        labels=[frame or str(number) for number, frame in enumerate(frames)],
        video=path.stem,
        landmark_names=names,
        frame_rate=_positive(about.get("datarate")) or None,
        unit=unit or UNKNOWN_UNIT,
        notes=notes,
    )


def _positive(cell: str | None) -> float:
    """Return a cell as a number; 0 where it is none, or below 0."""
    try:
        value = float(cell or 0)
    except ValueError:
        return 0.0
    return max(value, 0.0) if np.isfinite(value) else 0.0


def anipose_landmarks(columns: Sequence[str]) -> tuple[str, ...]:
    """Return the landmarks that have x, y, z and what anipose says of them, in order."""
    names = {*columns}
    return tuple(
        stem
        for stem in dict.fromkeys(name[:-2] for name in columns if name.endswith("_x"))
        if stem
        and {f"{stem}_y", f"{stem}_z"} <= names
        and names & {f"{stem}_ncams", f"{stem}_error", f"{stem}_score"}
    )


def read_anipose(paths: tuple[Path, ...]) -> Poses:
    """Read the 3D points that anipose writes: x, y, z, error, cameras and score of each landmark.

    They are in the unit of anipose; the score is their confidence.
    """
    path = paths[0]
    rows = split_rows(path, read_text(path))
    header = Table(path, rows[:1]).cells(0)
    table, column = Table(path, rows[1:], header), {name: n for n, name in enumerate(header)}
    names = anipose_landmarks(header)
    left = [name[:-2] for name in header if name.endswith("_x") and name[:-2] not in names]
    scored = all(f"{name}_score" in column for name in names)
    wanted = [f"{name}_{axis}" for axis in ("x", "y", "z", "score")[: 3 + scored] for name in names]
    numbered = ["fnum"] * ("fnum" in column)
    values, _, _ = table.read([column[name] for name in (*wanted, *numbered)])
    # (n, axis * p) -> (n, p, axis)
    points = values[:, : len(wanted)].reshape(len(values), 3 + scored, len(names)).swapaxes(1, 2)
    scores = np.where(np.isfinite(points[..., -1]), np.clip(points[..., -1], 0, None), np.nan)
    labels = None
    if numbered and np.isfinite(values[:, -1]).all():
        labels = [f"{number:.15g}" for number in values[:, -1].tolist()]
    return of_frames(
        path,
        np.ascontiguousarray(points[..., :3]),
        scores if scored else None,
        labels,
        video=path.stem,
        landmark_names=names,
        notes=(f"points left out: {abbreviate(left)}",) if left else (),
    )


def read_vicon(paths: tuple[Path, ...]) -> Poses:
    """Read the section `Trajectories` of a CSV that Vicon Nexus exports.

    Below it stand the rate, a label above the X of each marker, `Frame,Sub Frame,X,Y,Z,...`, the
    units, and the frames up to an empty line. An empty cell is missing.
    """
    path, lines = paths[0], read_text(paths[0]).split("\n")
    firsts = [line.strip(', "\t').lower() for line in lines]
    with parsing(path, "export the trajectories from Nexus again"):
        start = firsts.index("trajectories") + 1
        rate, named, axes, units = (line.split(",") for line in lines[start : start + 4])
        count = sum(axis.strip() == "X" for axis in axes)
        wanted = ["Frame", "Sub Frame", *"XYZ" * count]
        require(count > 0 and [axis.strip() for axis in axes] == wanted, "has other columns")
        factor, unit = as_metres(units[2].strip())
        labels = ([name.strip() for name in named[2::3]] + [""] * count)[:count]
        hertz = float(rate[0])
    end = next((n for n in range(start + 4, len(lines)) if not firsts[n]), len(lines))
    rows = [row for row in split_rows(path, "\n".join(lines[:end])) if row[0] > start + 4]
    columns = [*wanted[:2], *(f"{name}/{axis}" for name in labels for axis in "XYZ")]
    values, (frames,), _ = Table(path, rows, columns, padded=True).read(range(2, len(wanted)), [0])
    points = factor * values.reshape(len(values), count, 3)
    return _of_markers(path, points, labels, frames, hertz, unit=unit or UNKNOWN_UNIT)


# C3D

MAX_FRAMES = 65535

EXPANDS = 16
"""Times its size that a file takes in memory, at most, while ezc3d reads it."""

COMPUTED = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")
"""Lists of labels under POINT that are no points: what a model computed is stored beside them."""


def read_c3d(paths: tuple[Path, ...]) -> Poses:
    """Return the markers of a C3D file, in metres where it names its unit.

    A point is missing where its residual is negative or its place NaN. Labels `subject:name` are
    landmarks of an individual. Frames have the numbers that ezc3d gives them, one less than those
    in the header. Raises InputError where ezc3d is not installed or cannot read the file.
    """
    path = paths[0]
    check_fits(str(path), EXPANDS * path.stat().st_size, "what it holds")
    try:
        _check_length(path)
        file = import_module("ezc3d").c3d(os.fspath(path))
    except ImportError as error:
        problem = "is a C3D file, which ezc3d reads, and that is not installed"
        raise input_error(path, problem, "run `pip install ezc3d`") from error
    except MemoryError:
        raise
    except Exception as error:  # ezc3d has many kinds of error for damaged files
        raise input_error(path, f"cannot be read as C3D ({error})", "give a whole file") from error
    about: Any = file["parameters"].get("POINT", {})

    def texts(name: str) -> list[str]:  # ezc3d leaves what is not UTF-8 as bytes
        values = (str(text) for text in about.get(name, {}).get("value", ()))
        data = [text.encode("utf-8", "surrogateescape") for text in values]
        return [decode(text).strip() for text in data]

    # (4, p, n) -> (n, p, 3)
    points = np.asarray(file["data"]["points"], np.float64)[:3].transpose(2, 1, 0)
    residual = np.asarray(file["data"]["meta_points"]["residuals"])[0].T
    points = np.where((residual >= 0)[..., None], points, np.nan)
    factor, unit = as_metres((texts("UNITS") or [""])[0])
    more = (f"LABELS{number}" for number in range(2, len(about)))  # beyond 255
    labels = [label for name in ("LABELS", *more) for label in texts(name)]
    labels = (labels + [""] * points.shape[1])[: points.shape[1]]
    computed = {label for name in COMPUTED for label in texts(name)}
    left = [label for label in labels if label in computed]
    notes: tuple[str, ...] = ()
    if left:
        text = f"left out, computed by a model, not seen ({abbreviate(left)})"
        notes += (f"{counted(len(left), 'point')} {text}",)
    if len(points) == MAX_FRAMES:
        notes += (f"has {MAX_FRAMES} frames, as many as its header can count; it may hold more",)
    start = int(file["header"]["points"]["first_frame"])
    (rate,) = np.ravel(about.get("RATE", {}).get("value", ()))[:1] or [0.0]
    markers = [place for place, label in enumerate(labels) if label not in computed]
    return _of_markers(
        path,
        factor * points[:, markers],
        [labels[place] for place in markers],
        [str(start + frame) for frame in range(len(points))],
        float(rate),
        unit=unit or UNKNOWN_UNIT,
        notes=notes,
    )


def _check_length(path: Path) -> None:
    """Raise ValueError for a file shorter than its header says, which ezc3d may not survive."""
    with path.open("rb") as file:
        head = file.read(512)  # a block, in which C3D counts
        points, analog, first, last = struct.unpack("<HHHH", head[2:10])
        scale, start = struct.unpack("<fH", head[12:18])
        file.seek(512 * (head[0] - 1) + 3)
        intel = file.read(1) == b"\x54"  # little end first, as all of today's are
    frames, number_bytes = max(last - first + 1, 0), 4 if scale < 0 else 2
    needed = 512 * max(start - 1, 0) + frames * (4 * points + analog) * number_bytes
    if intel and path.stat().st_size < needed:
        raise ValueError(f"{path.stat().st_size} bytes of {needed}")


# What Vicon's CSV and C3D share: labels `subject:name`.


def _of_markers(
    path: Path,
    points: Floats,
    labels: Sequence[str],
    frames: Sequence[str],
    rate: float,
    *,
    unit: str,
    notes: tuple[str, ...] = (),
) -> Poses:
    """Return markers (n, m, 3) of these labels; `subject:name` is a landmark of an individual.

    Without a subject in any name there are no individuals; with one, it has all the points; with
    several, those without a subject belong to `unassigned`.
    """
    names, repeated = make_unique(labels)
    parts = [name.rpartition(":")[::2] for name in names]
    subjects = list(dict.fromkeys(subject for subject, _ in parts if subject))
    if len(subjects) > 1 and not all(subject for subject, _ in parts):
        subjects.append("unassigned")
    markers = [(subject or subjects[-1], name) for subject, name in parts] if subjects else []
    if len(set(markers)) < len(names):
        subjects, markers = [], [("", name) for name in names]
    landmarks = list(dict.fromkeys(name for _, name in markers))
    per_subject = np.full((len(points), max(len(subjects), 1), len(landmarks), 3), np.nan)
    for marker, (subject, name) in enumerate(markers):
        who = subjects.index(subject) if subjects else 0
        per_subject[:, who, landmarks.index(name)] = points[:, marker]
    return of_frames(
        path,
        per_subject,
        labels=frames,
        video=path.stem,
        landmark_names=tuple(landmarks),
        individuals=tuple(subjects) or None,
        frame_rate=rate if np.isfinite(rate) and rate > 0 else None,
        unit=unit,
        notes=notes + repeated,
    )
