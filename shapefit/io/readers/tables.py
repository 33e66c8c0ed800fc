"""Tables of no known tool, and those of caliscope, anipose and FreeMoCap.

A table means the same whatever its delimiter, its capitals and the order of its
columns. What is guessed is said with the name of the column.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats, Integers, are_whole
from shapefit.errors import abbreviate, input_error, printable
from shapefit.io.csv_cells import read_numbers
from shapefit.io.formats import Head
from shapefit.io.readers.arrays import poses_from_bodies
from shapefit.io.readers.headers import OF_IMAGES, WEIGHTS, Body, Header, parse_header
from shapefit.io.readers.poses import (
    RATES,
    FrameFields,
    Poses,
    frames_of_times,
    name_individual,
    number_labels,
    require,
    video_name,
)
from shapefit.io.readers.text import Table, decode, read_table, read_text
from shapefit.io.skeletons import installed_skeletons
from shapefit.timeline import find_rate

METRES_PER_NAMED_UNIT = {
    "frame",
    "time",
    "landmark",
    "x",
    "y",
    "z",
    "sd",
    "trusted",
}  # as they are written here

MICROSECONDS = 6
"""Digits of seconds in which times differ."""

DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs"}

Line = tuple[str, str]

ImageKey = tuple[str, ...]
"""The cells of a row that tell its image from others."""


class TableReading(NamedTuple):
    """The poses of a table, and lines (title, text) on how its columns were read."""

    poses: Poses
    lines: tuple[Line, ...]


class Keys(NamedTuple):
    """The columns that tell images of a table apart, by role; notes on guesses."""

    columns: Mapping[str, int]
    guessed: tuple[str, ...] = ()


class Grid(NamedTuple):
    """The values (n, p) of a table by axis, landmark names (p), and cells (n) by role.

    used are the columns that were read.
    """

    axes: Mapping[str, Floats]
    landmarks: Sequence[str]
    cells: Mapping[str, Sequence[str]]
    keys: Keys
    used: set[int]


def is_table(head: Head) -> bool:
    """Whether a file is a table whose first line names columns of landmarks."""
    text = decode(head.text).replace("\r\n", "\n").replace("\r", "\n")
    first = "\n".join(text.split("\n", 2)[:2])
    table = head.has_suffix(".csv", ".tsv", ".txt") and "\0" not in first
    return table and parse_header(text) is not None


def is_anipose(head: Head) -> bool:
    """Whether a table has a column `..._ncams`, as only anipose writes it."""
    return any(name.endswith("_ncams") for name in head.columns)


def read_any_table(paths: tuple[Path, ...], dimensions: int | None = None) -> Poses:
    """Read a table of landmarks of any tool, by the names of its columns, as Poses.

    Points are in its unit.

    z beside a confidence is the depth that detectors guess, which is left out, except
    anipose's; otherwise it is a third coordinate. Of points in 2D and in 3D, those of
    the wanted `dimensions` are read, without a wish those in 2D.
    """
    return read_described_table(paths[0], dimensions).poses


def read_described_table(path: Path, dimensions: int | None = None) -> TableReading:
    """Read a table as Poses; return them, and lines on how its columns were read.

    Raises InputError, FormatError.
    """
    text = read_text(path)
    header = parse_header(text)
    require(header, "it does not name columns of landmarks, see docs/formats.md")
    assert header is not None
    table = read_table(path, text, header.names, header.delimiter, after=header.line)
    grid = _read_long(table, header)
    body: Body = {}
    if not header.is_long:
        body = _choose_body(header.bodies, dimensions)
        grid = _read_wide(table, header, body)
    confidence = _combine_weights(grid, header)
    with_depth = "z" in grid.axes
    if with_depth and "confidence" in grid.axes and not header.is_triangulated:
        with_depth = False
    axes = "xyz" if with_depth else "xy"
    points = np.stack([grid.axes[axis] for axis in axes], axis=-1)
    if with_depth and confidence is not None and not header.is_triangulated:
        points[confidence == 0] = np.nan
        confidence = None
    fields, rows, of_images = _find_images(path, grid, header)
    notes = [*grid.keys.guessed, *_notes_of_weights(grid, header)]
    if not header.is_long and len(header.bodies) > 1:
        notes.append(_note_on_bodies(header, body))
    if header.is_long and {*header.names} >= METRES_PER_NAMED_UNIT:
        fields |= {"unit": "m"}
    elif unused := header.list_unused(grid.used):
        listed = abbreviate([*map(printable, unused)])
        notes += [] if header.is_triangulated else [f"columns left out: {listed}"]
    fields["landmark_names"] = tuple(map(printable, grid.landmarks))
    fields["notes"] = tuple(notes)
    poses = poses_from_bodies(path, points, confidence, **fields)
    lines = (
        ("table", _describe_layout(header)),
        *of_images,
        *(("weights", text) for text in _notes_of_weights(grid, header)),
    )
    return TableReading(poses.take(rows), lines)


def _describe_layout(header: Header) -> str:
    """Describe a table: a row per image or landmark, and the delimiter of cells."""
    row = "landmark" if header.is_long else "image"
    between = DELIMITERS.get(header.delimiter, "quotes")
    return f"a row per {row}, cells between {between}"


# Cells.


def _choose_body(bodies: Sequence[Body], dimensions: int | None) -> Body:
    """Return the first body of `dimensions` dimensions, else the first 2D, else any.

    bodies: those of the most landmarks first.
    """
    for wanted in (dimensions, 2):
        for body in bodies:
            if wanted == (3 if _has_depth(body) else 2):
                return body
    return bodies[0]


def _has_depth(body: Body) -> bool:
    """Whether all landmarks of a body have z and no confidence: points in 3D."""
    return all("z" in axes and "confidence" not in axes for axes in body.values())


def _note_on_bodies(header: Header, body: Body) -> str:
    """Return a note that `body` is read, and the other bodies of the header are not."""

    def describe(one: Body) -> str:
        """Return the names of the first columns of a body, for the note."""
        axes = next(iter(one.values()))
        columns = [header.names[axes[axis]] for axis in "xyz" if axis in axes]
        return f"{', '.join(map(printable, columns))} ..."

    read = f"{describe(body)} are read, as {3 if _has_depth(body) else 2}D landmarks"
    others = [describe(one) for one in header.bodies if one is not body]
    return f"{read}; {' and '.join(others)} are not"


def _read_wide(table: Table, header: Header, body: Body) -> Grid:
    """Read the columns of a body in a table with a row per image."""
    for axis in WEIGHTS:  # of an image, for all its landmarks
        if axis in header.roles and not any(axis in axes for axes in body.values()):
            column = header.roles[axis]
            body = {name: {**axes, axis: column} for name, axes in body.items()}
    values = _read_columns(table, body)
    unknown = np.full(len(table.rows), np.nan)
    axes = {
        axis: np.stack(
            [values.get(own.get(axis, -1), unknown) for own in body.values()], axis=1
        )
        for axis in ("x", "y", "z", *WEIGHTS)
        if any(axis in own for own in body.values())
    }
    keys = _find_keys(table, header, None)
    texts = table.texts(*keys.columns.values())
    cells = dict(zip(keys.columns, texts, strict=True))
    used = {*keys.columns.values(), *values}
    return Grid(axes, [*body], cells, keys, used)


def _read_columns(table: Table, body: Body) -> dict[int, Floats]:
    """Return column -> values (n,) of each column of a body; yes is 1, no is 0."""
    numbers, flags = _columns_by_kind(body)
    values = dict(zip(numbers, table.numbers(numbers, finite=True).T, strict=True))
    values.update(zip(flags, table.flags(flags).T, strict=True))
    return values


def _columns_by_kind(body: Body) -> tuple[list[int], list[int]]:
    """Return the indices of a body's columns of numbers, and of those of yes or no."""
    flagged = ("visible", "occluded")
    places = [item for axes in body.values() for item in axes.items()]
    numbers = {column for axis, column in places if axis not in flagged}
    flags = {column for axis, column in places if axis in flagged}
    return sorted(numbers), sorted(flags)


