"""Write tables as DeepLabCut writes triangulated points: x, y, z in columns, a row per frame."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import orjson

from shapefit.io.written.motion import Motion
from shapefit.io.written.outputs import motion_output

SCORER = "shapefit"
BLOCK = 4096
"""Frames that are made text at a time."""


def by_video(motions: Sequence[Motion]) -> dict[str, list[Motion]]:
    """Put the individuals of a video in one file; a sequence is `video/individual`, or a video."""
    groups: dict[str, list[Motion]] = {}
    for motion in motions:
        groups.setdefault(motion.name.rpartition("/")[0] or motion.name, []).append(motion)
    return groups


def write_table(path: Path, motions: Sequence[Motion]) -> None:
    """Write the individuals of a video, in metres; the row `individuals` where there are several.

    The index is the number of the frame; what is missing is an empty cell.
    """
    first = min(motion.first for motion in motions)
    last = max(motion.first + len(motion.points) for motion in motions)
    with path.open("wb") as file:
        file.write(_header(motions))
        for start in range(first, last, BLOCK):
            file.write(_lines(motions, start, min(start + BLOCK, last)))


table_output = motion_output(write_table, by_video)


def _header(motions: Sequence[Motion]) -> bytes:
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


def _lines(motions: Sequence[Motion], start: int, stop: int) -> bytes:
    """Return the lines of frames start to stop."""
    parts = []
    for motion in motions:
        cells = np.full((stop - start, 3 * len(motion.landmark_names)), np.nan)
        own = slice(max(start - motion.first, 0), max(stop - motion.first, 0))
        points = motion.points[own]
        at = max(motion.first - start, 0)
        cells[at : at + len(points)] = points.swapaxes(1, 2).reshape(len(points), cells.shape[1])
        parts.append(cells)
    table = np.ascontiguousarray(np.hstack(parts))
    return b"".join(_texts(table, start))


def _texts(table: np.ndarray, start: int) -> Iterator[bytes]:
    text = orjson.dumps(table, option=orjson.OPT_SERIALIZE_NUMPY)[2:-2].replace(b"null", b"")
    for number, line in enumerate(text.split(b"],["), start):
        yield b"%d,%s\n" % (number, line)
