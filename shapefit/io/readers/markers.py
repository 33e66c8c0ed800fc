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
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.poses import Poses, make_unique, of_frames, require
from shapefit.io.readers.text import decode, floats, read_table, read_text


def read_trc(paths: tuple[Path, ...]) -> Poses:
    """Read the markers of a TRC file: tabs or commas, and a name above the X of each marker.

    A point is missing where a coordinate is empty or nan, and where all three are exactly 0.
    """
    path, text = paths[0], read_text(paths[0])
    delimiter = "\t" if "\t" in text else ","
    head = [[cell.strip() for cell in line.split(delimiter)] for line in text.split("\n")[:5]]
    _, keys, values, names_of, axes = head
    about = dict(zip(map(str.lower, keys), values, strict=False))
    count = sum(map(bool, axes[2:])) // 3  # X1 Y1 Z1 X2 ...
    require(count and names_of[0].lower() == "frame#", "no names of markers in line 4, above X1 Y1")
    require(not any(names_of[3::3] + names_of[4::3]), "names that do not stand above an X")
    labels = [*names_of[2:], *[""] * (3 * count)][: 3 * count : 3]
    names, notes = make_unique(labels), list[str]()
    columns = ["Frame#", "Time", *(f"{name} {axis}" for name in names for axis in "XYZ")]
    table = read_table(path, text, columns, delimiter, after=5, padded=True)
    factor, unit = as_metres(about.get("units", ""))
    points = factor * table.numbers(range(2, len(columns))).reshape(-1, count, 3)
    origin = np.asarray((points == 0).all(axis=2))
    lost = int(float(about.get("numframes", 0))) - len(points)
    if lost > 0:
        notes.append(f"{lost} frames are announced in the header, but not there")
    if origin.any():
        notes.append(f"{int(origin.sum())} points at exactly 0, 0, 0 taken for missing")
    (rate,) = floats([about["datarate"]])
    return of_frames(
        path,
        np.where(origin[..., None], np.nan, points),
        labels=[frame or str(number) for number, frame in enumerate(table.texts(0)[0])],
        video=path.stem,
        landmark_names=names,
        frame_rate=rate if rate > 0 else None,
        unit=unit or UNKNOWN_UNIT,
        notes=tuple(notes),
    )


def anipose_landmarks(columns: Sequence[str]) -> tuple[str, ...]:
    """Return the landmarks that have x, y, z and what anipose says of them, in order."""
    names = {*columns}
    return tuple(
        stem
        for stem in dict.fromkeys(name[:-2] for name in columns if name.endswith("_x"))
        if {f"{stem}_y", f"{stem}_z"} <= names
        and names & {f"{stem}_ncams", f"{stem}_error", f"{stem}_score"}
    )


def read_anipose(paths: tuple[Path, ...]) -> Poses:
    """Read the 3D points that anipose writes: x, y, z, error, cameras and score of each landmark.

    They are in the unit of anipose; the score is their confidence.
    """
    path = paths[0]
    table = read_table(path, read_text(path))
    names = anipose_landmarks(table.names)
    scored = all(f"{name}_score" in table.names for name in names)
    axes = ("x", "y", "z", "score")[: 3 + scored]
    columns = [table.names.index(f"{name}_{axis}") for name in names for axis in axes]
    values = table.numbers(columns).reshape(-1, len(names), len(axes))
    return of_frames(
        path,
        values[..., :3],
        np.where(np.isfinite(values[..., 3]), values[..., 3], np.nan) if scored else None,
        table.texts(table.names.index("fnum"))[0] if "fnum" in table.names else None,
        video=path.stem,
        landmark_names=names,
    )


def read_vicon(paths: tuple[Path, ...]) -> Poses:
    """Read the section `Trajectories` of a CSV that Vicon Nexus exports.

    Below it stand the rate, a label above the X of each marker, `Frame,Sub Frame,X,Y,Z,...`, the
    units, and the frames up to an empty line. An empty cell is missing.
    """
    path, text = paths[0], read_text(paths[0])
    lines = [line.strip(', "\t') for line in text.split("\n")]
    start = [line.lower() for line in lines].index("trajectories") + 1
    end = lines.index("", start) if "" in lines[start:] else len(lines)
    head = [line.split(",") for line in text.split("\n")[start : start + 4]]
    count = head[2].count("X")
    axes = [axis.strip() for axis in head[2]]
    require(axes == ["Frame", "Sub Frame", *"XYZ" * count], "other columns than X, Y and Z")
    labels = [name.strip() for name in (head[1] + [""] * 3 * count)[2 : 2 + 3 * count : 3]]
    columns = ["Frame", "Sub Frame", *(f"{name}/{axis}" for name in labels for axis in "XYZ")]
    rows = "\n".join(text.split("\n")[:end])
    table = read_table(path, rows, columns, after=start + 4, padded=True)
    factor, unit = as_metres(head[3][2].strip())
    points = factor * table.numbers(range(2, len(columns))).reshape(-1, count, 3)
    (rate,) = floats(head[0][:1])
    return _of_markers(path, points, labels, table.texts(0)[0], rate, unit)


