"""Write tables of points in metres, a line per frame: TRC, which OpenSim reads, and DeepLabCut's.

What is missing is an empty cell. Numbers have the fewest digits that read back to the same float.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import orjson

from shapefit.arrays import Floats
from shapefit.errors import printable
from shapefit.io.written.motion import Motion
from shapefit.io.written.outputs import by_individual, by_video, motion_output

BLOCK = 4096
"""Frames that are made text at a time."""

COLUMNS = (
    "DataRate CameraRate NumFrames NumMarkers Units OrigDataRate OrigDataStartFrame OrigNumFrames"
)
"""Of the header of TRC."""

SCORER = "shapefit"


def write_trc(path: Path, motions: Sequence[Motion]) -> None:
    """Write one motion.

    The last cell of the first line, where readers expect nothing, says which way is up.
    """
    (motion,) = motions
    with path.open("wb") as file:
        file.write("".join(f"{line}\n" for line in _trc_header(motion)).encode())
        for start in range(0, len(motion.points), BLOCK):
            rows = slice(start, start + BLOCK)
            frames = motion.frames[rows]
            table = np.column_stack([frames / motion.rate, _cells(motion, rows)])
            file.write(_lines(frames.tolist(), table, b"\t"))


trc_output = motion_output(write_trc, by_individual)


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


def write_table(path: Path, motions: Sequence[Motion]) -> None:
    """Write the individuals of a video as DeepLabCut writes triangulated points.

    The row `individuals` is there where there are several; the index is the number of the frame.
    """
    first = min(motion.first for motion in motions)
    last = max(motion.first + len(motion.points) for motion in motions)
    with path.open("wb") as file:
        file.write(_table_header(motions))
        for start in range(first, last, BLOCK):
            frames = range(start, min(start + BLOCK, last))
            file.write(_lines(frames, np.hstack([_at(each, frames) for each in motions]), b","))


table_output = motion_output(write_table, by_video)


def _table_header(motions: Sequence[Motion]) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    each = [(motion.name.rpartition("/")[2], motion.landmark_names) for motion in motions]
    columns = [(who, landmark) for who, landmarks in each for landmark in landmarks]
    writer.writerow(["scorer", *(SCORER for _ in columns for _ in "xyz")])
    if len(motions) > 1:
        writer.writerow(["individuals", *(who for who, _ in columns for _ in "xyz")])
    writer.writerow(["bodyparts", *(landmark for _, landmark in columns for _ in "xyz")])
    writer.writerow(["coords", *(axis for _ in columns for axis in "xyz")])
    return text.getvalue().encode()


def _at(motion: Motion, frames: range) -> Floats:
    """Return the points (f, 3p) at these frames, NaN where the motion has not begun or is over."""
    own = slice(max(frames.start - motion.first, 0), max(frames.stop - motion.first, 0))
    points = _cells(motion, own)
    cells = np.full((len(frames), 3 * len(motion.landmark_names)), np.nan)
    at = max(motion.first - frames.start, 0)
    cells[at : at + len(points)] = points
    return cells


def _cells(motion: Motion, rows: slice) -> Floats:
    """Return x, y, z of one landmark after the other (f, 3p)."""
    points = motion.points[rows].swapaxes(1, 2)
    return points.reshape(len(points), 3 * len(motion.landmark_names))


def _lines(frames: Sequence[int], table: Floats, separator: bytes) -> bytes:
    rows = orjson.dumps(np.ascontiguousarray(table), option=orjson.OPT_SERIALIZE_NUMPY)[2:-2]
    lines = rows.replace(b"null", b"").split(b"],[")
    return b"".join(
        b"%d%b%b\n" % (frame, separator, line.replace(b",", separator))
        for frame, line in zip(frames, lines, strict=True)
    )
