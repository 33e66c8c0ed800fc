"""Tables of no known tool, wide or long, and caliscope's, which are long.

A *wide* table has a row per image, and columns for each landmark; a *long* one has a row per
landmark of an image. Cells are parted by `,`, `;` or tabs; with the latter two the decimal point
may be a comma.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import InputError, abbreviate, input_error, printable
from shapefit.io.inputs import check_fits
from shapefit.io.readers.arrays import of_bodies
from shapefit.io.readers.columns import OF_A_POINT, Columns, parse_header
from shapefit.io.readers.poses import Poses, of_frames, video_name
from shapefit.io.readers.text_table import Table
from shapefit.io.skeletons import installed_skeletons
from shapefit.io.tidy_table import read_numbers

LAST_FRAME = 2.0**53
"""Numbers of frames are below it, whole and told apart."""

CALISCOPE = {
    "port": "sequence",
    "cam_id": "sequence",
    "frame_index": "frame",
    "point_id": "landmark",
    "img_loc_x": "x",
    "img_loc_y": "y",
}
"""Column of caliscope -> its role."""


def read_caliscope(paths: tuple[Path, ...]) -> Poses:
    """Read caliscope's CSV of MediaPipe's landmarks: a row per point of a frame of a camera.

    sync_index, port (or cam_id), frame_index, ..., point_id, img_loc_x, img_loc_y: a port is a
    video. Points 0 to 32 are the body and have the names of mediapipe_33; hands (100, 200 and more)
    and face (500 and more) keep their numbers as names. A point without a row is missing.
    """
    path = paths[0]
    table = Table(path)
    ((line, cells),) = table.first_rows(1)
    names = tuple(cell.strip(' "') for cell in cells)
    table.skip(line, names)
    roles = {CALISCOPE[name]: at for at, name in enumerate(names) if name in CALISCOPE}
    points, _, points_of, of = _read_long(table, Columns(",", names, roles, None, ()))
    ids, frames_of, ports = (_whole(path, own) for own in (points_of, of["frame"], of["sequence"]))
    by_number = np.argsort(_numbers(ids), kind="stable")
    body = installed_skeletons()["mediapipe_33"].landmark_names
    called = [body[int(i)] if i.isdigit() and int(i) < len(body) else i for i in ids]
    video = path.name.partition(".")[0]
    videos = [f"{video}/port {port}" for port in ports]
    order, frames = _in_order(frames_of, videos, table)
    return of_frames(
        path,
        points[order][:, by_number],
        labels=[frames_of[row] for row in order.tolist()],
        frame=np.array(frames, np.int64),
        video=[videos[row] for row in order.tolist()],
        landmark_names=tuple(called[place] for place in by_number.tolist()),
    )


def _whole(path: Path, cells: Sequence[str]) -> list[str]:
    """Return cells that are whole numbers as such: 5.0 is 5."""
    values, _ = read_numbers(cells)
    wrong = ~(np.abs(values) < LAST_FRAME) | (values % 1 != 0)
    if wrong.any():
        found = f"{cells[int(wrong.argmax())]!r} is no whole number"
        raise input_error(path, found, "give camera, frame and point of each row as numbers")
    return [str(int(value)) for value in values.tolist()]


ROLES_OF_IMAGES = ("item", "frame", "sequence", "individual")

BODY = 33
"""Landmarks of MediaPipe's body, which has a depth too."""


def read_any_table(paths: tuple[Path, ...]) -> Poses:
    """Read a table of no known tool. Raises InputError where it can be understood in two ways.

    z beside x and y is a third coordinate, unless there is a confidence of 0 to 1: then it is the
    depth that detectors guess, which is left out. Landmarks that are numbered have no names.
    """
    path = paths[0]
    table = Table(path)
    columns = _take_header(table)
    wide = columns.landmarks is not None
    points, confidence, names, cells = (_read_wide if wide else _read_long)(table, columns)
    numbers = _numbers(names)
    numbered = sorted(numbers) in [[*range(k, k + len(names))] for k in range(1 + wide)]
    if numbered:
        by_number = np.argsort(numbers)
        points = points[:, by_number]
        confidence = None if confidence is None else confidence[:, by_number]
    notes: tuple[str, ...] = ()
    metres = _metres(table, columns)
    if columns.others and not metres:
        notes += (f"columns left out: {abbreviate(list(map(printable, columns.others)))}",)
    if points.shape[2] == 3 and confidence is not None:
        points = points[..., :2]
        notes += ("z left out, the depth that a detector guesses beside its confidence",)
    points[np.isnan(points).any(axis=-1)] = np.nan
    images, frames, sequences, individuals = (cells.get(role) for role in ROLES_OF_IMAGES)
    labels, videos = images or frames, None
    if sequences is not None:
        videos = [f"{video_name(path)}/{name}" for name in sequences]
    order, places = np.arange(len(points)), None
    if frames is not None:
        order, places = _in_order(frames, videos or [""] * len(frames), table)
    depth = len(columns.axes) == 3 and points.shape[1] == BODY
    return of_bodies(
        path,
        points[order],
        None if confidence is None else confidence[order],
        labels=None if labels is None else [labels[row] for row in order.tolist()],
        frames=places,
        videos=None if videos is None else [videos[row] for row in order.tolist()],
        images=images is not None and frames is None and sequences is None,
        individuals=None if individuals is None else [_who(individuals[row]) for row in order],
        notes=notes,
        **metres,
        landmark_names=None if numbered else tuple(map(printable, names)),
        skeleton="mediapipe_33" if depth else None,
    )


METRES = {"frame", "time", "landmark", "x", "y", "z", "sd", "trusted"}
"""Columns of the tables in metres that are written here."""


