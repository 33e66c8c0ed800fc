"""Motion as points and as joint angles: TRC, C3D (by ezc3d), CSV, and the .mot of
OpenSim.
"""

from __future__ import annotations

import csv
import errno
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from shapefit.arrays import Floats, Integers
from shapefit.errors import counted, input_error, printable
from shapefit.io.writers.motion import FileMotion
from shapefit.records.columns import Array

C3D_BLOCK = 4096
"""Frames that are made text at a time."""

TRC_COLUMNS = (
    "DataRate CameraRate NumFrames NumMarkers Units OrigDataRate OrigDataStartFrame"
    " OrigNumFrames"
)


def write_trc(path: Path, motion: FileMotion) -> None:
    """Write one motion as TRC, positions of markers in metres, which OpenSim reads.

    Its joint angles, if any, go to NAME_angles.csv.
    """
    if motion.angle_names:
        write_angles(path.with_name(f"{path.stem}_angles.csv"), motion)
    count = len(motion.points)
    p = len(motion.landmark_names)
    rate = f"{motion.rate:.10g}"
    file_name = f"{printable(motion.name) or 'motion'}.trc"
    head = [
        ["PathFileType", "4", "(X/Y/Z)", file_name, f"{motion.axes}; {motion.size}"],
        TRC_COLUMNS.split(),
        [rate, rate, str(count), str(p), "m", rate, str(motion.first), str(count)],
        [
            "Frame#",
            "Time",
            *(c for n in motion.landmark_names for c in (printable(n), "", "")),
        ],
        ["", "", *(f"{axis}{number}" for number in range(1, p + 1) for axis in "XYZ")],
    ]
    with path.open("wb") as file:
        file.write("".join("\t".join(cells) + "\n" for cells in head).encode())
        for start in range(0, count, C3D_BLOCK):
            frames = motion.frames[start : start + C3D_BLOCK]
            # (f, 3, p) -> time, and x, y, z of one landmark after the other
            points = (
                motion.points[start : start + C3D_BLOCK]
                .swapaxes(1, 2)
                .reshape(len(frames), -1)
            )
            times = motion.times[start : start + C3D_BLOCK]
            table = np.column_stack([np.round(times, 9), points])
            text = orjson.dumps(table, option=orjson.OPT_SERIALIZE_NUMPY)[2:-2]
            lines = (
                text.replace(b"null", b"").replace(b"],[", b"\n").replace(b",", b"\t")
            )
            rows = zip(frames.tolist(), lines.split(b"\n"), strict=True)
            file.write(b"".join(b"%d\t%b\n" % row for row in rows))


def write_metres(path: Path, motion: FileMotion) -> None:
    """Write one motion in metres as CSV, a row per frame and landmark; NaN is empty."""
    columns = {name: cells.tolist() for name, cells in metres_columns(motion).items()}
    _write_csv(path, [*columns], zip(*columns.values(), strict=True), ".7g")


def metres_columns(motion: FileMotion) -> dict[str, Array]:
    """Return name -> values (f p,) for columns of a motion, by frame, then landmark.

    Numbers that are not known are nan.

    sd is that of the distance to the point, sqrt(sd_x^2 + sd_y^2 + sd_z^2).
    """
    f = len(motion.points)
    p = len(motion.landmark_names)
    return {
        "frame": np.repeat(motion.frames, p),
        "time": np.repeat(motion.times, p),
        "landmark": np.tile(np.array(motion.landmark_names, dtype=str), f),
        **{axis: motion.points[:, number].ravel() for number, axis in enumerate("xyz")},
        "sd": motion.deviations.ravel(),
        "trusted": np.repeat(np.array(motion.trusted, dtype=str), p),
    }


def _write_csv(
    path: Path, header: Sequence[str], rows: Iterable[Any], digits: str
) -> None:
    """Write rows (frame, time, other cells) as CSV; nan is an empty cell.

    digits: the format of numbers with a fraction among the others.
    """

    def cell(value: object) -> str:
        """Format a value as a cell, "" for nan and infinite numbers."""
        if not isinstance(value, float):
            return str(value)
        return format(value, digits) if np.isfinite(value) else ""

    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(header)
        table.writerows(
            [frame, f"{time:.10g}", *map(cell, rest)] for frame, time, *rest in rows
        )


MAX_ANGLE_SD = 15.0
"""Standard deviation of a joint angle in degrees beyond which it says next to nothing.
"""


