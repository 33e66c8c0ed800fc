"""Tables of text and arrays: caliscope's CSV, tables of no known tool, NumPy's files.

A *wide* table has a row per image, and columns for each landmark; a *long* one has a row per
landmark of an image. Cells are separated by `,`, `;` or tabs; with the latter two the decimal point
may be a comma.
"""

from __future__ import annotations

import csv
import math
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import InputError, abbreviate, input_error, printable
from shapefit.io.checks import input_problems, warn_of_zeros
from shapefit.io.inputs import LARGEST_BYTES, check_fits, in_words, read_whole
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.columns import OF_IMAGES, Columns, decode, parse_header
from shapefit.io.readers.images import are_series
from shapefit.io.readers.json_file import read_json
from shapefit.io.readers.poses import (
    FRACTION,
    Poses,
    are_fractions,
    of_frames,
    parsing,
    require,
    video_name,
)
from shapefit.io.skeletons import installed_skeletons
from shapefit.io.tidy_table import read_numbers

# Rows of text.

EMPTY = {"", "na", "n/a", "#n/a", "none", "null", "-", "nan"}
"""Cells, in small letters, that say that there is no number."""

Row = tuple[int, str | list[str]]
"""A line, and its text, or its cells where there are quotes."""


def read_text(path: Path) -> str:
    r"""Return a text with lines that end in \n. Raises InputError for a zero byte."""
    text = decode(read_whole(path)).replace("\r\n", "\n").replace("\r", "\n")
    if "\0" in text:
        line = 1 + text.count("\n", 0, text.index("\0"))
        raise input_error(f"{path}:{line}", "is not text (a zero byte)", "save it as CSV in UTF-8")
    return text


def split_rows(path: Path, text: str, delimiter: str | None = ",") -> list[Row]:
    """Return the rows of a text that have any content; without a delimiter spaces separate cells.

    Raises InputError for the line of a quote that is never closed.
    """
    if '"' not in text or delimiter is None:
        empty = f" \t{delimiter or ''}"
        return [(n, line) for n, line in enumerate(text.split("\n"), 1) if line.strip(empty)]
    rows: list[Row] = []
    reader, line = csv.reader(text.split("\n"), delimiter=delimiter, strict=True), 1
    try:
        for cells in reader:
            if any(map(str.strip, cells)):
                rows.append((line, cells))
            line = reader.line_num + 1
    except csv.Error as error:
        fix = "put cells with commas or quotes in double quotes, and double the quotes in them"
        open_quote = "unexpected end" in str(error)
        problem = "a quote is never closed" if open_quote else f"a bad cell ({error})"
        raise input_error(f"{path}:{line}", problem, fix) from error
    return rows


