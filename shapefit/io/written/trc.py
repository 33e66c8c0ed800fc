"""Write TRC, the table of points in metres that OpenSim reads, a line per frame.

What is missing is an empty cell. Numbers have the fewest digits that read back to the same float.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import orjson

from shapefit.arrays import Floats
from shapefit.errors import printable
from shapefit.io.written.motion import Motion
from shapefit.io.written.outputs import by_individual, motion_output

BLOCK = 4096
"""Frames that are made text at a time."""

COLUMNS = (
    "DataRate CameraRate NumFrames NumMarkers Units OrigDataRate OrigDataStartFrame OrigNumFrames"
)
"""Of the header of TRC."""


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
            file.write(_lines(frames.tolist(), table))


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
