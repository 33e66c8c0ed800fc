"""Tables of no known tool, wide or long, and caliscope's, which are long.

A *wide* table has a row per image, and columns for each landmark; a *long* one has a row per
landmark of an image. Cells are parted by `,`, `;` or tabs; with the latter two the decimal point
may be a comma.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import InputError, abbreviate, counted, input_error, printable
from shapefit.io.foreign.arrays import of_bodies
from shapefit.io.foreign.recording import Recording, video_name
from shapefit.io.foreign.text_table import Table
from shapefit.io.head import OF_A_POINT, Columns, numbers_of, parse_header
from shapefit.io.inputs import check_fits
from shapefit.io.skeletons import SKELETONS
from shapefit.io.tidy_table import read_numbers

LAST_FRAME = 2.0**53
"""Numbers of frames are below it, whole and told apart."""


def read_caliscope(paths: tuple[Path, ...]) -> Recording:
    """Read caliscope's CSV of MediaPipe's landmarks: a row per point of a frame of a camera.

    sync_index, port (or cam_id), frame_index, ..., point_id, img_loc_x, img_loc_y: a port is a
    video. Points 0 to 32 are the body and have the names of mediapipe_33; hands (100, 200 and more)
    and face (500 and more) keep their numbers as names. A point without a row is missing.
    """
    path = paths[0]
    table = Table(path)
    ((line, cells),) = table.first_rows(1)
    columns = [cell.strip(' "') for cell in cells]
    table.skip(line, columns)
    port = "port" if "port" in columns else "cam_id"
    wanted = (port, "frame_index", "point_id", "img_loc_x", "img_loc_y")
    values, _, _ = table.read([columns.index(name) for name in wanted])
    keys, xy = values[:, :3], values[:, 3:]
    whole = np.isfinite(keys).all(axis=1) & (np.abs(keys[:, 1]) < LAST_FRAME)
    whole &= keys[:, 1] == np.rint(keys[:, 1])
    placed = whole & np.isfinite(xy).all(axis=1)
    notes: tuple[str, ...] = ()
    if not whole.all():
        rows = counted(int((~whole).sum()), "row")
        notes += (f"{rows} without camera, frame or point left out",)
    images, row = np.unique(keys[whole, :2], axis=0, return_inverse=True)
    row = row.ravel()[placed[whole]]
    ids, column = np.unique(keys[placed, 2], return_inverse=True)
    repeated = len(row) - len(np.unique(row * max(len(ids), 1) + column))
    if repeated:
        notes += (f"{counted(repeated, 'point')} given twice, the last of each is used",)
    check_fits(str(path), 2 * 8 * len(images) * len(ids), "what it holds")
    points = np.full((len(images), len(ids), 2), np.nan)
    points[row, column] = xy[placed]
    ports, number = np.unique(images[:, 0], return_inverse=True)
    starts = np.full(len(ports), np.inf)
    np.minimum.at(starts, number, images[:, 1])
    video = path.name.partition(".")[0]
    body = SKELETONS["mediapipe_33"].landmark_names
    names = [body[int(i)] if 0 <= i < len(body) and i == int(i) else f"{i:g}" for i in ids.tolist()]
    return Recording(
        name=str(path),
        video=video,
        points=points,
        frames=(images[:, 1] - starts[number]).astype(np.int64),
        labels=[f"{frame:g}" for frame in images[:, 1].tolist()],
        individuals=np.zeros(len(images), np.int64),
        videos=[f"{video}/port {each:g}" for each in images[:, 0].tolist()],
        landmark_names=tuple(names),
        frame_count=len(images),
        unit="px",
        notes=notes,
    )


BODY = 33
"""Landmarks of MediaPipe's body, which has a depth too."""