@dataclass
class Table:
    """Rows of cells below a header, in columns of these names.

    With `padded` rows may end before their empty cells, or after more of them. `hint` ends every
    message.
    """

    path: Path
    rows: list[Row]
    names: Sequence[str] = ()
    delimiter: str | None = ","
    padded: bool = False
    hint: str = ""

    def cells(self, row: int) -> list[str]:
        """Return the cells of a row."""
        text = self.rows[row][1]
        cells = text.split(self.delimiter) if isinstance(text, str) else text
        return [cell.strip() for cell in cells]

    def error(self, line: int, problem: str, fix: str) -> InputError:
        """Return an error of a line."""
        return input_error(f"{self.path}:{line}", problem, fix + self.hint)

    def read(
        self,
        numbers: Sequence[int],
        texts: Sequence[int] = (),
        *,
        finite: bool = False,
        empty: bool = True,
    ) -> tuple[Floats, list[list[str]], Integers]:
        """Return columns of numbers (n, ...), NaN for empty cells; of texts; and the lines (n,).

        Raises InputError for rows of another width, and for cells that are no numbers, or not
        `finite` ones, or that have none, unless they may be `empty`.
        """
        lines = np.array([line for line, _ in self.rows], np.int64)
        values = self._read_plain()
        if values is not None and (empty or not np.isnan(values).any()):
            rows = [self.cells(row) for row in range(len(lines) if texts else 0)]
            return values[:, numbers], [[row[column] for row in rows] for column in texts], lines
        columns = self._columns(lines.tolist())
        problems: list[tuple[int, str]] = []
        values = np.empty((len(lines), len(numbers)))
        for place, column in enumerate(numbers):
            values[:, place], wrong = self._numbers(columns[column])
            wrong |= finite & np.isinf(values[:, place])
            wrong |= (not empty) & np.isnan(values[:, place])
            for row in np.flatnonzero(wrong)[:10].tolist():
                name = printable(self.names[column])
                problem = f"{printable(columns[column][row][:40])!r} is no number (column {name})"
                fix = "write a number, or leave the cell empty where the landmark is missing"
                error = self.error(lines[row], problem, fix if empty else "correct it")
                problems.append((row, str(error)))
        if problems:
            problems.sort(key=lambda problem: problem[0])
            raise input_problems([text for _, text in problems])
        return values, [list(columns[column]) for column in texts], lines

    def _read_plain(self) -> Floats | None:
        """Return rows of plain numbers alone (n, width), NaN for empty cells; None for others.

        JSON reads them several times as fast as cell by cell.
        """
        rows = [row for _, row in self.rows if isinstance(row, str)]
        if not rows or len(rows) < len(self.rows):
            return None
        rows = rows if self.delimiter else [row.strip() for row in rows]
        delimiter, width = self.delimiter or ("\t" if "\t" in rows[0] else " "), len(self.names)
        if any(row.count(delimiter) != width - 1 for row in rows):
            return None
        text = f",{','.join(rows).replace(delimiter, ',')},"
        text = text.replace(",,", ",null,").replace(",,", ",null,")[1:-1]
        try:
            values = orjson.loads(f"[{text}]")
        except orjson.JSONDecodeError:
            return None
        if len(values) != len(rows) * width or not {*map(type, values)} <= {float, int, type(None)}:
            return None
        return np.array(values, np.float64).reshape(len(rows), width)

    def _columns(self, lines: Sequence[int]) -> list[tuple[str, ...]]:
        """Return the cells of all rows by column."""
        width, rows = len(self.names), [self.cells(row) for row in range(len(lines))]
        if self.padded:
            rows = [row if any(row[width:]) else (row + [""] * width)[:width] for row in rows]
        problems = [
            f"{self.path}:{line}: has {len(row)} cells for {width} columns; "
            "write one cell per column"
            for line, row in zip(lines, rows, strict=True)
            if len(row) != width
        ]
        if problems:
            raise input_problems(problems)
        return list(zip(*rows, strict=True)) or [()] * width

    def _numbers(self, cells: Sequence[str]) -> tuple[Floats, Flags]:
        """Return a column as numbers, and which cells are none."""
        values, wrong = read_numbers(cells)
        if wrong.any():
            cells = ["" if cell.lower() in EMPTY else cell for cell in cells]
            if self.delimiter != "," and not any("." in cell for cell in cells):
                cells = [cell.replace(",", ".") for cell in cells]
            values, wrong = read_numbers(cells)
        return values, wrong


# Tables of no known tool, and caliscope's.


class Grid(NamedTuple):
    """What a table holds: values (n, p, axes); names (p); cells (n) of item, frame and so on."""

    values: Floats
    names: list[str]
    cells: dict[str, list[str]]


def read_caliscope(paths: tuple[Path, ...]) -> Poses:
    """Read caliscope's CSV of MediaPipe's landmarks: a row per point of a frame of a camera.

    sync_index, port (or cam_id), frame_index, ..., point_id, img_loc_x, img_loc_y: a port is a
    video. Points 0 to 32 are the body and have the names of mediapipe_33; hands (100, 200 and more)
    and face (500 and more) keep their numbers as names. A point without a row is missing.
    """
    path, renamed = paths[0], {"img_loc_x": "x", "img_loc_y": "y", "point_id": "landmark"}
    renamed |= {"port": "sequence", "cam_id": "sequence", "frame_index": "frame"}
    rows = split_rows(path, read_text(path))
    header = [cell.strip('"') for cell in Table(path, rows[:1]).cells(0)]
    table = Table(path, rows[1:], header)
    roles = {renamed[name]: column for column, name in enumerate(header) if name in renamed}
    grid = _read_long(table, Columns(",", tuple(header), roles, None, ()))
    ids, frames, ports = (
        _whole_numbers(path, cells)
        for cells in (grid.names, grid.cells["frame"], grid.cells["sequence"])
    )
    body = dict(enumerate(installed_skeletons()["mediapipe_33"].landmark_names))
    by_number = np.argsort(ids, kind="stable")
    stem = path.name.partition(".")[0]
    videos = [f"{stem}/port {port}" for port in ports]
    order, places = _in_order([*map(str, frames)], videos, table)
    return of_frames(
        path,
        grid.values[order][:, by_number],
        labels=[str(frames[row]) for row in order],
        frame=places,
        video=[videos[row] for row in order],
        landmark_names=tuple(body.get(ids[n], str(ids[n])) for n in by_number.tolist()),
    )


