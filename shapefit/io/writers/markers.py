"""Write the points of motions: TRC, the table that OpenSim reads, and C3D, by ezc3d."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from shapefit.arrays import Floats
from shapefit.errors import input_error, printable
from shapefit.io.layout import Layout
from shapefit.io.options import OutputOptions
from shapefit.io.writers.motion import Motion, MotionWriter, motion_output
from shapefit.io.writers.tables import write_angles

BLOCK = 4096
"""Frames that are made text at a time."""

COLUMNS = (
    "DataRate CameraRate NumFrames NumMarkers Units OrigDataRate OrigDataStartFrame OrigNumFrames"
)
"""Of the header of TRC."""


def write_trc(path: Path, motion: Motion) -> None:
    """Write one motion.

    The last cell of the first line, where readers expect nothing, says which way is up.
    """
    with path.open("wb") as file:
        file.write("".join(f"{line}\n" for line in _trc_header(motion)).encode())
        for start in range(0, len(motion.points), BLOCK):
            rows = slice(start, start + BLOCK)
            frames = motion.frames[rows]
            times = np.round(frames / motion.rate, 9)
            table = np.column_stack([times, _cells(motion, rows)])
            file.write(_lines(frames.tolist(), table))


trc_output = motion_output(write_trc, angles=write_angles)


def _trc_header(motion: Motion) -> Iterator[str]:
    count, p, rate = len(motion.points), len(motion.landmark_names), f"{motion.rate:.10g}"
    about = f"{motion.axes}; {motion.size}"
    name = printable(motion.name) or "motion"
    yield f"PathFileType\t4\t(X/Y/Z)\t{name}.trc\t{about}"
    yield COLUMNS.replace(" ", "\t")
    yield f"{rate}\t{rate}\t{count}\t{p}\tm\t{rate}\t{motion.first}\t{count}"
    names = "\t\t\t".join(printable(name) for name in motion.landmark_names)
    yield f"Frame#\tTime\t{names}\t\t"
    yield "\t\t" + "\t".join(f"{axis}{number}" for number in range(1, p + 1) for axis in "XYZ")


def _cells(motion: Motion, rows: slice) -> Floats:
    """Return x, y, z of one landmark after the other (f, 3p)."""
    points = motion.points[rows].swapaxes(1, 2)
    return points.reshape(len(points), 3 * len(motion.landmark_names))


def _lines(frames: Sequence[int], table: Floats) -> bytes:
    rows = orjson.dumps(np.ascontiguousarray(table), option=orjson.OPT_SERIALIZE_NUMPY)[2:-2]
    lines = rows.replace(b"null", b"").split(b"],[")
    return b"".join(
        b"%d\t%b\n" % (frame, line.replace(b",", b"\t"))
        for frame, line in zip(frames, lines, strict=True)
    )


MOST_FRAMES = 65535
"""Of a C3D file, and the largest number of a frame: its header has 16 bits for them."""

MOST_LABELS = 255
"""Landmarks of a C3D file, and bytes of the name of one: a byte counts each."""


def c3d_output(
    target: Path, form: Layout, options: OutputOptions
) -> AbstractContextManager[MotionWriter]:
    """Give a writer to C3D files, one per individual, that appear on a clean exit.

    Raises InputError, before any work, where ezc3d is not installed.
    """
    load_ezc3d()
    return motion_output(write_c3d, "mm")(target, form, options)


def load_ezc3d() -> Any:
    """Return the module. Raises InputError where it is not installed."""
    try:
        import ezc3d
    except ImportError as error:
        fix = "run `pip install ezc3d`"
        raise input_error("C3D", "these files need the library ezc3d", fix) from error
    return ezc3d


def write_c3d(path: Path, motion: Motion) -> None:
    """Write one motion in millimetres; a missing point has the residual -1.

    Raises InputError where it has more frames or landmarks, or longer names, than a file can hold.
    """
    names, last = motion.landmark_names, motion.first + len(motion.points)
    if max([len(names), *(len(name.encode()) for name in names)]) > MOST_LABELS:
        found = f"C3D holds {MOST_LABELS} landmarks at most, with names of {MOST_LABELS} bytes"
        raise input_error(motion.name or "C3D", found, "write TRC, or rename the landmark")
    if last > MOST_FRAMES:
        found = f"the frames run to {last:,}, and C3D numbers {MOST_FRAMES:,} at most"
        raise input_error(motion.name or "C3D", found, "write TRC, or shorter sequences")
    millimetres = 1000 * motion.points.transpose(1, 2, 0)  # (3, p, f)
    seen = np.isfinite(millimetres).all(axis=0)
    points = np.ones((4, *seen.shape))
    points[:3] = np.where(seen, millimetres, np.nan)
    file = load_ezc3d().c3d()
    file["header"]["points"]["first_frame"] = motion.first
    point = file["parameters"]["POINT"]
    point["RATE"]["value"], point["UNITS"]["value"] = [motion.rate], ["mm"]
    point["LABELS"]["value"] = list(names)
    if motion.axes.startswith("y up"):
        file.add_parameter("POINT", "X_SCREEN", ["+X"])
        file.add_parameter("POINT", "Y_SCREEN", ["+Y"])
    file.add_parameter("SHAPEFIT", "AXES", [motion.axes])
    file.add_parameter("SHAPEFIT", "SIZE", [motion.size])
    file["data"]["points"] = points
    file["data"]["meta_points"]["residuals"] = np.where(seen, 0.0, -1.0)[None]
    file.write(str(path))
    if path.stat().st_size < 16 * seen.size:  # of a full disk the library says nothing
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