def read_any_table(paths: tuple[Path, ...]) -> Recording:
    """Read a table of no known tool. Raises InputError where it can be understood in two ways.

    z beside x and y is a third coordinate, unless there is a confidence of 0 to 1: then it is the
    depth that detectors guess, which is left out.
    """
    path = paths[0]
    table = Table(path)
    columns = _take_header(table)
    taken = _read_long if columns.landmarks is None else _read_wide
    points, confidence, names, cells = taken(table, columns)
    notes: tuple[str, ...] = ()
    if columns.others:
        notes += (f"columns left out: {abbreviate(list(map(printable, columns.others)))}",)
    if points.shape[2] == 3 and confidence is not None:
        points = points[..., :2]
        notes += ("z left out, the depth that a detector guesses beside its confidence",)
    points[np.isnan(points).any(axis=-1)] = np.nan
    images, frames, sequences = (cells.get(role) for role in ("item", "frame", "sequence"))
    labels = images or frames
    videos = None
    if sequences is not None:
        videos = [f"{video_name(path)}/{name}" for name in sequences]
    order, numbers = np.arange(len(points)), None
    if frames is not None:
        order, numbers = _in_order(frames, videos or [""] * len(frames), table)
    deep = len(columns.axes) == 3
    return of_bodies(
        path,
        points[order],
        None if confidence is None else confidence[order],
        labels=None if labels is None else [labels[row] for row in order.tolist()],
        frames=numbers,
        videos=None if videos is None else [videos[row] for row in order.tolist()],
        images=images is not None and frames is None and sequences is None,
        notes=notes,
        landmark_names=None if names is None else tuple(map(printable, names)),
        default_keypoints="mediapipe_33" if deep and points.shape[1] == BODY else None,
    )


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


Taken = tuple[Floats, Floats | None, list[str] | None, dict[str, list[str]]]
"""Points (n, p, 2 or 3), confidence (n, p), names of the landmarks, and cells by role (n)."""


def _read_wide(table: Table, columns: Columns) -> Taken:
    """Read a table with a row per image."""
    assert columns.landmarks is not None
    own = columns.landmarks
    roles = [*columns.axes]
    scored = any("confidence" in each for each in own.values())
    wanted = [each.get(role) for role in (*roles, "confidence") for each in own.values()]
    known = sorted({at for at in wanted if at is not None})
    named = [role for role in columns.roles if role in ("item", "frame", "sequence")]
    texts = [columns.roles[role] for role in named]
    found, cells, _ = table.read(known, texts, finite=True)
    numbers = np.full((len(found), len(wanted)), np.nan)
    for place, at in enumerate(wanted):
        if at is not None:
            numbers[:, place] = found[:, known.index(at)]
    split = numbers.reshape(len(found), len(roles) + 1, len(own))
    points = split[:, :-1].transpose(0, 2, 1).copy()
    names = None if columns.numbered else list(own)
    confidence = split[:, -1] if scored else None
    return points, confidence, names, dict(zip(named, cells, strict=True))


def _read_long(table: Table, columns: Columns) -> Taken:
    """Read a table with a row per landmark of an image."""
    roles = columns.roles
    keys = [role for role in ("sequence", "item", "frame") if role in roles]
    wanted = [role for role in OF_A_POINT if role in roles]
    texts = [roles[role] for role in (*keys, "landmark")]
    found, cells, lines = table.read([roles[role] for role in wanted], texts, finite=True)
    *parts, landmark_cells = cells
    landmarks: dict[str, int] = {}
    images: dict[tuple[str, ...], int] = {}
    first: list[int] = []
    places = np.empty((len(found), 2), np.int64)
    taken: dict[tuple[int, int], int] = {}
    for number, (name, *key) in enumerate(zip(landmark_cells, *parts, strict=True)):
        image = images.setdefault(tuple(key), len(images))
        if image == len(first):
            first.append(number)
        place = image, landmarks.setdefault(name, len(landmarks))
        if place in taken:
            what = f"{name!r} of {' '.join(key)} is also in line {lines[taken[place]]}"
            fix = "keep one body per image, or part them by a column `sequence`"
            raise _error(table, int(lines[number]), what, fix)
        taken[place] = number
        places[number] = place
    numbers = numbers_of(landmarks)
    numbered = sorted(numbers) == list(range(len(numbers)))
    if numbered:
        places[:, 1] = np.array(numbers, np.int64)[places[:, 1]]
    check_fits(str(table.path), 8 * len(wanted) * len(images) * len(landmarks), "what it holds")
    values = np.full((len(images), len(landmarks), len(wanted)), np.nan)
    values[places[:, 0], places[:, 1]] = found
    confidence = values[..., -1] if "confidence" in wanted else None
    points = values[..., : len(columns.axes)].copy()
    names = None if numbered else list(landmarks)
    return (
        points,
        confidence,
        names,
        {role: [own[row] for row in first] for role, own in zip(keys, parts, strict=True)},
    )


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