COMPUTED = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")
"""Lists of labels under POINT that are no points: what a model computed is stored beside them."""


def read_c3d(paths: tuple[Path, ...]) -> Poses:
    """Return the markers of a C3D file, in metres where it names its unit.

    A point is missing where its residual is negative or its place NaN. Labels `subject:name` are
    landmarks of an individual. Frames have the numbers that ezc3d gives them, one less than those
    in the header. Raises InputError where ezc3d is not installed.
    """
    path = paths[0]
    _check_length(path)
    try:
        file = import_module("ezc3d").c3d(os.fspath(path))
    except ImportError as error:
        problem = "is a C3D file, which ezc3d reads, and that is not installed"
        raise input_error(path, problem, "run `pip install ezc3d`") from error
    about: Any = file["parameters"]["POINT"]

    def texts(name: str) -> list[str]:  # ezc3d leaves what is not UTF-8 as bytes
        values = (str(text) for text in about.get(name, {}).get("value", ()))
        return [decode(text.encode("utf-8", "surrogateescape")).strip() for text in values]

    # (4, p, n) -> (n, p, 3)
    points = np.asarray(file["data"]["points"], np.float64)[:3].transpose(2, 1, 0)
    residual = np.asarray(file["data"]["meta_points"]["residuals"])[0].T
    points = np.where((residual >= 0)[..., None], points, np.nan)
    more = (f"LABELS{number}" for number in range(2, len(about)))  # beyond 255
    labels = [label for name in ("LABELS", *more) for label in texts(name)]
    labels = (labels + [""] * points.shape[1])[: points.shape[1]]
    computed = {label for name in COMPUTED for label in texts(name)}
    markers = [number for number, label in enumerate(labels) if label not in computed]
    lost = [label for label in labels if label in computed]
    note = f"{counted(len(lost), 'point')} left out, computed by a model ({abbreviate(lost)})"
    factor, unit = as_metres((texts("UNITS") or [""])[0])
    start = int(file["header"]["points"]["first_frame"])
    frames = [str(start + frame) for frame in range(len(points))]
    rate = float([*np.ravel(about.get("RATE", {}).get("value", ())), 0.0][0])
    labels = [labels[number] for number in markers]
    notes = (note,) if lost else ()
    return _of_markers(path, factor * points[:, markers], labels, frames, rate, unit, notes)


def _check_length(path: Path) -> None:
    """Raise ValueError for a file that is cut off, of which ezc3d would read the rest."""
    with path.open("rb") as file:
        head = file.read(512)  # a block, in which C3D counts
        points, analog, first, last = struct.unpack("<HHHH", head[2:10])
        scale, start = struct.unpack("<fH", head[12:18])
        file.seek(512 * (head[0] - 1) + 3)
        intel = file.read(1) == b"\x54"  # little end first, as all of today's are
    numbers = max(last - first + 1, 0) * (4 * points + analog)
    needed = 512 * max(start - 1, 0) + numbers * (4 if scale < 0 else 2)
    require(not intel or path.stat().st_size >= needed, f"cut off before {needed} bytes")


# What Vicon's CSV and C3D share: labels `subject:name`.


def _of_markers(
    path: Path,
    points: Floats,
    labels: Sequence[str],
    frames: Sequence[str],
    rate: float,
    unit: str,
    notes: tuple[str, ...] = (),
) -> Poses:
    """Return markers (n, m, 3) of these labels; `subject:name` is a landmark of an individual.

    Labels without a subject are those of the last one. Where a subject has a name twice, as where
    there is none at all, all are landmarks of one body.
    """
    names = make_unique(labels)
    parts = [name.rpartition(":")[::2] for name in names]
    subjects = list(dict.fromkeys(subject for subject, _ in parts if subject)) or [""]
    markers = [(subject or subjects[-1], name) for subject, name in parts]
    if len({*markers}) < len(names):
        subjects, markers = [""], [("", name) for name in names]
    landmarks = list(dict.fromkeys(name for _, name in markers))
    per_subject = np.full((len(points), len(subjects), len(landmarks), 3), np.nan)
    for number, (subject, name) in enumerate(markers):
        per_subject[:, subjects.index(subject), landmarks.index(name)] = points[:, number]
    return of_frames(
        path,
        per_subject,
        labels=frames,
        video=path.stem,
        landmark_names=tuple(landmarks),
        individuals=None if subjects == [""] else subjects,
        frame_rate=rate if np.isfinite(rate) and rate > 0 else None,
        unit=unit or UNKNOWN_UNIT,
        notes=notes,
    )
