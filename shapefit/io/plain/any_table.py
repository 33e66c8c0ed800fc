"""Tables of landmarks in other layouts than ours: other delimiters, other names, a row per image.

Cells are parted by `,`, `;` or tabs; with the latter two the decimal point may be a comma.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import InputError, abbreviate, input_error, printable
from shapefit.io.csv.text import bad_line, read_numbers, refuse_zero_bytes
from shapefit.io.foreign.recognition import is_anipose_csv
from shapefit.io.foreign.recording import Recording, video_name
from shapefit.io.plain.arrays import of_bodies
from shapefit.io.sources import read_whole

DELIMITERS = (",", ";", "\t")

ROLES: Mapping[str, str] = {
    name: role
    for role, names in {
        "item": "item image filename file file_name image_name image_id img",
        "frame": "frame frame_id frame_idx frame_index frame_number frame_no fnum",
        "sequence": "sequence video clip session",
        "landmark": "landmark joint bodypart body_part keypoint part node marker landmark_name "
        "joint_name keypoint_name landmark_id joint_id keypoint_id landmark_index",
        "x": "x x_px px",
        "y": "y y_px py",
        "z": "z",
        "confidence": "confidence conf likelihood score visibility probability prob v c",
    }.items()
    for name in names.split()
}
"""Name of a column, in small letters and with _ for spaces -> what it holds."""

OF_A_POINT = ("x", "y", "z", "confidence")

_NAMED = re.compile(
    r"(.+)[_.: -](x|y|z|likelihood|confidence|conf|score|visibility|prob|v|c)", re.I
)
_NUMBERED = re.compile(r"(x|y|z|visibility|v|c)_?([0-9]{1,9})", re.I)
_NUMBER = re.compile(r"[0-9]{1,9}")


@dataclass(frozen=True)
class Columns:
    """A header as it was understood.

    roles: item, frame, sequence, and in a long table landmark, x, y, z and confidence -> column;
    landmarks: of a wide table, in order: role -> column for each name, None for a long table;
    numbered: whether these names are numbers that follow one another; others: names left out.
    """

    delimiter: str
    names: tuple[str, ...]
    roles: Mapping[str, int]
    landmarks: Mapping[str, Mapping[str, int]] | None
    numbered: bool
    others: tuple[str, ...]

    @property
    def deep(self) -> bool:
        """Whether there is a column z."""
        points = [self.roles] if self.landmarks is None else self.landmarks.values()
        return any("z" in each for each in points)


def understand(line: str) -> Columns | None:
    """Return what the columns of a header hold; None where it is not that of a table of landmarks.

    A long table has a row per landmark: columns landmark, x, y, and item or frame. A wide one has
    a row per image or frame, and columns NAME_x and NAME_y of two landmarks at least.
    """
    for delimiter in sorted(DELIMITERS, key=line.count, reverse=True):
        try:
            cells = next(csv.reader([line], delimiter=delimiter), [])
        except csv.Error:
            return None
        names = tuple(cell.strip() for cell in cells)
        found = _long(delimiter, names) or _wide(delimiter, names)
        if found is not None:
            return found
    return None


def _roles(names: Sequence[str]) -> tuple[dict[str, int], list[str]]:
    """Return the first column of each role, and the names of those without one."""
    roles: dict[str, int] = {}
    others = []
    for column, name in enumerate(names):
        role = ROLES.get(name.lower().replace(" ", "_"))
        if role is None or role in roles:
            others.append(name)
        else:
            roles[role] = column
    return roles, others


def _long(delimiter: str, names: tuple[str, ...]) -> Columns | None:
    roles, others = _roles(names)
    if not {"landmark", "x", "y"} <= roles.keys() or not {"item", "frame"} & roles.keys():
        return None
    return Columns(delimiter, names, roles, None, False, tuple(filter(None, others)))


def _wide(delimiter: str, names: tuple[str, ...]) -> Columns | None:
    landmarks: dict[str, dict[str, int]] = {}
    rest: dict[int, str] = {}
    for column, name in enumerate(names):
        numbered, named = _NUMBERED.fullmatch(name), _NAMED.fullmatch(name)
        if numbered:
            role, landmark = numbered[1], str(int(numbered[2]))
        elif named:
            landmark, role = named[1], named[2]
        else:
            rest[column] = name
            continue
        role = ROLES.get(role.lower(), "confidence")
        if role in landmarks.setdefault(landmark, {}):
            return None
        landmarks[landmark][role] = column
    whole = {name: own for name, own in landmarks.items() if {"x", "y"} <= own.keys()}
    if len(whole) < 2:
        return None
    roles, others = _roles(list(rest.values()))
    places = list(rest)
    roles = {role: places[at] for role, at in roles.items() if role not in OF_A_POINT}
    others += [name for name in landmarks if name not in whole]
    numbers = _of_names(whole)
    numbered_names = numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    left = tuple(name for name in others if name and not name.lower().startswith("unnamed"))
    return Columns(delimiter, names, roles, whole, numbered_names and numbers[0] in (0, 1), left)


ENDINGS = (".csv", ".tsv", ".txt")
EMPTY = {"na", "n/a", "none", "null", "-", "nan"}
SHOWN = 2
"""Rows that an error shows as they were understood."""

LAST_FRAME = 2.0**53
"""Numbers of frames are below it, whole and told apart."""

BODY = 33
"""Landmarks of MediaPipe's body, which has a depth too."""