def _metres(table: Table, columns: Columns) -> dict[str, Any]:
    """Return the unit and the frame rate of a table in metres that was written here."""
    if not {*columns.names} >= METRES or columns.landmarks is not None:
        return {}
    wanted = [columns.names.index(name) for name in ("frame", "time")]
    spans = np.ptp(table.read(wanted)[0], axis=0) if table.first_rows(1) else np.zeros(2)
    rate = round(float(spans[0] / spans[1]), 6) if spans.all() else 1.0
    return {"unit": "m", "frame_rate": None if rate == 1 else rate}


def _who(cell: str) -> str:
    """Return an individual as files of detectors name it: 3 is `id 3`, -1 and nothing nobody."""
    values, strange = read_numbers([cell])
    if strange[0] or np.isnan(values[0]):
        return printable(cell)
    return f"id {values[0]:g}" if values[0] >= 0 else ""


SHOWN = 2
"""Rows that an error shows as they were understood."""


def _take_header(table: Table) -> Columns:
    """Return what the columns hold, by the first line, which is left out."""
    columns = parse_header(table.text.partition("\n")[0])
    if columns is None:
        raise input_error(table.path, "does not name columns of landmarks", "see docs/formats.md")
    table.delimiter = columns.delimiter
    (line, _), *rows = table.first_rows(1 + SHOWN)
    table.hint = f" (understood so far: {columns.describe([row for _, row in rows])})"
    table.skip(line, columns.names)
    return columns


def _error(table: Table, line: int | None, found: str, fix: str) -> InputError:
    """Return an error that shows the first rows as they were understood."""
    place = str(table.path) if line is None else f"{table.path}:{line}"
    return input_error(place, found, fix + table.hint)


def _numbers(names: Sequence[str]) -> list[int]:
    """Return the numbers that landmarks are called, -1 for other names."""
    short = (
        name if name.isascii() and name.isdigit() and len(name) < 10 else "-1" for name in names
    )
    return list(map(int, short))


Taken = tuple[Floats, Floats | None, list[str], dict[str, list[str]]]
"""Points (n, p, 2 or 3), confidence (n, p), what landmarks are called, and cells by role (n)."""


def _read_wide(table: Table, columns: Columns) -> Taken:
    """Read a table with a row per image."""
    assert columns.landmarks is not None
    own = columns.landmarks
    named = [role for role in columns.roles if role in ROLES_OF_IMAGES]
    known = sorted({at for each in own.values() for at in each.values()})
    found, cells, _ = table.read(known, [columns.roles[role] for role in named], finite=True)
    padded = np.column_stack([found, np.full(len(found), np.nan)])
    place = {at: number for number, at in enumerate(known)}
    wanted = [
        [place.get(each.get(role, -1), -1) for role in (*columns.axes, "confidence")]
        for each in own.values()
    ]
    values = padded[:, wanted]
    scored = any("confidence" in each for each in own.values())
    cells_of = dict(zip(named, cells, strict=True))
    return values[..., :-1].copy(), values[..., -1] if scored else None, list(own), cells_of


def _read_long(table: Table, columns: Columns) -> Taken:
    """Read a table with a row per landmark of an image."""
    roles = columns.roles
    keys = [role for role in ("sequence", "item", "frame", "individual") if role in roles]
    wanted = [role for role in OF_A_POINT if role in roles]
    texts = [roles[role] for role in (*keys, "landmark")]
    found, cells, lines = table.read([roles[role] for role in wanted], texts, finite=True)
    *parts, landmark_cells = cells
    landmarks: dict[str, int] = {}
    images: dict[tuple[str, ...], int] = {}
    taken: dict[tuple[int, int], int] = {}
    for number, (name, *key) in enumerate(zip(landmark_cells, *parts, strict=True)):
        image = images.setdefault(tuple(key), len(images))
        first = taken.setdefault((image, landmarks.setdefault(name, len(landmarks))), number)
        if first != number:
            what = f"{name!r} of {' '.join(key)} is also in line {lines[first]}"
            fix = "keep one body per image, or part them by a column `sequence`"
            raise _error(table, int(lines[number]), what, fix)
    check_fits(str(table.path), 8 * len(wanted) * len(images) * len(landmarks), "what it holds")
    values = np.full((len(images), len(landmarks), len(wanted)), np.nan)
    rows, columns_of = np.array(list(taken), np.int64).reshape(-1, 2).T
    values[rows, columns_of] = found
    confidence = values[..., -1] if "confidence" in wanted else None
    of = zip(*images, strict=True) if images else ((),) * len(keys)
    cells_of = {role: list(own) for role, own in zip(keys, of, strict=True)}
    return values[..., : len(columns.axes)].copy(), confidence, list(landmarks), cells_of


def _in_order(
    cells: Sequence[str], videos: Sequence[str], table: Table
) -> tuple[NDArray[np.intp], list[int]]:
    """Return the order of images by video and frame, and each one's place from the video's first.

    Videos stand as they appear.
    """
    values, strange = read_numbers(cells)
    wrong = strange | ~(np.abs(values) < LAST_FRAME) | (values % 1 != 0)
    if wrong.any():
        what = f"the frame {cells[int(wrong.argmax())]!r} is no whole number"
        raise _error(table, None, what, "number the frames, or call the column `item`")
    place = {name: number for number, name in enumerate(dict.fromkeys(videos))}
    video = np.array([place[name] for name in videos], np.int64)
    starts = np.full(len(place), np.inf)
    np.minimum.at(starts, video, values)
    order = np.lexsort((values, video)).astype(np.intp)
    return order, (values - starts[video])[order].astype(np.int64).tolist()