def write_angles(path: Path, motion: FileMotion) -> None:
    """Write joint angles and their standard deviations, in degrees, as CSV.

    A row per frame, whose last cell names the angles that are uncertain. Raises
    InputError where landmarks determine no angle.
    """
    names = _angle_names(path, motion)
    header = [column for name in names for column in (name, f"{name}_sd")]
    # (f, a, 2) -> an angle and its deviation after the other
    pairs = np.stack([motion.angles, motion.angle_deviations], axis=2).reshape(
        -1, 2 * len(names)
    )
    uncertain = [
        " ".join(np.array(names)[sd > MAX_ANGLE_SD]) for sd in motion.angle_deviations
    ]
    columns = (
        motion.frames,
        motion.times,
        motion.trusted,
        *pairs.T,
        uncertain,
    )
    header = ["frame", "time", "trusted", *header, "uncertain"]
    _write_csv(path, header, zip(*columns, strict=True), ".4g")


def write_mot(path: Path, motion: FileMotion) -> None:
    """Write the joint angles of a motion, in degrees, as a .mot file of OpenSim.

    Their standard deviations, where there are any, go to NAME_sd.sto.

    OpenSim's `Storage` reads number after number and ends at the first NaN, so all are
    finite: frames without a shape have no row, and an angle that is unknown in a frame
    is that of the nearest one, with the deviation `UNKNOWN_TABLE_SD`.
    """
    names = _angle_names(path, motion)
    rows = np.isfinite(motion.angles).any(axis=1)
    times = motion.times[rows]
    angles = _fill_from_nearest_frames(motion.angles[rows], motion.frames[rows])
    of = f" of {printable(motion.name)}" if motion.name else ""
    _write_storage(path, f"Coordinates{of}", names, times, angles)
    if np.isfinite(motion.angle_deviations).any():
        beside = path.with_name(f"{path.stem}_sd.sto")
        deviations = _cap_deviations(motion)[rows]
        _write_storage(beside, f"Standard deviations{of}", names, times, deviations)


UNKNOWN_TABLE_SD = 180.0
"""Standard deviation in degrees that stands for an unknown angle, and the largest."""


def _fill_from_nearest_frames(angles: Floats, frames: Integers) -> Floats:
    """Replace NaN in angles (f, a) by the value in the nearest frame, 0 if all are NaN.

    frames (f,): their numbers.
    """
    filled: Floats = np.zeros_like(angles)
    for number, column in enumerate(angles.T):
        known = np.flatnonzero(np.isfinite(column))
        if len(known):
            middles = (frames[known[1:]] + frames[known[:-1]]) / 2
            filled[:, number] = column[known[np.searchsorted(middles, frames)]]
    return filled


def _cap_deviations(motion: FileMotion) -> Floats:
    """Return the standard deviations (f, a) of angles, capped at `UNKNOWN_TABLE_SD`.

    That replaces unknown ones, too.
    """
    known = np.isfinite(motion.angle_deviations) & np.isfinite(motion.angles)
    sd = np.where(known, motion.angle_deviations, UNKNOWN_TABLE_SD)
    return np.asarray(np.minimum(sd, UNKNOWN_TABLE_SD))


def _write_storage(
    path: Path, title: str, names: Sequence[str], times: Floats, values: Floats
) -> None:
    """Write values (f, a) in degrees at times (f,) as a file of OpenSim's `Storage`."""
    head = [
        title,
        "version=1",
        f"nRows={len(values)}",
        f"nColumns={len(names) + 1}",
        "inDegrees=yes",
        "endheader",
        "\t".join(["time", *names]),
    ]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(head) + "\n")
        for row in np.column_stack([times, values]).tolist():
            file.write("\t".join(f"{value:.10g}" for value in row) + "\n")


MAX_NAMED_ANGLES = 4
"""Uncertain joint angles that a warning names, at most."""


