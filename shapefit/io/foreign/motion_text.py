"""TRC and BVH, motion as text: the places of markers, and a tree of joints with their angles."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, counted, input_error, printable
from shapefit.geometry.normalisation import as_metres
from shapefit.geometry.rotations import rotation_about_axes
from shapefit.io.foreign.recording import Recording, one_individual
from shapefit.io.inputs import BYTE_ORDER_MARK, read_whole
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.tidy_table import read_numbers

HEAD_LINES = 12
"""Within which the names of the markers stand; five as a rule, more with empty lines between."""

AT_ORIGIN = "points at exactly 0, 0, 0 taken for missing"
TOO_FEW = "frames are announced in the header, but not there"


@dataclass(frozen=True)
class Header:
    """What stands above the frames; `lines` is the number of its lines."""

    separator: str
    values: dict[str, str]
    labels: list[str]
    lines: int


def read_trc(paths: tuple[Path, ...]) -> Recording:
    """Return the markers of a TRC file.

    A point is missing where a coordinate is empty or nan, and where all three are exactly 0.
    Raises InputError for a header without markers, and for frames that are no numbers.
    """
    path = paths[0]
    header = read_header(path)
    names, notes = unique_names(header.labels)
    factor, unit = as_metres(header.values.get("units", ""))
    rate = _number(header.values.get("datarate", ""))
    width = 2 + 3 * len(names)
    firsts, numbers = read_rows(path, header.lines, header.separator, width, labels=2, padded=True)
    labels = [first or str(frame) for frame, first in enumerate(firsts)]
    points = factor * numbers.reshape(len(labels), len(names), 3)
    origin: NDArray[np.bool_] = (points == 0).all(axis=2)
    points[origin] = np.nan
    lost = {
        TOO_FEW: int(_number(header.values.get("numframes", ""))) - len(labels),
        AT_ORIGIN: int(origin.sum()),
    }
    notes += tuple(f"{number} {what}" for what, number in lost.items() if number > 0)
    return Recording(
        name=str(path),
        video=path.stem,
        **one_individual(points, labels),
        landmark_names=names,
        frame_rate=rate if rate > 0 else None,
        unit=unit or UNKNOWN_UNIT,
        notes=notes,
    )


def read_header(path: Path) -> Header:
    """Read what stands above the frames. Raises InputError where there are no markers."""
    lines = read_lines(path)[:HEAD_LINES]
    firsts = [line.replace(",", "\t").split("\t")[0].strip().lower() for line in lines]
    place = next((i for i, first in enumerate(firsts) if first in ("frame#", "frame")), None)
    if place is None:
        fix = "give a TRC file whose fourth line is `Frame#  Time  NAME ...`"
        raise input_error(path, "has no line with the names of markers", fix)
    separator = "\t" if "\t" in lines[place] else ","
    values: dict[str, str] = {}
    if "datarate" in firsts:
        at = firsts.index("datarate")
        keys, cells = (line.split(separator) for line in lines[at : at + 2])
        values = {k.strip().lower(): c.strip() for k, c in zip(keys, cells, strict=False)}
    cells = [cell.strip() for cell in lines[place].split(separator)[2:]]
    axes = 0
    if place + 1 < len(lines) and not firsts[place + 1] and lines[place + 1].strip():
        axes = sum(bool(cell.strip()) for cell in lines[place + 1].split(separator)[2:])
        place += 1
    given = [cell for cell in cells if cell]
    markers = axes // 3 or int(max(_number(values.get("nummarkers", "")), 0)) or len(given)
    side_by_side = len(given) == markers and cells[: len(given)] == given and markers > 1
    labels = given if side_by_side else cells[::3][:markers]
    labels += [""] * (min(markers, max(len(cells), axes)) - len(labels))
    if not labels or not (given or axes):
        raise input_error(f"{path}:{place + 1}", "there are no markers", "give a TRC with markers")
    return Header(separator, values, labels, place + 1)


def _number(cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        return 0.0
    return value if np.isfinite(value) else 0.0


NO_FRAMES = "frames are announced, but not there"


@dataclass
class Joint:
    """A joint, or an End Site, at `offset` (3,) from its parent, -1 for none.

    channels are (is_rotation, axis, column of the motion), in the order of the file.
    """

    name: str
    parent: int
    is_end: bool = False
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)
    channels: list[tuple[bool, int, int]] = field(default_factory=list)


@dataclass(frozen=True)
class Hierarchy:
    """All joints, parents first; `lines` stand before the motion."""

    joints: list[Joint]
    width: int
    lines: int
    frames: int
    frame_time: float


def read_bvh(paths: tuple[Path, ...]) -> Recording:
    """Return the joints of a BVH file, in its unit, and then the ends of the last bones.

    The end of joint J is `J_end`. Raises InputError for a tree or a motion that cannot be read.
    """
    path = paths[0]
    tree = read_hierarchy(path)
    order = sorted(range(len(tree.joints)), key=lambda number: tree.joints[number].is_end)
    names, notes = unique_names([tree.joints[number].name for number in order])
    place = {number: row for row, number in enumerate(order)}
    edges = [(place[j.parent], place[i]) for i, j in enumerate(tree.joints) if j.parent >= 0]
    _, motion = read_rows(path, tree.lines, " ", tree.width, finite=True)
    if len(motion) < tree.frames:
        notes += (f"{tree.frames - len(motion)} {NO_FRAMES}",)
    return Recording(
        name=str(path),
        video=path.stem,
        **one_individual(find_places(tree, motion)[:, order]),
        landmark_names=names,
        frame_rate=_rate(tree.frame_time),
        edges=tuple(edges),
        notes=notes,
    )


def read_hierarchy(path: Path) -> Hierarchy:
    """Read the tree and the head of the motion. Raises InputError, naming the line."""
    joints: list[Joint] = []
    open_joints: list[int] = []
    width, frames = 0, -1
    for number, line in enumerate(read_lines(path), 1):
        place = f"{path}:{number}"
        words = line.replace("{", " ").replace("}", " ").split()
        word = words[0].upper() if words else ""
        if word in ("ROOT", "JOINT", "END"):
            parent = open_joints[-1] if open_joints else -1
            if (parent < 0) != (word == "ROOT"):
                raise input_error(place, f"{word} stands in the wrong place", "correct it")
            name = f"{joints[parent].name}_end" if word == "END" else " ".join(words[1:])
            joints.append(Joint(name, parent, word == "END"))
            open_joints.append(len(joints) - 1)
        elif word in ("OFFSET", "CHANNELS") and not open_joints:
            raise input_error(place, f"{word} belongs to no joint", "correct it")
        elif word == "OFFSET":
            joints[open_joints[-1]].offset = read_words(words[1:], 3, place)
        elif word == "CHANNELS":
            channels = [_channel(name, place) for name in words[2:]]
            if words[1:2] != [str(len(channels))]:
                found = f"{' '.join(words[1:2])} channels, and {len(channels)} names"
                raise input_error(place, found, "name as many as there are")
            joints[open_joints[-1]].channels = [
                (kind, axis, width + i) for i, (kind, axis) in enumerate(channels)
            ]
            width += len(channels)
        elif word == "FRAMES:":
            frames = int(read_words(words[1:2], 1, place)[0])
        elif word == "FRAME" and words[1:2] == ["Time:"]:
            if not joints or open_joints:
                raise input_error(place, "the tree of joints is not complete", "correct it")
            seconds = read_words(words[2:3], 1, place)[0]
            return Hierarchy(joints, width, number, frames, seconds)
        elif word not in ("", "HIERARCHY", "MOTION"):
            found = f"begins with {printable(words[0])!r}, which is no word of BVH"
            raise input_error(place, found, "correct it")
        if "}" in line and open_joints:
            del open_joints[-line.count("}") :]
    raise input_error(path, "has no motion, or is cut off before it", "give a complete BVH file")


def find_places(tree: Hierarchy, values: Floats) -> Floats:
    """Return the places (n, joints, 3) of all joints and ends.

    x = x_parent + R_parent (offset), R = R_parent R_1 R_2 ...: rotations in the order of the
    channels; a channel of position stands for the offset along its axis.
    """
    n = len(values)
    places = np.empty((n, len(tree.joints), 3))
    rotations: list[Floats] = []
    for number, joint in enumerate(tree.joints):
        offset = np.tile(np.array(joint.offset), (n, 1))
        for is_rotation, axis, column in joint.channels:
            if not is_rotation:
                offset[:, axis] = values[:, column]
        turned = [(axis, column) for is_rotation, axis, column in joint.channels if is_rotation]
        angles = np.radians(values[:, [column for _, column in turned]])
        local = rotation_about_axes([axis for axis, _ in turned], angles)
        if joint.parent < 0:
            places[:, number] = offset
            rotations.append(local)
            continue
        above = rotations[joint.parent]
        places[:, number] = places[:, joint.parent] + (above @ offset[..., None])[..., 0]
        rotations.append(above if joint.is_end else above @ local)
    return places


def _channel(name: str, place: str) -> tuple[bool, int]:
    axis = "xyz".find(name[:1].lower())
    kind = name[1:].lower()
    if axis < 0 or kind not in ("rotation", "position"):
        raise input_error(place, f"there is no channel {name!r}", "use Xrotation, Yposition, ...")
    return kind == "rotation", axis


def _rate(frame_time: float) -> float | None:
    """Return the frame rate in Hz: whole, where the time was rounded (0.033333 s is 30 Hz)."""
    if frame_time <= 0:
        return None
    rate = 1.0 / frame_time
    return float(round(rate)) if abs(rate - round(rate)) < 1e-3 * rate and rate > 1 else rate


def read_lines(path: Path) -> list[str]:
    r"""Return the lines of a file without their ends. Bytes that are not UTF-8 become \xe9."""
    text = read_whole(path).removeprefix(BYTE_ORDER_MARK).decode("utf-8", "backslashreplace")
    return text.replace("\r\n", "\n").replace("\r", "\n").removesuffix("\n").split("\n")


def read_rows(
    path: Path,
    skip: int,
    separator: str,
    width: int,
    *,
    labels: int = 0,
    padded: bool = False,
    finite: bool = False,
) -> tuple[list[str], NDArray[np.float64]]:
    """Return the lines of a file after the first `skip`, each of so many cells, as numbers.

    The first cell of a line is its label where `labels` columns stand before the numbers. Cells
    that are not there at the end of a line are empty, and so NaN, where rows are `padded`. Spaces
    part cells in any number. Raises InputError, naming the line, for other widths, and for what
    is no number, or none that is `finite`.
    """
    lines = read_lines(path)[skip:]
    spaced = separator == " "
    own = [line.strip() for line in lines] if spaced else lines
    plain = read_plain(own, "\t" if spaced and own and "\t" in own[0] else separator, width)
    if plain is not None and (np.isfinite(plain).all() or not finite):
        firsts = [line.partition(separator)[0].strip() for line in lines] if labels else []
        if not labels or all(firsts):
            return firsts, plain[:, labels:]
    rows, numbers = [], []
    for number, line in enumerate(lines, skip + 1):
        if not line.strip(" \t,"):
            continue
        row = line.split(None if spaced or separator not in line else separator)
        if padded and len(row) > 1 and not any(cell.strip() for cell in row[width:]):
            row = (row + [""] * (width - len(row)))[:width]
        if len(row) != width:
            found = f"has {len(row)} cells for {width} columns"
            raise input_error(f"{path}:{number}", found, "write as many")
        rows.append(row)
        numbers.append(number)
    values = np.empty((0, width - labels))
    if rows:
        values = read_table([row[labels:] for row in rows], numbers, path, finite=finite)
    return [row[0].strip() for row in rows] if labels else [], values


def read_plain(lines: Sequence[str], separator: str, width: int) -> NDArray[np.float64] | None:
    """Return lines of so many plain numbers as an array (n, width), NaN where a cell is empty.

    None where one is not so plain: `read_table` takes them cell by cell, several times as slow.
    """
    if any(line.count(separator) != width - 1 for line in lines):
        return None
    text = ",".join(lines)
    if separator != ",":
        text = text.replace(separator, ",")
    if ",," in text or text.endswith(",") or text.startswith(","):
        text = f",{text},".replace(",,", ",null,").replace(",,", ",null,")[1:-1]
    try:
        values = orjson.loads(f"[{text}]")
    except orjson.JSONDecodeError:
        return None
    kinds = set(map(type, values))
    if len(values) != len(lines) * width or not kinds <= {float, int, type(None)}:
        return None
    plain = kinds <= {float, int}
    numbers = (
        np.fromiter(values, np.float64, len(values)) if plain else np.array(values, np.float64)
    )
    return numbers.reshape(len(lines), width)


def read_table(
    rows: Sequence[Sequence[str]], lines: Sequence[int], place: object, *, finite: bool = False
) -> NDArray[np.float64]:
    """Return rows of as many cells each as numbers, NaN where a cell is empty.

    Raises InputError that names the line of the first cell that is no number; where they are to
    be `finite`, nan and inf are none.
    """
    values, strange = read_numbers([cell for row in rows for cell in row])
    wrong = strange | ~np.isfinite(values) if finite else strange
    if wrong.any():
        row, column = divmod(int(wrong.argmax()), len(rows[0]))
        cell = rows[row][column]
        raise input_error(f"{place}:{lines[row]}", f"{cell[:40]!r} is no number", "correct it")
    return values.reshape(len(rows), -1)


def read_words(words: Sequence[str], count: int, place: str) -> tuple[float, ...]:
    """Return so many words as finite numbers. Raises InputError where they are none."""
    try:
        numbers = tuple(float(word) for word in words)
    except ValueError:
        numbers = ()
    if len(numbers) != count or not np.isfinite(numbers).all():
        found = f"expected {count} numbers, found {' '.join(words)[:40]!r}"
        raise input_error(place, found, "correct it")
    return numbers


def unique_names(labels: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return labels as names that occur once, and a note on those that had to change.

    A point without a label is `*7`, as C3D files call the eighth; what repeats gets a number.
    """
    names = [label.strip() or f"*{place}" for place, label in enumerate(labels)]
    taken, seen = set(names), Counter[str]()
    changed = []
    for place, name in enumerate(names):
        seen[name] += 1
        if seen[name] > 1:
            number = seen[name]
            while f"{name}_{number}" in taken:
                number += 1
            names[place] = f"{name}_{number}"
            taken.add(names[place])
            changed.append(names[place])
    if not changed:
        return tuple(names), ()
    note = f"{counted(len(changed), 'label')} repeated, and numbered ({abbreviate(changed)})"
    return tuple(names), (note,)