def _whole_numbers(path: Path, cells: Sequence[str]) -> list[int]:
    """Return cells that are whole numbers as such: 5.0 is 5."""
    values, _ = read_numbers(cells)
    wrong = ~(np.abs(values) < MAX_FRAME) | (values % 1 != 0)
    if wrong.any():
        problem = f"{cells[int(wrong.argmax())]!r} is no whole number"
        raise input_error(path, problem, "give camera, frame and point of each row as numbers")
    return [int(value) for value in values.tolist()]


METRES = {"frame", "time", "landmark", "x", "y", "z", "sd", "trusted"}
"""Columns of the tables in metres that are written here."""


def read_any_table(paths: tuple[Path, ...]) -> Poses:
    """Read a table of no known tool. Raises InputError where it can be understood in two ways.

    z beside x and y is a third coordinate, unless there is a confidence of 0 to 1: then it is the
    depth that detectors guess, which is left out. Landmarks that are numbered have no names.
    """
    path = paths[0]
    text = read_text(path)
    columns = parse_header(text.partition("\n")[0])
    if columns is None:
        raise input_error(path, "does not name columns of landmarks", "see docs/formats.md")
    rows = split_rows(path, text, columns.delimiter)[1:]
    table = Table(path, rows, columns.names, columns.delimiter)
    examples = columns.describe([table.cells(row) for row in range(min(len(rows), 2))])
    table.hint = f" (understood so far: {examples})"
    wide = columns.landmarks is not None
    values, names, cells = (_read_wide if wide else _read_long)(table, columns)
    order = _by_number(names, 1 if wide else 0)
    values = values if order is None else values[:, order]
    scored = "confidence" in columns.axes
    points, confidence = (values[..., :-1], values[..., -1]) if scored else (values, None)
    fields: dict[str, Any] = {}
    if not wide and {*columns.names} >= METRES:
        steps = np.ptp(table.read([columns.names.index(n) for n in ("frame", "time")])[0], axis=0)
        rate = round(float(steps[0] / steps[1]), 6) if steps.all() else 1.0
        fields = {"unit": "m", "frame_rate": None if rate == 1 else rate}
    elif columns.others:
        fields["notes"] = (f"columns left out: {abbreviate([*map(printable, columns.others)])}",)
    if points.shape[2] == 3 and scored:
        points = points[..., :2]
        note = "z left out, the depth that a detector guesses beside its confidence"
        fields["notes"] = (*fields.get("notes", ()), note)
    body = "z" in columns.axes and points.shape[1] == 33  # of MediaPipe, which has a depth too
    videos = [f"{video_name(path)}/{name}" for name in cells.get("sequence", ())] or None
    rows_of, places = np.arange(len(points)), None
    if "frame" in cells:
        rows_of, places = _in_order(cells["frame"], videos or [""] * len(points), table)

    def ordered(values: Sequence[str] | None) -> list[str] | None:
        return None if values is None else [values[row] for row in rows_of.tolist()]

    people = ordered(cells.get("individual"))
    return of_bodies(
        path,
        np.where(np.isnan(points).any(axis=2, keepdims=True), np.nan, points)[rows_of],
        None if confidence is None else confidence[rows_of],
        labels=ordered(cells.get("item") or cells.get("frame")),
        frames=places,
        videos=ordered(videos),
        images=cells.keys() & OF_IMAGES <= {"item", "individual"} and "item" in cells,
        individuals=None if people is None else [*map(_name_individual, people)],
        landmark_names=None if order is not None else tuple(map(printable, names)),
        skeleton="mediapipe_33" if body else None,
        **fields,
    )


def _by_number(names: Sequence[str], first: int) -> list[int] | None:
    """Return the order of landmarks that are called by all numbers from 0, or up to `first`, on."""
    if not all(name.isascii() and name.isdigit() and len(name) < 10 for name in names):
        return None
    numbers = [*map(int, names)]
    start = min(numbers, default=0)
    whole = start <= first and sorted(numbers) == [*range(start, start + len(names))]
    return sorted(range(len(names)), key=numbers.__getitem__) if whole else None


def _name_individual(cell: str) -> str:
    """Return an individual as files of detectors name it: 3 is `id 3`, -1 and nothing nobody."""
    values, wrong = read_numbers([cell])
    if wrong[0] or np.isnan(values[0]):
        return printable(cell)
    return f"id {values[0]:g}" if values[0] >= 0 else ""