def describe_uncertain_angles(motions: Sequence[FileMotion]) -> str:
    """Describe how many joint angles of all motions are uncertain, and which.

    These have a standard deviation above `MAX_ANGLE_SD`. "" where there are no angles.
    """
    names = motions[0].angle_names if motions else ()
    rows = [np.isfinite(motion.angles).any(axis=1) for motion in motions]
    count = len(names) * sum(int(of_motion.sum()) for of_motion in rows)
    if not count:
        return ""
    if not any(np.isfinite(motion.angle_deviations).any() for motion in motions):
        return f"{counted(count, 'joint angle')} without standard deviations"
    wide = np.concatenate(
        [
            _cap_deviations(motion)[of_motion] > MAX_ANGLE_SD
            for motion, of_motion in zip(motions, rows, strict=True)
        ]
    )
    if not wide.any():
        return (
            f"all {counted(count, 'joint angle')} have a standard deviation of at most"
            f" {MAX_ANGLE_SD:g} degrees"
        )
    shares = wide.mean(axis=0)
    widest = [number for number in np.argsort(-shares, kind="stable") if shares[number]]
    named = ", ".join(f"{names[k]} {shares[k]:.0%}" for k in widest[:MAX_NAMED_ANGLES])
    more = ", ..." if len(widest) > MAX_NAMED_ANGLES else ""
    return (
        f"{wide.sum():,} of {counted(count, 'joint angle')} have a standard deviation"
        f" above {MAX_ANGLE_SD:g} degrees ({named}{more})"
    )


def describe_angles_of_mot(motions: Sequence[FileMotion]) -> str:
    """Describe uncertain joint angles, with the hint to write TRC for kinematics.

    Inverse kinematics takes TRC in place of the angles.
    """
    hint = "for inverse kinematics write TRC"
    return "; ".join(filter(None, [describe_uncertain_angles(motions), hint]))


def _angle_names(path: Path, motion: FileMotion) -> Sequence[str]:
    """Return the names of a motion's joint angles; InputError where it has none."""
    if not motion.angle_names:
        fix = (
            "lift with the dictionary `people`, or rename landmarks to its joints"
            " (`rename`)"
        )
        raise input_error(path.name, "no joint angle follows from these landmarks", fix)
    return motion.angle_names


MAX_FRAMES = 65535
"""Largest number of a frame, in 16 bits."""

MAX_LABELS = 255
"""Of landmarks, and of bytes of a name: a byte counts each."""


def write_c3d(path: Path, motion: FileMotion) -> str:
    """Write one motion as C3D in mm; return a note on times off the constant rate.

    The note is "" where times are those of the one rate of a file. A missing point has
    the residual -1.

    Raises InputError for more frames or landmarks, or longer names, than a file can
    hold.
    """
    names, last = motion.landmark_names, motion.first + len(motion.points)
    labels = max([len(names), *(len(name.encode()) for name in names)])
    if labels > MAX_LABELS or not len(motion.points) or last > MAX_FRAMES:
        problem = (
            f"C3D holds {MAX_LABELS} landmarks at most, with names of"
            f" {MAX_LABELS} bytes, and "
        )
        problem += (
            f"the frames 1 to {MAX_FRAMES:,}: these are {len(names)}, and run to"
            f" {last:,}"
        )
        raise input_error(path.name, problem, "write TRC")
    points = 1000 * motion.points.transpose(1, 2, 0)  # (f, 3, p) -> (3, p, f)
    visible = np.isfinite(points).all(axis=0)
    file = load_ezc3d().c3d()
    file["header"]["points"]["first_frame"] = motion.first
    point = file["parameters"]["POINT"]
    point["RATE"]["value"], point["UNITS"]["value"] = [motion.rate], ["mm"]
    point["LABELS"]["value"] = list(names)
    for axis in "XY" if motion.axes.startswith("y up") else "":
        file.add_parameter("POINT", f"{axis}_SCREEN", [f"+{axis}"])
    file.add_parameter("SHAPEFIT", "AXES", [motion.axes])
    file.add_parameter("SHAPEFIT", "SIZE", [motion.size])
    homogeneous = [np.where(visible, points, np.nan), np.ones((1, *visible.shape))]
    file["data"]["points"] = np.concatenate(homogeneous)
    file["data"]["meta_points"]["residuals"] = np.where(visible, 0.0, -1.0)[None]
    file.write(str(path))
    if (
        path.stat().st_size < 16 * visible.size
    ):  # of a full disk the library says nothing
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    return motion.timing_note


def load_ezc3d() -> Any:
    """Import the module ezc3d; InputError where it is not installed."""
    try:
        import ezc3d
    except ImportError as error:
        fix = "run `pip install ezc3d`"
        raise input_error("C3D", "these files need the library ezc3d", fix) from error
    return ezc3d