def _read_long(table: Table, header: Header) -> Grid:
    """Read a table with a row per landmark of an image; an empty Grid if it has not."""
    if not header.is_long:
        return Grid({}, (), {}, Keys({}), set())
    (names,) = table.texts(header.roles["landmark"])
    names = _strip_decimals(names)
    keys = _find_keys(table, header, names)
    roles = {a: header.roles[a] for a in ("x", "y", "z", *WEIGHTS) if a in header.roles}
    values = _read_columns(table, {"": roles})
    texts = table.texts(*keys.columns.values()) or [[""] * len(names)]
    images, landmarks, places = _place_rows(table, keys, names, texts)
    image, landmark = np.array(places, np.int64).reshape(-1, 2).T
    axes = {}
    for axis, column in roles.items():
        axes[axis] = np.full((len(images), len(landmarks)), np.nan)
        axes[axis][image, landmark] = values[column]
    keyed = zip(*images, strict=True) if images else ((),) * len(keys.columns)
    cells = dict(zip(keys.columns, keyed, strict=False))
    used = {*keys.columns.values(), *values, header.roles["landmark"]}
    return Grid(axes, landmarks, cells, keys, used)


def _strip_decimals(names: list[str]) -> list[str]:
    """Write names 1.0, 2.0 as 1, 2, if all are of this form.

    pandas writes 1.0 where cells are empty.
    """
    if all(name.endswith(".0") and name[:-2].isdecimal() for name in names):
        return [name[:-2] for name in names]
    return names