def _read_wide(table: Table, columns: Columns) -> Grid:
    """Read a table with a row per image."""
    assert columns.landmarks is not None
    roles = [role for role in OF_IMAGES if role in columns.roles]
    numbers = sorted({at for axes in columns.landmarks.values() for at in axes.values()})
    cells, texts, _ = table.read(numbers, [columns.roles[role] for role in roles], finite=True)
    values = np.full((len(cells), len(columns.landmarks), len(columns.axes)), np.nan)
    for number, axes in enumerate(columns.landmarks.values()):
        for axis, column in axes.items():
            values[:, number, columns.axes.index(axis)] = cells[:, numbers.index(column)]
    return Grid(values, [*columns.landmarks], dict(zip(roles, texts, strict=True)))


def _read_long(table: Table, columns: Columns) -> Grid:
    """Read a table with a row per landmark of an image."""
    roles = [role for role in OF_IMAGES if role in columns.roles]
    texts = [columns.roles[role] for role in ("landmark", *roles)]
    numbers = [columns.roles[axis] for axis in columns.axes]
    cells, (landmark_cells, *keys), lines = table.read(numbers, texts, finite=True)
    landmarks: dict[str, int] = {}
    images: dict[tuple[str, ...], int] = {}
    rows: dict[tuple[int, int], int] = {}
    for row, (name, *key) in enumerate(zip(landmark_cells, *keys, strict=True)):
        image = images.setdefault(tuple(key), len(images))
        first = rows.setdefault((image, landmarks.setdefault(name, len(landmarks))), row)
        if first != row:
            problem = f"{name!r} of {' '.join(key)} is also in line {lines[first]}"
            fix = "keep one body per image, or separate them by a column `sequence`"
            raise table.error(lines[row], problem, fix)
    size = len(images), len(landmarks), len(columns.axes)
    check_fits(str(table.path), 8 * math.prod(size), "what it holds")
    values = np.full(size, np.nan)
    at, landmark = np.array([*rows], np.int64).reshape(-1, 2).T
    values[at, landmark] = cells
    of_images = zip(*images, strict=True) if images else ((),) * len(roles)
    by_role = {role: [*texts] for role, texts in zip(roles, of_images, strict=True)}
    return Grid(values, [*landmarks], by_role)


MAX_FRAME = 2.0**53
"""Numbers of frames are below it, whole and told apart."""


