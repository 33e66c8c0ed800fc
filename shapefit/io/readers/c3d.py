"""Points of motion capture in C3D: a header of 512 bytes, parameters in groups, and a
section of data (https://www.c3d.org).

It is read here, and only written by ezc3d, which ends the process or takes gigabytes of
memory for damaged files, and believes counts that contradict the data.
"""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, counted
from shapefit.io.formats import Head
from shapefit.io.readers.markers import poses_from_markers
from shapefit.io.readers.poses import FormatError, Poses, require
from shapefit.io.readers.text import decode

COMPUTED = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")
"""Parameters that list what a model computed: no points."""

BLOCK_SIZE = 512
"""Bytes of a block, in which C3D counts."""

DEC = 85
"""Processor by which a file names the order of its bytes; 84 is Intel, as all of
today's are.
"""

MIPS = 86
"""Another such processor."""

Values = Sequence[float] | Sequence[str]
Parameters = Mapping[tuple[str, str], Values]
"""Group and name -> values."""


class DataLayout(NamedTuple):
    """What a data section holds: frames of x, y, z and residual of each point, then the
    analog values of the frame, in numbers of `width` bytes.
    """

    frames: int
    points: int
    analog: int
    width: int

    @property
    def frame_bytes(self) -> int:
        """The number of bytes of one frame."""
        return (4 * self.points + self.analog) * self.width

    @property
    def bytes(self) -> int:
        """The number of bytes of all frames."""
        return self.frames * self.frame_bytes


class C3d(NamedTuple):
    """Header and parameters of a C3D file: the layout by the header, the number of the
    first frame, the scale of whole numbers, the rate in Hz; the parameters; and the
    data section: where it begins, and its size in bytes.
    """

    header: DataLayout
    first: int
    scale: float
    rate: float
    parameters: Parameters
    start: int
    data: int
    is_dec: bool

    def number(self, group: str, name: str) -> float:
        """Return the first value of a parameter as a number; 0 where it has none."""
        values = self.parameters.get((group, name), ())
        return float(values[0]) if values and not isinstance(values[0], str) else 0.0

    def whole_number(self, group: str, name: str) -> int:
        """Return the first value of a parameter as a count; 0 where it is none."""
        value = self.number(group, name)
        return int(value) if 0 <= value < MAX_COUNT else 0

    def texts(self, name: str) -> list[str]:
        """Return the texts of the parameter `name` of group POINT; [] for none."""
        values = self.parameters.get(("POINT", name), ())
        return [value for value in values if isinstance(value, str)]


MAX_COUNT = 1 << 32
"""Bound on counts in a file; a larger one is taken for damage."""


def is_c3d(head: Head) -> bool:
    """Whether a file is named .c3d, and its second byte is the mark of C3D."""
    return head.has_suffix(".c3d") and head.bytes[1:2] == b"\x50"


def read_c3d(paths: tuple[Path, ...]) -> Poses:
    """Read the markers of a C3D file, in metres where it names its unit.

    A point is missing where its residual is negative. Frames are numbered from 0 where
    the header numbers them from 1. The counts are those of the parameters or, where
    these contradict the size of the data, of the header.
    """
    path = paths[0]
    file = _read_c3d_header(path)
    layout = _choose_layout(path, file)
    require(layout.points, "no points, and no parameters POINT")
    points = _read_points(path, file, layout)
    notes = _notes_of_counts(file, layout)
    labels = file.texts("LABELS")
    further = 2  # a parameter has 255 texts
    while ("POINT", f"LABELS{further}") in file.parameters:
        labels += file.texts(f"LABELS{further}")
        further += 1
    labels = (labels + [""] * layout.points)[: layout.points]
    computed = {label for name in COMPUTED for label in file.texts(name)}
    markers = [number for number, label in enumerate(labels) if label not in computed]
    lost = [label for label in labels if label in computed]
    if lost:
        number = counted(len(lost), "point")
        notes.append(f"{number} left out, computed by a model ({abbreviate(lost)})")
    start = max(file.first - 1, 0)
    return poses_from_markers(
        path,
        points[:, markers],
        [labels[number] for number in markers],
        max(file.number("POINT", "RATE"), 0.0) or file.rate,
        (file.texts("UNITS") or [""])[0],
        labels=[str(start + frame) for frame in range(len(points))],
        notes=tuple(notes),
    )


# Header and parameters.


