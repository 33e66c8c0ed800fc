"""Text tables of landmarks: one reader of cells and numbers, and an adapter for each tool's header.

A *wide* table has a row per image, and columns for each landmark; a *long* one has a row per
landmark of an image. Cells are parted by `,`, `;` or tabs; with the latter two the decimal point
may be a comma.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import InputError, abbreviate, counted, input_error, printable
from shapefit.io.checks import input_problems
from shapefit.io.foreign.arrays import of_bodies
from shapefit.io.foreign.deeplabcut import SAVE, arrange, skeleton_edges
from shapefit.io.foreign.motion_text import read_plain
from shapefit.io.foreign.recording import (
    Recording,
    image_labels,
    number_label,
    one_individual,
    video_name,
)
from shapefit.io.head import (
    OF_A_POINT,
    Columns,
    anipose_landmarks,
    decode,
    numbers_of,
    parse_header,
)
from shapefit.io.inputs import check_fits, read_whole
from shapefit.io.skeletons import SKELETONS
from shapefit.io.tidy_table import read_numbers, read_rows, refuse_zero_bytes

EMPTY = {"", "na", "n/a", "#n/a", "none", "null", "-", "nan"}
"""Cells, in small letters, that say that there is no number."""

MISSING_FIX = "write a number, or leave the cell empty where the landmark is missing"

SHOWN = 2
"""Rows that an error shows as they were understood."""

Row = tuple[int, list[str]]
"""A line, and its cells."""


class Table:
    """The rows of a text table, below its header.

    `rows` have a cell for each of `width` columns; rows without any content are left out. With
    `padded` they may end before their empty cells.
    """

    def __init__(self, path: Path, delimiter: str = ",") -> None:
        """Read a file."""
        self.path = path
        text = decode(read_whole(path)).replace("\r\n", "\n").replace("\r", "\n")
        refuse_zero_bytes(text, str(path), 1)
        self.delimiter = delimiter
        self._text, self._line = text, 1
        self.names: tuple[str, ...] = ()
        self.padded = False
        self._hint = ""

    def first_rows(self, count: int) -> list[Row]:
        """Return the first rows, which stay where they are."""
        return [(line, self._split(row)) for line, row in islice(self._rows(), count)]

    def drop(self, header: Sequence[Row], names: Sequence[str]) -> None:
        """Take the header away, whose columns have these names in messages."""
        last = header[-1][0]
        lines = self._text.split("\n", last - self._line + 1)
        self._text = lines[-1] if len(lines) > last - self._line + 1 else ""
        self._line, self.names = last + 1, tuple(names)

    def take_header(self) -> Columns:
        """Return what the columns hold, by the first line, which is taken away."""
        columns = parse_header(self._text.partition("\n")[0])
        if columns is None:
            raise input_error(
                self.path, "does not name columns of landmarks", "see docs/formats.md"
            )
        self.delimiter = columns.delimiter
        header, *rows = self.first_rows(1 + SHOWN)
        self._hint = f" (understood so far: {columns.describe([row for _, row in rows])})"
        self.drop([header], columns.names)
        return columns

    def error(self, line: int | None, found: str, fix: str) -> InputError:
        """Return an error that shows the first rows as they were understood."""
        place = str(self.path) if line is None else f"{self.path}:{line}"
        return input_error(place, found, fix + self._hint)

    def read(
        self, numbers: Sequence[int], texts: Sequence[int], *, finite: bool = False
    ) -> tuple[Floats, list[list[str]], Integers]:
        """Return columns of numbers (n, ...), NaN for empty cells; of texts; and the lines (n,).

        Raises InputError for rows of another width and for cells that are no numbers, or not
        `finite` ones.
        """
        rows = list(self._rows())
        lines = np.array([line for line, _ in rows], np.int64)
        plain = [row for _, row in rows if isinstance(row, str)]
        if not texts and self.delimiter == "," and len(plain) == len(rows):
            table = read_plain(plain, ",", len(self.names))  # several times as fast
            if table is not None:
                return table[:, numbers], [], lines
        cells = self._columns(rows)
        told: list[tuple[int, str]] = []
        found = np.empty((len(rows), len(numbers)))
        for place, column in enumerate(numbers):
            found[:, place], wrong = self._numbers(cells[column], finite)
            for row in np.flatnonzero(wrong)[:10].tolist():
                cell = printable(cells[column][row].strip()[:40])
                what = f"{cell!r} is no number (column {printable(self.names[column])})"
                where = f"{self.path}:{lines[row]}"
                told.append((row, f"{where}: {what}; {MISSING_FIX}{self._hint}"))
        if told:
            raise input_problems([line for _, line in sorted(told, key=lambda each: each[0])])
        return found, [[*map(str.strip, cells[column])] for column in texts], lines

    def _rows(self) -> Iterator[tuple[int, str | list[str]]]:
        """Yield the line and the text of each row that has content; of a quoted table its cells."""
        if '"' in self._text:
            rows = read_rows([self._text], self._line, str(self.path), self.delimiter)
            yield from (each for each in rows if any(map(str.strip, each[1])))
            return
        nothing = f" \t{self.delimiter}"
        for line, text in enumerate(self._text.split("\n"), self._line):
            if text.strip(nothing):
                yield line, text

    def _split(self, row: str | list[str]) -> list[str]:
        return row.split(self.delimiter) if isinstance(row, str) else row

    def _columns(self, rows: Sequence[tuple[int, str | list[str]]]) -> list[tuple[str, ...]]:
        """Return the cells of rows by column."""
        width = len(self.names)
        split = [self._split(row) for _, row in rows]
        if self.padded:
            split = [cells + [""] * (width - len(cells)) for cells in split]
        told = [
            f"{self.path}:{line}: has {len(cells)} cells for {width} columns; "
            "write one cell per column"
            for (line, _), cells in zip(rows, split, strict=True)
            if len(cells) != width
        ]
        if told:
            raise input_problems(told)
        return list(zip(*split, strict=True)) or [()] * width

    def _numbers(self, cells: Sequence[str], finite: bool) -> tuple[Floats, Flags]:
        """Return a column as numbers, and which cells are none."""
        values, strange = read_numbers(cells)
        if strange.any():
            plain = ["" if (cell := each.strip()).lower() in EMPTY else cell for each in cells]
            if self.delimiter != "," and not any("." in cell for cell in plain):
                plain = [cell.replace(",", ".") for cell in plain]
            values, strange = read_numbers(plain)
        return values, strange | np.isinf(values) if finite else strange


HEADER = ("scorer", "individuals", "bodyparts", "coords")


def read_deeplabcut(paths: tuple[Path, ...]) -> Recording:
    """Read DeepLabCut CSV, which Lightning Pose writes, too: a row for each frame, columns by name.

    Three lines of names (scorer, bodyparts, coords) come first, four with `individuals`. The first
    column is the number of the frame, or the path of an image, which may be split in three columns.
    """
    path = paths[0]
    table = Table(path)
    rows = table.first_rows(len(HEADER) + 1)
    header: dict[str, list[str]] = {}
    for _, row in rows:
        if row[0].strip() not in HEADER or row[0].strip() in header:
            break
        header[row[0].strip()] = [cell.strip() for cell in row]
    for name in ("bodyparts", "coords"):
        if name not in header:
            raise input_error(f"{path}:1", f"there is no line {name!r}", SAVE)
    levels = [header[name] for name in HEADER[1:] if name in header]
    coords, scorers = header["coords"], header.get("scorer", [])
    if sizes := sorted({len(level) for level in levels} - {len(coords)}):
        found = f"the lines of names have {sizes[0]} and {len(coords)} cells"
        raise input_error(f"{path}:1", found, "give each column a name in each line")
    named = [column for column in range(1, len(coords)) if coords[column]]
    layout = arrange(
        f"{path}:1",
        [
            (scorers[at] if at < len(scorers) else "", *(level[at] for level in levels))
            for at in named
        ],
    )
    data = [row for _, row in rows[len(header) :]]
    numbered = not data or not read_numbers([data[0][0]])[1].any()
    index_named = data and not numbered and "." not in data[0][0] and not any(data[0][1:])
    table.drop(
        rows[: len(header) + bool(index_named)],
        ["/".join(each) for each in zip(*levels, strict=True)],
    )
    table.padded = not numbered
    indices = list(range(named[0] if named else 1))
    if numbered:
        values, _, lines = table.read([0, *named], [])
        labels = _frame_numbers(path, values[:, 0], lines)
        values = values[:, 1:]
    else:
        values, parts, _ = table.read(named, indices)
        labels = image_labels(["/".join(filter(None, row)) for row in zip(*parts, strict=True)])
    return Recording(
        name=str(path),
        video=video_name(path),
        **layout.instances(values, labels),
        landmark_names=layout.landmarks,
        individual_names=layout.individuals,
        notes=layout.notes,
        edges=skeleton_edges(path, layout.landmarks),
        frame_count=len(labels),
        unit=layout.unit,
    )


def _frame_numbers(path: Path, numbers: Floats, lines: Integers) -> list[str]:
    """Return numbers of frames, or times, as texts. Raises InputError where one is none."""
    wrong = ~np.isfinite(numbers)
    if wrong.any():
        found = "does not say its frame, and others are numbers"
        raise input_error(f"{path}:{lines[int(np.argmax(wrong))]}", found, "number the frames")
    return [number_label(value) for value in numbers.tolist()]


def read_anipose(paths: tuple[Path, ...]) -> Recording:
    """Read the 3D points that anipose writes: x, y, z, error, cameras and score of each landmark.

    They are in the unit of anipose; the score is their confidence. Raises InputError for rows of
    another width, and cells that are no numbers.
    """
    path = paths[0]
    table = Table(path)
    header = table.first_rows(1)
    columns = [cell.strip() for cell in header[0][1]]
    table.drop(header, columns)
    names = anipose_landmarks(columns)
    place = {name: number for number, name in enumerate(columns)}
    left = [name[:-2] for name in columns if name.endswith("_x") and name[:-2] not in names]
    kept = [place[f"{name}_{axis}"] for name in names for axis in "xyz"]
    scored = all(f"{name}_score" in place for name in names)
    scores = [place[f"{name}_score"] for name in names] if scored else []
    frame = [place["fnum"]] if "fnum" in place else []
    values, _, _ = table.read([*kept, *scores, *frame], [])
    points = values[:, : len(kept)].reshape(len(values), len(names), 3)
    own = values[:, len(kept) : len(kept) + len(scores)]
    labels = None
    if frame and np.isfinite(values[:, -1]).all():
        labels = [f"{number:.15g}" for number in values[:, -1].tolist()]
    return Recording(
        name=str(path),
        video=path.stem,
        **one_individual(points, labels),
        confidence=np.where(np.isfinite(own), np.clip(own, 0, None), np.nan) if scored else None,
        landmark_names=names,
        notes=(f"points left out: {abbreviate(left)}",) if left else (),
    )


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
    header = table.first_rows(1)
    columns = [cell.strip(' "') for cell in header[0][1]]
    table.drop(header, columns)
    port = "port" if "port" in columns else "cam_id"
    wanted = (port, "frame_index", "point_id", "img_loc_x", "img_loc_y")
    values, _, _ = table.read([columns.index(name) for name in wanted], [])
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
    columns = table.take_header()
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
            raise table.error(int(lines[number]), what, fix)
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
        raise table.error(None, what, "number the frames, or call the column `item`")
    place = {name: number for number, name in enumerate(dict.fromkeys(videos))}
    video = np.array([place[name] for name in videos], np.int64)
    starts = np.full(len(place), np.inf)
    np.minimum.at(starts, video, values)
    order = np.lexsort((values, video)).astype(np.intp)
    return order, (values - starts[video])[order].astype(np.int64).tolist()