def _place_rows(
    table: Table, keys: Keys, names: Sequence[str], texts: Sequence[Sequence[str]]
) -> tuple[list[ImageKey], list[str], list[tuple[int, int]]]:
    """Return unique images and landmarks, and (image, landmark) indices of each row.

    An image is its `texts` in the columns `keys`; `names` (n,) are the landmarks of
    rows. Raises InputError for a landmark that is twice in an image.
    """
    images: dict[ImageKey, int] = {}
    landmarks: dict[str, int] = {}
    rows: dict[tuple[int, int], int] = {}
    for row, (name, *key) in enumerate(zip(names, *texts, strict=True)):
        image = images.setdefault(tuple(key), len(images))
        place = (image, landmarks.setdefault(name, len(landmarks)))
        first = rows.setdefault(place, row)
        if first != row:
            of_image = f" of {' '.join(key)}" if keys.columns else ""
            line = table.lines[first]
            problem = f"{printable(name)!r}{printable(of_image)} is also in line {line}"
            fix = "keep one body per image, or separate them by a column `sequence`"
            if not keys.columns:
                fix = "tell the images apart by a column `item`, or `frame`"
            raise input_error(f"{table.path}:{table.lines[row]}", problem, fix)
    return [*images], [*landmarks], [*rows]


# Weights.


def _combine_weights(grid: Grid, header: Header) -> Floats | None:
    """Return weights (n, p) = confidence x visible x (1 - occluded), None without any.

    Each is 1 where its cell is empty. Raises FormatError for what is no confidence and
    no yes or no.
    """
    weights = None
    for axis in WEIGHTS:
        if axis not in grid.axes:
            continue
        values = grid.axes[axis]
        if axis != "confidence":
            _check_flags(values, axis, _name_of_column(axis, header))
        flags_of_coco = np.isin(values[np.isfinite(values)], (0, 1, 2)).all()
        if axis != "occluded" and flags_of_coco:
            values = np.minimum(values, 1)  # 2 of COCO is seen, 1 is marked
        if axis == "occluded":
            values = 1 - values
        values = np.nan_to_num(values, nan=1.0)
        weights = values if weights is None else weights * values
    return weights


