"""Points of motion capture: TRC, the CSV of Vicon, and C3D, which ezc3d reads."""

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
    """Read the markers of a TRC file: tabs or commas, and a name above the X of each
    marker.

    A point is missing where a coordinate is empty or nan, and where all three are
    exactly 0.
    """
    path, text = paths[0], read_text(paths[0])
    delimiter = "\t" if "\t" in text else ","
    head = [
        [cell.strip() for cell in line.split(delimiter)]
        for line in text.split("\n")[:5]
    ]
    _, keys, values, names, axes = head
    about = dict(zip(map(str.lower, keys), values, strict=False))
    count = sum(map(bool, axes[2:])) // 3  # X1 Y1 Z1 X2 ...
    require(
        count and names[0].lower() == "frame#",
        "no names of markers in line 4, above X1 Y1",
    )
    require(not any(names[3::3] + names[4::3]), "names that do not stand above an X")
    labels = [*names[2:], *[""] * (3 * count)][: 3 * count : 3]
    points, frames = _read_points(path, text, labels, 5, delimiter)
    origin, notes = np.asarray((points == 0).all(axis=2)), list[str]()
    lost = int(float(about.get("numframes", 0))) - len(points)
    if lost > 0:
        notes.append(f"{lost} frames are announced in the header, but not there")
    if origin.any():
        notes.append(f"{int(origin.sum())} points at exactly 0, 0, 0 taken for missing")
    points = np.where(origin[..., None], np.nan, points)
    (rate,), unit = floats([about["datarate"]]), about.get("units", "")
    return _of_markers(
        path, points, labels, rate, unit, labels=frames, notes=tuple(notes)
    )


def read_vicon(paths: tuple[Path, ...]) -> Poses:
    """Read the section `Trajectories` of a CSV that Vicon Nexus exports.

    Below it stand the rate, a label above the X of each marker, `Frame,Sub
    Frame,X,Y,Z,...`, the units, and the frames up to an empty line. An empty cell is
    missing.
    """
    path, lines = paths[0], read_text(paths[0]).split("\n")
    bare = [line.strip(', "\t') for line in lines]
    start = [line.lower() for line in bare].index("trajectories") + 1
    end = bare.index("", start) if "" in bare[start:] else len(bare)
    head = [
        [cell.strip() for cell in line.split(",")] for line in lines[start : start + 4]
    ]
    (rate, *_), labels, axes, (*_, unit) = head[0], head[1], head[2], head[3][:3]
    count = axes.count("X")
    require(
        axes == ["Frame", "Sub Frame", *"XYZ" * count], "other columns than X, Y and Z"
    )
    labels = [*labels[2:], *[""] * (3 * count)][: 3 * count : 3]
    points, frames = _read_points(path, "\n".join(lines[:end]), labels, start + 4)
    return _of_markers(path, points, labels, floats([rate])[0], unit, labels=frames)


def _read_points(
    path: Path, text: str, labels: Sequence[str], after: int, delimiter: str = ","
) -> tuple[Floats, list[str]]:
    """Return points (n, m, 3), and the labels of the frames.

    A row, after so many lines, is a frame, a cell that does not count, and x, y, z of
    each marker.
    """
    columns = ["Frame", "", *(f"{name} {axis}" for name in labels for axis in "XYZ")]
    table = read_table(path, text, columns, delimiter, after=after, padded=True)
    points = table.numbers(range(2, len(columns))).reshape(-1, len(labels), 3)
    frames = [frame or str(number) for number, frame in enumerate(table.texts(0)[0])]
    return points, frames


COMPUTED = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")  # by a model: no points


def read_c3d(paths: tuple[Path, ...]) -> Poses:
    """Read the markers of a C3D file, in metres where it names its unit.

    A point is missing where its residual is negative. Frames have the numbers that
    ezc3d gives them, one less than in the header. Raises InputError where ezc3d is not
    installed.
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
        return [
            decode(text.encode("utf-8", "surrogateescape")).strip() for text in values
        ]

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
    note = (
        f"{counted(len(lost), 'point')} left out, computed by a model"
        f" ({abbreviate(lost)})"
    )
    unit, start = (
        (texts("UNITS") or [""])[0],
        int(file["header"]["points"]["first_frame"]),
    )
    return _of_markers(
        path,
        points[:, markers],
        [labels[number] for number in markers],
        float([*np.ravel(about.get("RATE", {}).get("value", ())), 0.0][0]),
        unit,
        labels=[str(start + frame) for frame in range(len(points))],
        notes=(note,) if lost else (),
    )


def _check_length(path: Path) -> None:
    """Raise ValueError for a file that is cut off, of which ezc3d would read the
    rest.
    """
    with path.open("rb") as file:
        head = file.read(512)  # a block, in which C3D counts
        points, analog, first, last = struct.unpack("<HHHH", head[2:10])
        scale, start = struct.unpack("<fH", head[12:18])
        file.seek(512 * (head[0] - 1) + 3)
        intel = file.read(1) == b"\x54"  # little end first, as all of today's are
    numbers = max(last - first + 1, 0) * (4 * points + analog)
    needed = 512 * max(start - 1, 0) + numbers * (4 if scale < 0 else 2)
    require(
        not intel or path.stat().st_size >= needed, f"cut off before {needed} bytes"
    )


def _of_markers(
    path: Path,
    points: Floats,
    markers: Sequence[str],
    rate: float,
    unit: str,
    **fields: Any,
) -> Poses:
    """Return the one body of markers (n, m, 3), in metres where the unit is known.

    `subject:` before all their names is the individual; `fields` are those of
    `of_frames`.
    """
    names, (factor, unit) = make_unique(markers), as_metres(unit)
    subjects = {name.rpartition(":")[0] for name in names if not name.startswith("*")}
    individuals = [*subjects] if len(subjects) == 1 and any(subjects) else None
    if individuals:
        names = tuple(name.rpartition(":")[2] for name in names)
    return of_frames(
        path,
        factor * points,
        video=path.stem,
        landmark_names=names,
        individuals=individuals,
        frame_rate=rate if np.isfinite(rate) and rate > 0 else None,
        unit=unit or UNKNOWN_UNIT,
        **fields,
    )