Rows = list[list[str]]


def is_table(path: Path, head: bytes) -> bool:
    """Whether the first line of a text names columns of landmarks, in another layout than ours."""
    line = _decoded(head).replace("\r", "\n").partition("\n")[0]
    if not path.name.lower().endswith(ENDINGS) or "\0" in line or is_anipose_csv(path, head):
        return False
    return {"item", "landmark"} - {cell.strip(' "\t') for cell in line.split(",")} != set() and (
        understand(line) is not None
    )


def record(paths: tuple[Path, ...]) -> Recording:
    """Return the images of a table. Raises InputError where it can be understood in two ways."""
    path = paths[0]
    text = _decoded(read_whole(path)).replace("\r\n", "\n").replace("\r", "\n")
    refuse_zero_bytes(text, str(path), 1)
    columns = understand(text.partition("\n")[0])
    if columns is None:
        raise input_error(path, "does not name columns of landmarks", "see docs/formats.md")
    reader = csv.reader(StringIO(text), delimiter=columns.delimiter)
    try:
        rows = [row for row in reader if any(row)][1:]
    except csv.Error as error:
        raise bad_line(f"{path}:{reader.line_num}", error) from error
    for number, row in enumerate(rows, start=2):
        if len(row) != len(columns.names):
            found = f"has {len(row)} cells for {len(columns.names)} columns"
            raise input_error(f"{path}:{number}", found, "write one cell per column")
    read = _read_long if columns.landmarks is None else _read_wide
    return read(path, columns, rows)


def _read_wide(path: Path, columns: Columns, rows: Rows) -> Recording:
    """Return a recording of a table with a row per image."""
    assert columns.landmarks is not None
    own = columns.landmarks

    def take(role: str) -> Floats:
        wanted = [each.get(role) for each in own.values()]
        numbers = [
            np.full(len(rows), np.nan) if at is None else _numbers(path, columns, rows, at)
            for at in wanted
        ]
        return np.array(numbers).T.reshape(len(rows), len(own))

    has_confidence = any("confidence" in each for each in own.values())
    names = None if columns.numbered else tuple(map(printable, own))
    return _as_recording(
        path, columns, rows, {axis: take(axis) for axis in _axes(columns)},
        take("confidence") if has_confidence else None, names, range(len(rows)),
    )  # fmt: skip


def _read_long(path: Path, columns: Columns, rows: Rows) -> Recording:
    """Return a recording of a table with a row per landmark of an image."""
    keys = [columns.roles[role] for role in ("sequence", "item", "frame") if role in columns.roles]
    at = columns.roles["landmark"]
    first: dict[tuple[str, ...], int] = {}
    landmarks: dict[str, int] = {}
    images: dict[tuple[str, ...], int] = {}
    places = np.empty((len(rows), 2), np.int64)
    taken: dict[tuple[int, int], int] = {}
    for number, row in enumerate(rows):
        key, name = tuple(row[column] for column in keys), row[at].strip()
        image = images.setdefault(key, len(images))
        first.setdefault(key, number)
        place = image, landmarks.setdefault(name, len(landmarks))
        if place in taken:
            found = f"{name!r} of {' '.join(key)} is also in line {taken[place] + 2}"
            fix = "keep one body per image, or part them by a column `sequence`"
            raise _unsure(path, columns, rows, f"line {number + 2}: {found}", fix)
        taken[place] = number
        places[number] = place

    def fill(role: str, otherwise: float = np.nan) -> Floats:
        values = np.full((len(images), len(landmarks)), otherwise)
        values[places[:, 0], places[:, 1]] = _numbers(path, columns, rows, columns.roles[role])
        return values

    numbers = _of_names(landmarks)
    numbered = sorted(numbers) == list(range(len(numbers)))
    if numbered:
        order = np.argsort(numbers)
        places[:, 1] = np.argsort(order)[places[:, 1]]
    return _as_recording(
        path, columns, rows, {axis: fill(axis) for axis in _axes(columns)},
        fill("confidence", 0.0) if "confidence" in columns.roles else None,
        None if numbered else tuple(map(printable, landmarks)), list(first.values()),
    )  # fmt: skip