def _check_flags(values: Floats, axis: str, column: str) -> None:
    """Raise FormatError for weights outside 0 to 1, or 0 to 2 for `visible` as of COCO.

    axis: visible or occluded; column: the name of the weights in the message.
    """
    finite = values[np.isfinite(values)]
    of_coco = axis == "visible" and np.isin(finite, (0, 1, 2)).all()
    most = 2 if of_coco else 1
    wrong = finite[(finite < 0) | (finite > most)]
    found = f"{wrong[0]:g}" if len(wrong) else ""
    require(not len(wrong), f"{found} in the column {column}; write 0 or 1, no or yes")


def _name_of_column(axis: str, header: Header) -> str:
    """Return the name of the first column of a weight, such as `visible`."""
    if axis in header.roles:
        return printable(header.names[header.roles[axis]])
    columns = [
        own[axis] for body in header.bodies for own in body.values() if axis in own
    ]
    return printable(header.names[min(columns)])


def _notes_of_weights(grid: Grid, header: Header) -> list[str]:
    """Return notes on columns read as weights, of landmarks or of a whole image."""
    notes = []
    meaning = {"visible": "0 is hidden", "occluded": "1 is hidden"}
    for axis in WEIGHTS:
        if axis not in grid.axes:
            continue
        column = _name_of_column(axis, header)
        if axis in meaning:
            notes.append(f"column {column!r} read as weights: {meaning[axis]}")
        if not header.is_long and header.roles.get(axis, -1) in grid.used:
            notes.append(f"column {column!r} weights all landmarks of its image")
    return notes


# Images.


def _find_keys(table: Table, header: Header, landmarks: Sequence[str] | None) -> Keys:
    """Find the columns that tell images apart: item, frame, time, sequence, individual.

    landmarks: those of the rows of a long table, None for a wide one. Where no column
    is called item, frame or time, one of unique cells names the images: of texts, or
    the first, or what is called an individual. Rows without a number or a time are
    single images.
    """
    columns = {a: header.roles[a] for a in OF_IMAGES if a in header.roles}
    columns = {a: at for a, at in columns.items() if any(table.texts(at)[0])}
    if "time" in columns and not _has_times(table, columns):
        del columns["time"]
    if {"item", "frame", "time"} & columns.keys():
        return Keys(columns)
    if header.is_long or "sequence" not in columns:
        column = _find_naming_column(table, header, landmarks, columns)
        if column is not None:
            columns = {a: at for a, at in columns.items() if at != column}
            named = printable(header.describe(column))
            text = f"items are named by the column {named}, their rows single images"
            fix = "call it `frame` if these are frames of one video"
            return Keys({**columns, "item": column}, (f"{text}; {fix}",))
    if header.is_long or "sequence" in columns or _is_freemocap(header):
        return Keys(columns)
    text = "rows are taken for single images, as no column names or numbers them"
    fix = "call a column `frame` if they are frames of one video"
    return Keys(columns, (f"{text}; {fix}",))


def _has_times(table: Table, columns: Mapping[str, int]) -> bool:
    """Whether the column of times is all numbers, one for each image.

    The latter where another column numbers the images.
    """
    values, wrong = read_numbers(table.texts(columns["time"])[0])
    if wrong.any() or not np.isfinite(values).all():
        return False
    if "frame" not in columns:
        return True
    others = [at for role, at in columns.items() if role != "time"]
    images = {*zip(*table.texts(*others), strict=True)}
    timed = {*zip(*table.texts(*others, columns["time"]), strict=True)}
    return len(timed) == len(images)


def _find_naming_column(
    table: Table,
    header: Header,
    landmarks: Sequence[str] | None,
    columns: Mapping[str, int],
) -> int | None:
    """Return the index of a column whose cells can name the images, None without one.

    Columns of another role do not count, but for those of individual and sequence.
    """
    taken = {*header.roles.values()}
    taken |= {
        at for body in header.bodies for own in body.values() for at in own.values()
    }
    free = [column for column in range(len(header.names)) if column not in taken]
    asked = [columns[a] for a in ("individual", "sequence") if a in columns]
    asked = asked if header.is_long else asked[:1]
    numbered = None
    for column in sorted({*free, *asked}):
        (cells,) = table.texts(column)
        if not _are_image_names(cells, landmarks):
            continue
        values, wrong = read_numbers(cells)
        if wrong.any():
            return column
        whole = bool(are_whole(values).all())
        if whole and numbered is None and (column == 0 or column in asked):
            numbered = column
    return numbered


