"""Motion as tables: joints in metres, and joint angles, as CSV and the .mot of OpenSim."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.errors import input_error, printable
from shapefit.io.writers.motion import Motion, motion_output

METRES = ("frame", "time", "landmark", "x", "y", "z", "sd", "trusted")
"""Columns; sd is that of the distance to the point, sqrt(sd_x^2 + sd_y^2 + sd_z^2)."""


def metres_columns(motion: Motion) -> dict[str, Any]:
    """Return METRES of one motion by name: a row per frame and landmark, nan where not known."""
    f, p = len(motion.points), len(motion.landmark_names)
    columns = (
        np.repeat(motion.frames, p),
        np.repeat(motion.frames / motion.rate, p),
        list(motion.landmark_names) * f,
        *(motion.points[:, axis].ravel() for axis in range(3)),
        motion.deviations.ravel(),
        [answer for answer in motion.trusted for _ in range(p)],
    )
    return dict(zip(METRES, columns, strict=True))


def write_metres(path: Path, motion: Motion) -> None:
    """Write a row per frame and landmark of one motion.

    Points that are not known are empty, and so are deviations without error bars.
    """
    columns = metres_columns(motion)
    _write_csv(path, METRES, zip(*columns.values(), strict=True), ".7g")


MAX_ANGLE_SD = 15.0
"""Standard deviation of a joint angle in degrees beyond which it says next to nothing."""


def write_angles(path: Path, motion: Motion) -> None:
    """Write a row per frame of one motion: each angle and its standard deviation, in degrees.

    The last column names the angles that are uncertain, see `MAX_ANGLE_SD`.
    """
    pairs = np.stack([motion.angles, motion.angle_deviations], axis=2).reshape(
        len(motion.points), -1
    )
    columns = (c for name in motion.angle_names for c in (name, f"{name}_sd"))
    header = ("frame", "time", "trusted", *columns, "uncertain")
    marks = (
        " ".join(
            name for name, sd in zip(motion.angle_names, row, strict=True) if sd > MAX_ANGLE_SD
        )
        for row in motion.angle_deviations
    )
    times = motion.frames / motion.rate
    rows = zip(motion.frames, times, motion.trusted, pairs, marks, strict=True)
    _write_csv(path, header, ((f, t, said, *row, mark) for f, t, said, row, mark in rows), ".4g")


def write_mot(path: Path, motion: Motion) -> None:
    """Write the joint angles of one motion in degrees, as OpenSim reads them; gaps are NaN.

    So are angles that are uncertain, see `MAX_ANGLE_SD`.
    """
    angles = np.where(motion.angle_deviations > MAX_ANGLE_SD, np.nan, motion.angles)
    table = np.column_stack([motion.frames / motion.rate, angles])
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"{printable(motion.name) or 'Coordinates'}\nversion=1\nnRows={len(table)}\n")
        file.write(f"nColumns={table.shape[1]}\ninDegrees=yes\nendheader\n")
        file.write("\t".join(["time", *motion.angle_names]) + "\n")
        for row in table.tolist():
            cells = (f"{value:.10g}" if np.isfinite(value) else "NaN" for value in row)
            file.write("\t".join(cells) + "\n")


def _write_csv(path: Path, header: Sequence[str], rows: Iterable[Any], digits: str) -> None:
    """Write rows of whole numbers, times, texts and other numbers; what is not known is empty."""

    def cell(value: Any) -> str:
        if not isinstance(value, float):
            return str(value)
        return format(value, digits) if np.isfinite(value) else ""

    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(header)
        table.writerows([frame, f"{time:.10g}", *map(cell, rest)] for frame, time, *rest in rows)


def _with_angles(motions: Sequence[Motion], place: str) -> tuple[list[Motion], str]:
    """Raise InputError where landmarks determine no joint angle."""
    for motion in motions:
        if not motion.angle_names:
            fix = "lift with the dictionary `people`, or rename landmarks to its joints (`rename`)"
            raise input_error(place, "no joint angle follows from these landmarks", fix)
    return list(motions), ""


metres_output = motion_output(write_metres)
angles_output = motion_output(write_angles, prepare=_with_angles, measured=True)
mot_output = motion_output(write_mot, prepare=_with_angles, measured=True)
