"""Write TRC, the text of markers that OpenSim reads: metres, a line per frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import orjson

from shapefit.errors import printable
from shapefit.io.written.motion import Motion
from shapefit.io.written.outputs import by_individual, motion_output

BLOCK = 4096
"""Frames that are made text at a time."""

COLUMNS = (
    "DataRate CameraRate NumFrames NumMarkers Units OrigDataRate OrigDataStartFrame OrigNumFrames"
)


def write_trc(path: Path, motions: Sequence[Motion]) -> None:
    """Write one motion; what is missing is an empty cell.

    The last cell of the first line, where readers expect nothing, says which way is up. Numbers
    have the fewest digits that read back to the same float.
    """
    (motion,) = motions
    with path.open("wb") as file:
        file.write("".join(f"{line}\n" for line in _header(motion)).encode())
        for start in range(0, len(motion.points), BLOCK):
            file.write(_lines(motion, slice(start, start + BLOCK)))


trc_output = motion_output(write_trc, by_individual)


def _header(motion: Motion) -> Iterator[str]:
    count, p, rate = len(motion.points), len(motion.landmark_names), f"{motion.rate:.10g}"
    about = f"{motion.axes}; {motion.size}"
    name = printable(motion.name) or "motion"
    yield f"PathFileType\t4\t(X/Y/Z)\t{name}.trc\t{about}"
    yield COLUMNS.replace(" ", "\t")
    yield f"{rate}\t{rate}\t{count}\t{p}\tm\t{rate}\t{motion.first}\t{count}"
    names = "\t\t\t".join(printable(name) for name in motion.landmark_names)
    yield f"Frame#\tTime\t{names}\t\t"
    yield "\t\t" + "\t".join(f"{axis}{number}" for number in range(1, p + 1) for axis in "XYZ")


def _lines(motion: Motion, rows: slice) -> bytes:
    points = motion.points[rows]
    numbers = motion.frames[rows]
    cells = np.ascontiguousarray(points.swapaxes(1, 2).reshape(len(points), points[0].size))
    table = np.column_stack([numbers / motion.rate, cells])
    text = orjson.dumps(table, option=orjson.OPT_SERIALIZE_NUMPY)[2:-2].replace(b"null", b"")
    lines = [line.replace(b",", b"\t") for line in text.split(b"],[")]
    return b"".join(b"%d\t%s\n" % each for each in zip(numbers.tolist(), lines, strict=True))
