"""Caliscope's CSV of MediaPipe's landmarks: a row per point of a frame of a camera.

sync_index, port (or cam_id), frame_index, ..., point_id, img_loc_x, img_loc_y: a port is a video.
Points 0 to 32 are the body and have the names of mediapipe_33; hands (100, 200 and more) and face
(500 and more) keep their numbers as names. A point without a row is missing.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import counted, input_error
from shapefit.io.csv.numbers import read_numbers
from shapefit.io.csv.text import Section, read_rows, read_sections, split_columns
from shapefit.io.foreign.recording import Instances, Recording
from shapefit.io.skeletons import SKELETONS

Table = NDArray[np.float64]

CAMERAS = ("port", "cam_id")
NEEDED = ("frame_index", "point_id", "img_loc_x", "img_loc_y")
BLOCK = 4096
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
    frames = cameras[port], keys - port * 2 * LAST_FRAME
    column = np.searchsorted(ids, point[placed])
    cells = row * max(len(ids), 1) + column
    repeated = len(cells) - len(np.unique(cells))
    if repeated:
        notes += (f"{counted(repeated, 'point')} given twice, the last of each is used",)
    where = x[placed], y[placed]
    starts = {number: float(frames[1][frames[0] == number].min()) for number in cameras.tolist()}

    def blocks() -> Iterator[Instances]:
        order = np.argsort(row, kind="stable")
        for start in range(0, len(frames[0]), BLOCK):
            stop = min(start + BLOCK, len(frames[0]))
            mine = order[
                np.searchsorted(row, start, sorter=order) : np.searchsorted(row, stop, sorter=order)
            ]
            points = np.full((stop - start, len(ids), 2), np.nan)
            for axis, values in enumerate(where):
                points[row[mine] - start, column[mine], axis] = values[mine]
            ports, numbers = frames[0][start:stop], frames[1][start:stop]
            first = np.array([starts[port] for port in ports.tolist()])
            yield Instances(
                points=points,
                frames=(numbers - first).astype(np.int64),
                labels=[f"{number:g}" for number in numbers.tolist()],
                individuals=np.zeros(stop - start, np.int64),
                videos=[f"{video}/port {port:g}" for port in ports.tolist()],
            )

    video = path.name.partition(".")[0]
    body = SKELETONS["mediapipe_33"].landmark_names
    names = [body[int(i)] if 0 <= i < len(body) and i == int(i) else f"{i:g}" for i in ids.tolist()]
    return Recording(
        name=str(path),
        video=video,
        dimensions=2,
        landmark_names=tuple(names),
        blocks=blocks,
        frames=len(frames[0]),
        unit="px",
        notes=notes,
    )


def _read(path: Path) -> Table:
    """Return camera, frame, point, x and y of every row (n, 5), NaN where a cell is empty.

    Raises InputError for cells that are no numbers, and for rows of another length.
    """
    sections = read_sections(path)
    first = next(sections)
    header = _header(first.data.partition(b"\n")[0])
    camera = next(name for name in CAMERAS if name in header)
    places = [header.index(name) for name in (camera, *NEEDED)]
    parts = [_columns(first.without_header(), header, places, str(path))]
    parts += [_columns(section, header, places, str(path)) for section in sections]
    return np.concatenate(parts)


def _columns(section: Section, header: list[str], places: list[int], name: str) -> Table:
    if not section:
        return np.empty((0, len(places)))
    columns = split_columns(section, len(header))
    if columns is None:
        rows = []
        for line, row in read_rows(section, name):
            if len(row) != len(header):
                found = f"has {len(row)} cells for {len(header)} columns"
                raise input_error(f"{name}:{line}", found, "write one cell per column")
            rows.append(row)
        columns = [list(column) for column in zip(*rows, strict=True)] or [[] for _ in header]
    values = []
    for place in places:
        cells = columns[place]
        numbers = read_numbers(cells)
        if numbers.strange.any():
            bad = int(np.argmax(numbers.strange))
            found = f"'{cells[bad][:40]}' is no number (column {header[place]})"
            raise input_error(f"{name}:{section.line + bad}", found, "give numbers")
        values.append(numbers.values)
    return np.stack(values, axis=1)


def _header(line: bytes) -> list[str]:
    text = line.decode("utf-8-sig", "replace")
    return [cell.strip(' "\r') for cell in text.split(",")]
