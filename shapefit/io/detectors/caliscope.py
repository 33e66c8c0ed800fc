"""Caliscope's CSV of MediaPipe's landmarks: a row per point of a frame of a camera.

sync_index, port (or cam_id), frame_index, ..., point_id, img_loc_x, img_loc_y: a port is a video.
Points 0 to 32 are the body and have the names of mediapipe_33; hands (100, 200 and more) and face
(500 and more) keep their numbers as names. A point without a row is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.errors import counted, input_error
from shapefit.io.csv.text import read_columns, read_numbers, read_sections
from shapefit.io.foreign.recording import Instances, Recording
from shapefit.io.memory import check_fits
from shapefit.io.problems import Problems
from shapefit.io.skeletons import SKELETONS

CAMERAS = ("port", "cam_id")
NEEDED = ("frame_index", "point_id", "img_loc_x", "img_loc_y")
LAST_FRAME = 2.0**40


def is_caliscope(path: Path, head: bytes) -> bool:
    """Whether the first line names these columns."""
    names = set(_header(head.partition(b"\n")[0]))
    return {*NEEDED} <= names and bool(names & {*CAMERAS})


def record(paths: tuple[Path, ...]) -> Recording:
    """Return the points of all cameras of a file, which is read whole, 40 bytes a point."""
    path = paths[0]
    camera, frame, point, x, y = _read(path).T
    whole = np.isfinite([camera, frame, point]).all(axis=0) & (np.abs(frame) < LAST_FRAME)
    whole &= frame == np.rint(frame)
    placed = whole & np.isfinite(x) & np.isfinite(y)
    notes: tuple[str, ...] = ()
    if not whole.all():
        rows = counted(int((~whole).sum()), "row")
        notes += (f"{rows} without camera, frame or point left out",)
    cameras, number = np.unique(camera[whole], return_inverse=True)
    ids = np.unique(point[placed])
    keys, place = np.unique(number * 2 * LAST_FRAME + frame[whole], return_inverse=True)
    row = place[placed[whole]]
    port = np.floor_divide(keys + LAST_FRAME, 2 * LAST_FRAME).astype(np.intp)
    frames = keys - port * 2 * LAST_FRAME
    column = np.searchsorted(ids, point[placed])
    cells = row * max(len(ids), 1) + column
    repeated = len(cells) - len(np.unique(cells))
    if repeated:
        notes += (f"{counted(repeated, 'point')} given twice, the last of each is used",)
    check_fits(str(path), 2 * 8 * len(keys) * len(ids), "what it holds")
    points = np.full((len(keys), len(ids), 2), np.nan)
    points[row, column] = np.column_stack([x[placed], y[placed]])
    starts = np.full(len(cameras), np.inf)
    np.minimum.at(starts, port, frames)
    video = path.name.partition(".")[0]
    every = Instances(
        points=points,
        frames=(frames - starts[port]).astype(np.int64),
        labels=[f"{number:g}" for number in frames.tolist()],
        individuals=np.zeros(len(keys), np.int64),
        videos=[f"{video}/port {number:g}" for number in cameras[port].tolist()],
    )
    body = SKELETONS["mediapipe_33"].landmark_names
    names = [body[int(i)] if 0 <= i < len(body) and i == int(i) else f"{i:g}" for i in ids.tolist()]
    return Recording(
        name=str(path),
        video=video,
        dimensions=2,
        landmark_names=tuple(names),
        blocks=every.blocks,
        frames=len(keys),
        unit="px",
        notes=notes,
    )


def _read(path: Path) -> Floats:
    """Return camera, frame, point, x and y of every row (n, 5), NaN where a cell is empty.

    Raises InputError for cells that are no numbers, and for rows of another length.
    """
    parts: list[Floats] = []
    header: list[str] = []
    problems = Problems()
    for section in read_sections(path):
        if not header:
            header = _header(section.data.partition(b"\n")[0])
            camera = next(name for name in CAMERAS if name in header)
            section = section.without_header()
        columns, lines = read_columns(section, len(header), str(path), problems)
        problems.raise_if_any()
        wanted = {name: columns[header.index(name)] for name in (camera, *NEEDED)}
        parts.append(np.column_stack([_numbers(path, *each, lines) for each in wanted.items()]))
    return np.concatenate(parts)


def _numbers(path: Path, name: str, cells: Sequence[str], lines: Integers) -> Floats:
    numbers = read_numbers(cells)
    if numbers.strange.any():
        bad = int(np.argmax(numbers.strange))
        found = f"'{cells[bad][:40]}' is no number (column {name})"
        raise input_error(f"{path}:{lines[bad]}", found, "give numbers")
    return numbers.values


def _header(line: bytes) -> list[str]:
    text = line.decode("utf-8-sig", "replace")
    return [cell.strip(' "\r') for cell in text.split(",")]