def _are_image_names(cells: Sequence[str], landmarks: Sequence[str] | None) -> bool:
    """Whether a column can name images: each row, or groups of unique `landmarks`."""
    if "" in cells or not cells:
        return False
    names = {*cells}
    if landmarks is None:
        return len(names) == len(cells)
    pairs = {*zip(cells, landmarks, strict=True)}
    return len(pairs) == len(cells) and len(names) < len(cells)


def _find_images(
    path: Path, grid: Grid, header: Header
) -> tuple[FrameFields, Integers, tuple[Line, ...]]:
    """Find frames, times, labels, videos and individuals of a table's images.

    Returns these as fields of `Poses`, the indices that sort images by video and frame,
    and lines that say how items and frames were read.
    """
    cells, count = grid.cells, len(grid.axes["x"])
    stem = video_name(path)
    order = np.arange(count)

    def column_of(role: str) -> str:
        """Return how messages name the column of a role."""
        return f"column {printable(header.describe(grid.keys.columns[role]))}"

    fields: FrameFields = {}
    if "individual" in cells:
        fields["individual"] = [*map(_parse_individual, cells["individual"])]
    if "sequence" in cells:
        videos = [*map(printable, cells["sequence"])]
        prefix = "" if "item" in cells else f"{stem}/"
        fields["video"] = [f"{prefix}{video}" for video in videos]
    if "item" in cells:
        fields |= {"labels": [*map(printable, cells["item"])], "named": True}
        items: Line = ("items", column_of("item"))
    if "frame" in cells:
        named = "item" in cells
        fields["frame"], order = _parse_frames(
            cells["frame"], fields.get("video"), named
        )
        labels = [
            cell if cell.isdecimal() else number_labels(read_numbers([cell])[0])[0]
            for cell in cells["frame"]
        ]
        fields.setdefault("labels", labels)
        frames: Line = ("frames", f"numbers in {column_of('frame')}")
    elif "time" in cells:
        seconds, _ = read_numbers(cells["time"])
        fields["frame"] = _frames_in_videos(seconds, fields.get("video"))
        order, _ = _sort_by_video(seconds, fields.get("video"))
        fields.setdefault("labels", number_labels(seconds))
        frames = ("frames", f"times in {column_of('time')}")
    elif "sequence" in cells or ("item" not in cells and _is_freemocap(header)):
        frames = ("frames", "the rows in their order")
        fields |= {"unit": "mm"} if _is_freemocap(header) else {}
    else:
        frames = ("frames", "none: single images")
        fields |= _fields_of_single_images(stem, fields, count)
    if "time" in cells:
        seconds, _ = read_numbers(cells["time"])
        rate = find_rate(fields["frame"][order], seconds[order])
        if rate is not None and RATES[0] <= rate <= RATES[1]:  # else no seconds
            fields |= {"time": seconds, "frame_rate": rate}
    if "item" not in cells:
        items = ("items", f"'{stem}/...', by frame or number")
    return fields, order, (items, frames)


def _fields_of_single_images(stem: str, fields: FrameFields, count: int) -> FrameFields:
    """Return labels and individuals of `count` images that are no frames of a video.

    stem: the name of the file, with which labels begin where `fields` has none.
    """
    people = fields.get("individual", [""] * count)
    if "labels" in fields:
        return {"individual": people, "unordered": True}
    parts = [
        filter(None, (stem, who, str(row) if count > 1 else ""))
        for row, who in enumerate(people)
    ]
    labels = ["/".join(part) for part in parts]
    unknown = [""] * count
    return {"labels": labels, "named": True, "individual": unknown, "unordered": True}