def _read_c3d_header(path: Path) -> C3d:
    """Read the header and the parameters of a C3D file, which come before its data.

    Raises FormatError for damaged ones.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        block = file.read(BLOCK_SIZE)
        require(len(block) == BLOCK_SIZE, "cut off within its header")
        start_of_parameters = BLOCK_SIZE * max(block[0] - 1, 0)
        (start_block,) = struct.unpack_from("<H", block, 16)
        start = BLOCK_SIZE * max(start_block - 1, 0)
        file.seek(start_of_parameters)
        section = file.read(max(start - start_of_parameters, 4))
    require(len(section) >= 4, "cut off before its parameters")
    processor = section[3]
    intel = "save it in the order of bytes of Intel processors"
    require(processor != MIPS, "its numbers are those of a MIPS processor", intel)
    points, analog, first, last = struct.unpack_from("<HHHH", block, 2)
    scale = _decode_floats(block[12:16], processor == DEC)[0]
    rate = _decode_floats(block[20:24], processor == DEC)[0]
    return C3d(
        header=DataLayout(max(last - first + 1, 0), points, analog, _width(scale)),
        first=first,
        scale=float(scale),
        rate=float(rate),
        parameters=_parse_parameters(section, processor == DEC),
        start=start,
        data=max(size - start, 0),
        is_dec=processor == DEC,
    )


def _width(scale: float) -> int:
    """Return the bytes of a coordinate by the scale: 4 (a float) below 0, else 2."""
    return 4 if scale < 0 else 2


def _decode_floats(data: bytes, is_dec: bool) -> Floats:
    """Decode 4-byte floats (n,), as processors of Intel or of DEC write them.

    Those of a DEC have their halves exchanged, and are four times as large.
    """
    if not is_dec:
        return np.frombuffer(data, "<f4").astype(np.float64)
    halves = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1]
    return np.ascontiguousarray(halves).view("<f4").ravel().astype(np.float64) / 4


TEXT_TYPE, BYTE, WHOLE_TYPE, FLOAT = -1, 1, 2, 4
"""Kinds of parameters, each the bytes of a value."""

MAX_AXES = 7
"""Axes of a parameter, at most."""


def _parse_parameters(section: bytes, is_dec: bool) -> Parameters:
    """Parse the parameter section of a C3D file: (group, name) -> values.

    A record is the length of its name, the number of its group (below 0 for the group
    itself), the name, the way to the next record, 0 from the last, what it holds, and a
    description with its length. The first is at the fifth byte. Raises FormatError for
    records of another length.
    """
    groups: dict[int, str] = {}
    found: dict[tuple[int, str], Values] = {}
    place = 4
    while place + 2 <= len(section):
        length, group = struct.unpack_from("bb", section, place)
        end_of_name = place + 2 + abs(length)
        if length == 0:
            break
        require(group != 0, "a parameter of no group")
        require(end_of_name + 4 <= len(section), "a parameter is cut off")
        name = decode(section[place + 2 : end_of_name]).strip().upper()
        (following,) = struct.unpack_from("<H", section, end_of_name)
        body = end = end_of_name + 2
        if group < 0:
            groups[-group] = name
        else:
            (kind,) = struct.unpack_from("b", section, body)
            start, end = _find_values(section, body)
            lengths, values = section[body + 2 : start], section[start:end]
        description = section[end] if end < len(section) else 0
        whole = end + 1 + description
        fits = whole == end_of_name + following or not following
        fits = fits and end <= len(section)
        require(fits, f"the parameter {name} does not fit in its record")
        if group > 0:
            found[group, name] = _decode_values(kind, lengths, values, is_dec)
        if following == 0:
            break
        place = whole
    require(place <= len(section), "parameters that do not end before the data")
    return {
        (groups.get(group, ""), name): values for (group, name), values in found.items()
    }


def _find_values(section: bytes, body: int) -> tuple[int, int]:
    """Return the offsets in a section where a parameter's values begin and end.

    body is the offset of its kind. Raises FormatError for an unknown kind.
    """
    kind, axes = struct.unpack_from("bB", section, body)
    start = body + 2 + axes
    known = kind in (TEXT_TYPE, BYTE, WHOLE_TYPE, FLOAT) and axes <= MAX_AXES
    require(known and start <= len(section), "a parameter of no known kind")
    return start, start + abs(kind) * math.prod(section[body + 2 : start])


def _decode_values(kind: int, lengths: bytes, data: bytes, is_dec: bool) -> Values:
    """Decode the values of a parameter of this kind: numbers, or texts.

    lengths are those of its axes, a byte each; the first is that of a text.
    """
    if kind == TEXT_TYPE:
        size = lengths[0] if lengths else 1
        rows = [data[start : start + size] for start in range(0, len(data), size or 1)]
        return [decode(row).strip(" \0") for row in rows]
    if kind == FLOAT:
        return [*map(float, _decode_floats(data, is_dec))]
    return [*map(float, np.frombuffer(data, "<u2" if kind == WHOLE_TYPE else "u1"))]


# Data.


def _choose_layout(path: Path, file: C3d) -> DataLayout:
    """Return the layout, by parameters or header, whose size fits the data section.

    It fills the section up to the end of its last block.

    Where all announce more frames than there are, it has those that are there, if
    nothing but zeros follows them. Raises FormatError where no layout fits.
    """
    announced = [file.whole_number("POINT", "FRAMES"), _actual_frames(file)]
    announced = [frames for frames in (*announced, file.header.frames) if frames]
    counts = [
        one
        for one in (_layout_of_parameters(file), file.header)
        if one.points and announced
    ]
    for one in counts:
        for frames in announced:
            if 0 <= file.data - frames * one.frame_bytes < BLOCK_SIZE:
                return one._replace(frames=frames)
    for one in counts:
        frames, spare = divmod(file.data, one.frame_bytes)
        zeros = spare < BLOCK_SIZE and not _last_bytes(path, spare).strip(b"\0")
        if 0 < frames < min(announced) and zeros:
            return one._replace(frames=frames)
    layout = (counts or [file.header])[0]
    layout = layout._replace(frames=(announced or [0])[0])
    problem = (
        f"its data section has {file.data} bytes, and {layout.frames} frames of"
        f" {layout.points} points and {layout.analog} analog values take"
        f" {layout.bytes}: it is cut off, or its counts are wrong"
    )
    raise FormatError(problem, "export or copy it again")


def _layout_of_parameters(file: C3d) -> DataLayout:
    """Return the layout that the parameters state; its frames are set to 0."""
    rate = file.number("POINT", "RATE")
    of_analog = file.number("ANALOG", "RATE")
    shares = of_analog / rate if rate > 0 and of_analog > 0 else 1.0
    samples = round(shares) if shares < MAX_COUNT else 1
    return DataLayout(
        0,
        file.whole_number("POINT", "USED"),
        file.whole_number("ANALOG", "USED") * samples,
        _width(file.number("POINT", "SCALE") or file.scale),
    )


def _actual_frames(file: C3d) -> int:
    """Return the number of frames by the parameters of group TRIAL; 0 without them.

    From ACTUAL_START_FIELD to ACTUAL_END_FIELD, each in two halves, in which long
    recordings count.
    """
    ends = []
    for name in ("ACTUAL_START_FIELD", "ACTUAL_END_FIELD"):
        values = file.parameters.get(("TRIAL", name), ())
        halves = [int(value) for value in values if not isinstance(value, str)]
        if len(halves) != 2:
            return 0
        ends.append(halves[0] + (halves[1] << 16))
    return max(ends[1] - ends[0] + 1, 0)


def _last_bytes(path: Path, count: int) -> bytes:
    """Return the last `count` bytes of a file."""
    with path.open("rb") as file:
        file.seek(-count, os.SEEK_END)
        return file.read()


def _read_points(path: Path, file: C3d, layout: DataLayout) -> Floats:
    """Read the points (n, p, 3) of the data section, NaN for missing ones."""
    with path.open("rb") as opened:
        opened.seek(file.start)
        data = opened.read(layout.bytes)
    unit = 1.0
    if layout.width == 4:
        values = _decode_floats(data, file.is_dec)
    else:
        values = np.frombuffer(data, "<i2").astype(np.float64)
        unit = abs(file.number("POINT", "SCALE") or file.scale)
    rows = values.reshape(layout.frames, -1)
    # (n, (4 p + analog)) -> (n, p, [x, y, z, residual])
    cells = rows[:, : 4 * layout.points].reshape(layout.frames, layout.points, 4)
    points: Floats = np.where(cells[..., 3:] >= 0, unit * cells[..., :3], np.nan)
    return points


def _notes_of_counts(file: C3d, layout: DataLayout) -> list[str]:
    """Return notes where counts contradict each other, and where frames are missing."""
    notes = []
    stated = _layout_of_parameters(file)
    if stated[1:] != layout[1:]:
        why = "which its parameters contradict"
        why = why if stated.points else "as its parameters state no points"
        notes.append(f"read by its header, {why}")
    announced = file.whole_number("POINT", "FRAMES") or file.header.frames
    if layout.frames < announced and layout.frames != file.header.frames:
        lost = announced - layout.frames
        notes.append(f"{lost} frames are announced in the header, but not there")
    return notes