def _of_names(names: Iterable[str]) -> list[int]:
    """Return the numbers that landmarks are called, -1 for other names."""
    return [int(name) if _NUMBER.fullmatch(name) else -1 for name in names]


def _axes(columns: Columns) -> tuple[str, ...]:
    return ("x", "y", "z") if columns.deep else ("x", "y")


def _as_recording(
    path: Path,
    columns: Columns,
    rows: Rows,
    axes: Mapping[str, Floats],
    confidence: Floats | None,
    names: tuple[str, ...] | None,
    first: Sequence[int],
) -> Recording:
    """Return a recording of points, whose images have the names in their first rows.

    z beside x and y is a third coordinate, unless there is a confidence of 0 to 1: then it is the
    depth that detectors guess, which is left out.
    """
    notes: tuple[str, ...] = ()
    if columns.others:
        notes += (f"columns left out: {abbreviate(list(map(printable, columns.others)))}",)
    if columns.deep and confidence is not None:
        axes = {axis: axes[axis] for axis in "xy"}
        notes += ("z left out, the depth that a detector guesses beside its confidence",)
    points = np.stack(list(axes.values()), axis=-1)
    points[np.isnan(points).any(axis=-1)] = np.nan
    if confidence is not None:
        confidence = np.where(np.isnan(confidence), 1.0, confidence)

    def cells(role: str) -> list[str] | None:
        at = columns.roles.get(role)
        return None if at is None else [rows[row][at].strip() for row in first]

    images, frames, sequences = cells("item"), cells("frame"), cells("sequence")
    video = video_name(path)
    videos = None if sequences is None else [f"{video}/{name}" for name in sequences]
    order = list(range(len(first)))
    numbers = None
    if frames is not None:
        found = read_numbers(frames)
        wrong = found.strange | ~(np.abs(found.values) < LAST_FRAME) | (found.values % 1 != 0)
        if wrong.any():
            what = f"the frame {frames[int(wrong.argmax())]!r} is no whole number"
            raise _unsure(path, columns, rows, what, "number the frames, or call the column `item`")
        starts: dict[str, float] = {}
        own = videos or [""] * len(order)
        for name, number in zip(own, found.values.tolist(), strict=True):
            starts[name] = min(number, starts.get(name, number))
        place = {name: at for at, name in enumerate(starts)}
        order.sort(key=lambda row: (place[own[row]], found.values[row]))
        numbers = [int(found.values[row] - starts[own[row]]) for row in order]
    labels = images or frames
    p = points.shape[1]
    return of_bodies(
        path,
        points[order],
        None if confidence is None else confidence[order],
        labels=None if labels is None else [labels[row] for row in order],
        frames=numbers,
        videos=None if videos is None else [videos[row] for row in order],
        images=images is not None and frames is None and sequences is None,
        notes=notes,
        landmark_names=names,
        default_keypoints="mediapipe_33" if columns.deep and p == BODY else None,
    )


def _numbers(path: Path, columns: Columns, rows: Rows, column: int) -> Floats:
    """Return a column as numbers, NaN where a cell is empty or says that there is nothing."""
    cells = [row[column].strip() for row in rows]
    cells = ["" if cell.lower() in EMPTY else cell for cell in cells]
    if columns.delimiter != "," and not any("." in cell for cell in cells):
        cells = [cell.replace(",", ".") for cell in cells]
    found = read_numbers(cells)
    wrong = found.strange | np.isinf(found.values)
    if wrong.any():
        row = int(wrong.argmax())
        what = f"line {row + 2}: {cells[row][:40]!r} is no number (column {columns.names[column]})"
        raise _unsure(path, columns, rows, what, "correct it, or leave it empty")
    return found.values


def _unsure(path: Path, columns: Columns, rows: Rows, found: str, fix: str) -> InputError:
    """Return an error that shows the first rows as they were understood."""
    if columns.landmarks is None:
        taken = dict(columns.roles)
    else:
        name, own = next(iter(columns.landmarks.items()))
        taken = {**columns.roles, **{f"{role} of {name}": at for role, at in own.items()}}
    shown = [
        ", ".join(f"{role} {printable(row[column])[:20]}" for role, column in taken.items())
        for row in rows[:SHOWN]
    ]
    return input_error(path, found, f"{fix} (understood so far: {'; '.join(shown)})")


def _decoded(data: bytes) -> str:
    """Return text in UTF-8 (with a mark or without), UTF-16 with a mark, or else Latin-1."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")