def _in_order(
    cells: Sequence[str], videos: Sequence[str], table: Table
) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Return the order of images by video and frame, and each one's place from the video's first.

    Videos stand as they appear.
    """
    values, wrong = read_numbers(cells)
    wrong |= ~(np.abs(values) < MAX_FRAME) | (values % 1 != 0)
    if wrong.any():
        problem = f"the frame {cells[int(wrong.argmax())]!r} is no whole number"
        fix = f"number the frames, or call the column `item`{table.hint}"
        raise input_error(table.path, problem, fix)
    numbers = {name: number for number, name in enumerate(dict.fromkeys(videos))}
    video = np.array([numbers[name] for name in videos], np.int64)
    starts = np.full(len(numbers), np.inf)
    np.minimum.at(starts, video, values)
    order = np.lexsort((values, video))
    return order, (values - starts[video])[order].astype(np.int64)


# Arrays of landmarks without names: (n, p, 2), or 3 with a confidence; (p, 2 or 3) is one image.


def of_bodies(
    path: Path,
    points: Floats,
    confidence: Floats | None,
    *,
    labels: Sequence[str] | None = None,
    frames: NDArray[np.int64] | None = None,
    videos: Sequence[str] | None = None,
    images: bool = False,
    individuals: Sequence[str] | None = None,
    notes: tuple[str, ...] = (),
    **fields: Any,
) -> Poses:
    """Return the poses of points (n, p, 2 or 3), one body per image, NaN where one is missing.

    labels (n) are names or numbers of the images, by default their places; frames (n) do not fall
    within a video. They are `images` that have nothing to do with one another, or the frames of a
    video, of these individuals, by default of one. `fields` are those of Poses. Raises InputError
    for confidences below 0.
    """
    n, _, dimensions = points.shape
    if confidence is not None and (confidence < 0).any():
        problem = f"has a confidence of {np.nanmin(confidence):g}"
        raise input_error(path, problem, "write 0 (hidden) or a positive number")
    if dimensions == 2 and confidence is None:
        notes += warn_of_zeros(points)
    fraction = dimensions == 2 and are_fractions(points[np.isfinite(points)])
    names = labels or [str(row) for row in range(n)]
    defaults: dict[str, Any] = {
        "frame": np.arange(n) if frames is None else frames,
        "individual": individuals or ([""] * n if images else None),
        "video": video_name(path) if videos is None else videos,
        "unit": FRACTION if fraction else UNKNOWN_UNIT,
        "size_needed": fraction,
        "unordered": images and not are_series(names),
        "notes": notes,
    }
    return of_frames(path, points, confidence, names, **defaults | fields)


POINTS = ("landmarks", "keypoints", "points", "poses")
SCORES = ("confidence", "scores", "keypoint_scores", "likelihood", "visibility")
WANTED = "give (images, landmarks, 2), or 3 with a confidence of 0 to 1"


def read_array(paths: tuple[Path, ...]) -> Poses:
    """Return the images of an array of NumPy or in JSON, whose landmarks `keypoints` names.

    In a .npz the confidences may be an array (n, p) of their own.
    """
    path = paths[0]
    try:
        if path.name.lower().endswith((".json", ".json.gz")):
            return of_array(path, np.array(read_json(path), np.float64))
        if zipfile.is_zipfile(path):
            return of_array(path, *_read_archive(path))
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        check_fits(str(path), 2 * 8 * array.size)
        return of_array(path, np.array(array))
    except InputError:
        raise
    except Exception as error:  # NumPy has many kinds of error for damaged files
        problem = f"cannot be read as an array ({str(error).partition(chr(10))[0][:80]})"
        fix = f"{WANTED}; save it again with numpy.save, without objects"
        raise input_error(path, problem, fix) from error


def _read_archive(path: Path) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Return the points and confidences of a .npz; of its other arrays the heads alone are read."""
    heads: dict[str, tuple[tuple[int, ...], int]] = {}
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            with archive.open(entry) as file:
                newer = np.lib.format.read_magic(file) != (1, 0)
                read = np.lib.format.read_array_header_2_0 if newer else None
                shape, _, dtype = (read or np.lib.format.read_array_header_1_0)(file)
            heads[entry.filename.removesuffix(".npy")] = shape, math.prod(shape) * dtype.itemsize
    points = [name for name in heads if name.lower() in POINTS]
    points = points or [name for name, (shape, _) in heads.items() if len(shape) == 3]
    if len(points) != 1:
        names = abbreviate([f"{name} {shape}" for name, (shape, _) in heads.items()]) or "nothing"
        raise input_error(path, f"holds {names}", "call the landmarks `landmarks`")
    scores = next((name for name in heads if name.lower() in SCORES), None)
    size = sum(heads[name][1] for name in (points[0], scores) if name)
    if size > LARGEST_BYTES:
        problem = f"its landmarks are {in_words(size)}, and they are read whole"
        fix = f"divide it into files of less than {in_words(LARGEST_BYTES)}"
        raise input_error(path, problem, fix)
    check_fits(str(path), 2 * size)
    with np.load(path, allow_pickle=False) as arrays:
        return arrays[points[0]], arrays[scores] if scores else None


def of_array(
    path: Path, points: NDArray[Any], scores: NDArray[Any] | None = None, **fields: Any
) -> Poses:
    """Return the images of an array (n, p, 2 or 3) or (p, 2 or 3); `path` names it in messages.

    `fields` is what else `of_bodies` takes. Raises InputError for arrays of other shapes, and for
    a third number that is no confidence.
    """
    if points.ndim == 2:
        points, scores = points[None], None if scores is None else scores[None]
    with parsing(path, WANTED):
        numeric = points.dtype.kind in "biuf" and points.ndim == 3 and points.shape[2] in (2, 3)
        require(numeric, f"is an array of {points.dtype} and the shape {points.shape}")
        points = points.astype(np.float64)
        points = np.where(np.isfinite(points), points, np.nan)
        if points.shape[2] == 3:
            last = points[..., 2]
            least, most = np.nanmin(last, initial=np.inf), np.nanmax(last, initial=-np.inf)
            rows = "; ".join(" ".join(f"{x:g}" for x in row) for row in points.reshape(-1, 3)[:2])
            problem = f"its third numbers run from {least:g} to {most:g}, so are they confidences?"
            problem += f" (the first rows are {rows})"
            require(scores is None and not (least < 0 or most > 1), problem)
            points, scores = points[..., :2], last
        if scores is not None:
            problem = f"has confidences of the shape {scores.shape}, and points {points.shape}"
            require(scores.shape == points.shape[:2], problem)
            scores = np.nan_to_num(scores.astype(np.float64))
    points = np.where(np.isnan(points).any(axis=2, keepdims=True), np.nan, points)
    return of_bodies(path, points, scores, **fields)