def _parse_individual(cell: str) -> str:
    """Return the name of the individual in a cell: `id 3` for 3, "" for -1 or empty.

    Files of detectors name it in this way.
    """
    (value,), wrong = read_numbers([cell])
    return printable(cell) if wrong.any() else name_individual(float(value))


def _parse_integers(cells: Sequence[str]) -> list[int]:
    """Convert cells to integers; FormatError for the first that is none."""
    values, _ = read_numbers(cells)
    wrong = np.flatnonzero(~are_whole(values))
    unfit = [cells[row] for row in wrong[:1].tolist()]
    require(
        not unfit,
        f"{unfit} is no whole number; number the frames, or call the column `item`",
    )
    return [*map(int, values.tolist())]


def _parse_frames(
    cells: Sequence[str], videos: Sequence[str] | None, named: bool
) -> tuple[Integers, Integers]:
    """Convert cells to frame numbers, from 0 in each video; return their order, too.

    The order is the indices that sort rows by video and frame. Frames of items that are
    named keep their numbers, as in our CSV. Raises FormatError for no whole number.
    """
    frames = np.array(_parse_integers(cells), np.int64)
    order, first = _sort_by_video(frames, videos)
    return frames if named else frames - frames[first], order


def _sort_by_video(
    values: Floats | Integers, videos: Sequence[str] | None
) -> tuple[Integers, Integers]:
    """Return the indices that sort rows by video and value, and each row's first row.

    Both (n,). The first row is that of the least value in the same video.
    """
    videos = videos or [""] * len(values)
    rank = {video: number for number, video in enumerate(dict.fromkeys(videos))}
    ranks = np.array([rank[video] for video in videos], np.intp)
    order = np.lexsort((values, ranks))
    return order, order[np.searchsorted(ranks[order], ranks)]


def _frames_in_videos(seconds: Floats, videos: Sequence[str] | None) -> Integers:
    """Convert times (n,) in seconds to frame numbers, which begin at 0 in each video.

    Where the times since the first of their video lie on one grid of equal steps, the
    steps are counted; else the times. videos (n,): the name of each time's video.
    """
    _, first = _sort_by_video(seconds, videos)
    since = np.round(seconds - seconds[first], MICROSECONDS)
    moments, place = np.unique(since, return_inverse=True)
    on_grid = frames_of_times(moments, None)
    if on_grid is not None:
        return np.array(on_grid, np.int64)[place]
    frames = np.zeros(len(seconds), np.int64)
    for start in np.unique(first):
        rows = first == start
        _, frames[rows] = np.unique(seconds[rows], return_inverse=True)
    return frames


# Tables of known tools.


def _is_freemocap(header: Header) -> bool:
    """Whether the columns of a table are FreeMoCap's, whose rows are frames."""
    return any({"body_nose", "body_left_hip"} <= {*body} for body in header.bodies)


def is_caliscope(head: Head) -> bool:
    """Whether a table has the columns that only caliscope writes."""
    return {"frame_index", "point_id", "img_loc_x", "img_loc_y"} <= {*head.columns}


def read_caliscope(paths: tuple[Path, ...]) -> Poses:
    """Read caliscope's CSV of MediaPipe: a row per point of a frame of a camera.

    A port (or cam_id) is a video. Points 0 to 32 are the body and have the names of
    mediapipe_33; hands (100, 200 and more) and face (500 and more) keep their numbers
    as names.
    """
    poses = read_any_table(paths)
    assert poses.landmark_names is not None
    ids = _parse_integers(poses.landmark_names)
    body = dict(enumerate(installed_skeletons()["mediapipe_33"].landmark_names))
    stem = paths[0].name.partition(".")[0]
    return replace(
        poses,
        points=poses.points[:, np.argsort(ids)],
        video=[f"{stem}/port {video.rpartition('/')[2]}" for video in poses.videos],
        landmark_names=tuple(body.get(number, str(number)) for number in sorted(ids)),
        unit="px",
        notes=(),
    )
