"""Points of motion capture: TRC, the CSV of Vicon, and C3D, which ezc3d reads."""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, counted, input_error
from shapefit.geometry.normalisation import as_metres
from shapefit.io.csv_file import read_numbers
from shapefit.io.formats import Head
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.poses import (
    FormatError,
    Poses,
    frames_of_labels,
    frames_of_times,
    library_reads,
    make_unique,
    of_frames,
    require,
)
from shapefit.io.readers.text import decode, floats, read_table, read_text

HEADER_LINES = 5
"""Lines of TRC before the first frame; names stand in the fourth, X1 in the fifth."""


def is_trc(head: Head) -> bool:
    """Whether a text begins with the word that only TRC begins with."""
    return head.text.lstrip()[:12].lower() == b"pathfiletype"


def read_trc(paths: tuple[Path, ...]) -> Poses:
    """Read the markers of a TRC file: tabs or commas, and a name above the X of each
    marker.

    A point is missing where a coordinate is empty or nan, and where all three are
    exactly 0. Points without a name, which some programs write after the others, are
    left out.
    """
    path, text = paths[0], read_text(paths[0])
    delimiter = "\t" if "\t" in text else ","
    lines = text.split("\n")
    require(len(lines) >= HEADER_LINES, f"its header has {len(lines)} lines, not 5")
    head = [
        [cell.strip() for cell in line.split(delimiter)]
        for line in lines[:HEADER_LINES]
    ]
    _, keys, values, names, axes = head
    about = dict(zip(map(str.lower, keys), values, strict=False))
    count = sum(map(bool, axes[2:])) // 3  # X1 Y1 Z1 X2 ...
    require(
        count and names[0].lower() == "frame#",
        "no names of markers in line 4, above X1 Y1",
    )
    require(not any(names[3::3] + names[4::3]), "names that do not stand above an X")
    labels = [*names[2:], *[""] * (3 * count)][: 3 * count : 3]
    text, unnamed = _without_points_after(text, 3 * count + 2, delimiter)
    points, frames, times = _read_points(path, text, labels, HEADER_LINES, delimiter)
    origin = np.asarray((points == 0).all(axis=2))
    points = np.where(origin[..., None], np.nan, points)
    named = [number for number, label in enumerate(labels) if label]
    require(named, "no names of markers in line 4, above X1 Y1")
    nameless = [number for number, label in enumerate(labels) if not label]
    unnamed += int(np.isfinite(points[:, nameless]).all(axis=2).sum())
    origins = int(origin[:, named].sum())
    announced = floats([about.get("numframes") or "0"])[0]
    notes = []
    if announced > len(points):
        lost = int(announced) - len(points)
        notes.append(f"{lost} frames are announced in the header, but not there")
    if origins:
        notes.append(f"{origins} points at exactly 0, 0, 0 taken for missing")
    if unnamed:
        notes.append(f"{counted(unnamed, 'point')} without a name left out")
    require("datarate" in about, "there is no DataRate in line 2")
    rate = floats([about["datarate"]])[0]
    timed = len(times) > 0 and bool(np.isfinite(times).all())
    numbers = frames_of_labels(frames)
    if timed and (numbers is None or _are_in_a_row(numbers)):
        # Frames that were dropped can leave a gap in the times alone.
        numbers = frames_of_times(times, rate) or numbers
    return _of_markers(
        path,
        points[:, named],
        [labels[number] for number in named],
        rate,
        about.get("units", ""),
        labels=frames,
        frames=numbers,
        times=times if timed else None,
        notes=tuple(notes),
    )


def _are_in_a_row(numbers: Sequence[int]) -> bool:
    """Whether numbers of frames, from 0 on, leave none out."""
    return sorted(numbers) == [*range(len(numbers))]


def _without_points_after(text: str, cells: int, delimiter: str) -> tuple[str, int]:
    """Return the text with rows of so many cells, and the number of points left out.

    A point that stands after them has three cells: other ends of rows stay.
    """
    lines = text.split("\n")
    left_out = 0
    for number, line in enumerate(lines[HEADER_LINES:], HEADER_LINES):
        if line.count(delimiter) < cells:
            continue
        further = line.rstrip(f" \t{delimiter}").split(delimiter)[cells:]
        if further and len(further) % 3 == 0:
            left_out += sum(map(bool, map(str.strip, further))) // 3
            lines[number] = delimiter.join(line.split(delimiter, cells)[:cells])
    return "\n".join(lines), left_out


def is_vicon(head: Head) -> bool:
    """Whether the columns of a section `Trajectories` begin with those of Vicon."""
    _, _, after = head.text.lower().partition(b"trajectories")
    return b"frame,sub frame," in after


def read_vicon(paths: tuple[Path, ...]) -> Poses:
    """Read the section `Trajectories` of a CSV that Vicon Nexus exports.

    Below it stand the rate, a label above the X of each marker, `Frame,Sub
    Frame,X,Y,Z,...`, the units, and the frames up to an empty line. An empty cell is
    missing.
    """
    path, lines = paths[0], read_text(paths[0]).split("\n")
    bare = [line.strip(', "\t') for line in lines]
    sections = [line.lower() for line in bare]
    require("trajectories" in sections, "no section Trajectories")
    start = sections.index("trajectories") + 1
    end = bare.index("", start) if "" in bare[start:] else len(bare)
    head = [
        [cell.strip() for cell in line.split(",")] for line in lines[start : start + 4]
    ]
    whole = len(head) == 4 and len(head[3]) > 2
    require(whole, "the four lines below Trajectories are not complete")
    rate, labels, axes, unit = head[0][0], head[1], head[2], head[3][2]
    count = axes.count("X")
    require(
        axes == ["Frame", "Sub Frame", *"XYZ" * count], "other columns than X, Y and Z"
    )
    labels = [*labels[2:], *[""] * (3 * count)][: 3 * count : 3]
    text = "\n".join(lines[:end])
    points, frames, _ = _read_points(path, text, labels, start + 4)
    hertz = floats([rate])[0]
    numbers = frames_of_labels(frames)
    return _of_markers(path, points, labels, hertz, unit, labels=frames, frames=numbers)


def _read_points(
    path: Path, text: str, labels: Sequence[str], after: int, delimiter: str = ","
) -> tuple[Floats, list[str], Floats]:
    """Return points (n, m, 3), the labels of the frames, and what stands beside those,
    NaN for no number (n,).

    A row, after so many lines, is a frame, a time or the like, and x, y, z of each
    marker.
    """
    columns = ["Frame", "", *(f"{name} {axis}" for name in labels for axis in "XYZ")]
    table = read_table(path, text, columns, delimiter, after=after, padded=True)
    points = table.numbers(range(2, len(columns))).reshape(-1, len(labels), 3)
    frames = [frame or str(number) for number, frame in enumerate(table.texts(0)[0])]
    beside, _ = read_numbers(table.texts(1)[0])
    return points, frames, beside


COMPUTED = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS")  # by a model: no points


def is_c3d(head: Head) -> bool:
    """Whether the second byte is the mark of C3D, which other files can have there."""
    return head.named(".c3d") and head.bytes[1:2] == b"\x50"


def read_c3d(paths: tuple[Path, ...]) -> Poses:
    """Read the markers of a C3D file, in metres where it names its unit.

    A point is missing where its residual is negative. Frames have the numbers that
    ezc3d gives them, one less than in the header. Where what ezc3d read is not what the
    file holds, but the header fits, the points are read by the header. Raises
    InputError where ezc3d is not installed.
    """
    path = paths[0]
    try:
        ezc3d = import_module("ezc3d")
    except ImportError as error:
        problem = "is a C3D file, which ezc3d reads, and that is not installed"
        raise input_error(path, problem, "run `pip install ezc3d`") from error
    header = _read_c3d_header(path)
    with library_reads("it is cut off or damaged"):
        file = ezc3d.c3d(os.fspath(path))
        about: Any = file["parameters"].get("POINT", {})
        points, read = _points_of_ezc3d(file, header)
    layout = _fitting_layout(path, header, read)
    notes = []
    if layout != read:
        points = _points_by_header(path, header, layout)
        notes.append("read by its header, which its parameters contradict")
    require(layout.points, "no points, and no parameters POINT")
    lost_frames = (header.frames or header.layout.frames) - layout.frames
    if lost_frames > 0 and layout.frames != header.layout.frames:
        told = f"{lost_frames} frames are announced in the header, but not there"
        notes.append(told)

    def texts(name: str) -> list[str]:  # ezc3d leaves what is not UTF-8 as bytes
        values = (str(text) for text in about.get(name, {}).get("value", ()))
        return [
            decode(text.encode("utf-8", "surrogateescape")).strip() for text in values
        ]

    more = (f"LABELS{number}" for number in range(2, len(about)))  # beyond 255
    labels = [label for name in ("LABELS", *more) for label in texts(name)]
    labels = (labels + [""] * points.shape[1])[: points.shape[1]]
    computed = {label for name in COMPUTED for label in texts(name)}
    markers = [number for number, label in enumerate(labels) if label not in computed]
    lost = [label for label in labels if label in computed]
    if lost:
        number = counted(len(lost), "point")
        notes.append(f"{number} left out, computed by a model ({abbreviate(lost)})")
    rates = np.ravel(about.get("RATE", {}).get("value", ())).tolist()
    stated = next((rate for rate in rates if rate > 0), header.rate)
    start = max(header.first - 1, 0)
    return _of_markers(
        path,
        points[:, markers],
        [labels[number] for number in markers],
        float(stated),
        (texts("UNITS") or [""])[0],
        labels=[str(start + frame) for frame in range(len(points))],
        notes=tuple(notes),
    )


C3D_BLOCK = 512
"""Bytes of a block, in which C3D counts."""

DEC, MIPS = 85, 86
"""Processors by which a file names the order of its bytes; 84 is Intel, as all of
today's are.
"""


class C3dLayout(NamedTuple):
    """What a data section holds: frames of x, y, z and residual of each point, then the
    analog values of the frame, in numbers of `width` bytes.
    """

    frames: int
    points: int
    analog: int
    width: int

    @property
    def bytes(self) -> int:
        """How long that is."""
        return self.frames * (4 * self.points + self.analog) * self.width


class C3dHeader(NamedTuple):
    """The first block of a C3D file, how many frames its parameters state, 0 for none,
    and its data section: where it begins, and its size in bytes.
    """

    processor: int
    layout: C3dLayout
    frames: int
    first: int
    scale: float
    rate: float
    start: int
    data: int


def _read_c3d_header(path: Path) -> C3dHeader:
    """Return the first block of a C3D file."""
    size = path.stat().st_size
    with path.open("rb") as file:
        block = file.read(C3D_BLOCK)
        require(len(block) == C3D_BLOCK, "cut off within its header")
        start_of_parameters = C3D_BLOCK * max(block[0] - 1, 0)
        file.seek(start_of_parameters)
        rest = file.read()
    require(len(rest) >= 4, "cut off before its parameters")
    processor = rest[3]
    intel = "save it in the order of bytes of Intel processors"
    require(processor != MIPS, "its numbers are those of a MIPS processor", intel)
    points, analog, first, last = struct.unpack("<HHHH", block[2:10])
    scale, start_block = struct.unpack("<fH", block[12:18])
    (rate,) = struct.unpack("<f", block[20:24])
    if processor == DEC:  # whose numbers begin with other bytes
        scale = -1.0 if block[13] & 0x80 else 1.0
        rate = 0.0
    start = C3D_BLOCK * max(start_block - 1, 0)
    section = rest[: max(start - start_of_parameters, 0)]
    return C3dHeader(
        processor=processor,
        layout=C3dLayout(max(last - first + 1, 0), points, analog, width(scale)),
        frames=_stated_frames(section),
        first=first,
        scale=scale,
        rate=rate,
        start=start,
        data=max(size - start, 0),
    )


LARGEST_COUNT = 1 << 32
"""Frames that no file has."""

BYTES_OF_KINDS = (1, 2, 4)
"""Of the values of parameters: texts and bytes, whole numbers, floats."""

MOST_AXES = 7
"""Of a parameter."""


def _stated_frames(section: bytes) -> int:
    """Return POINT:FRAMES as it stands in the file, where ezc3d gives how many it read;
    0 where there is none.

    Raises FormatError for parameters that reach beyond their record, on which ezc3d
    crashes.
    """
    groups: dict[int, bytes] = {}
    frames: dict[int, int] = {}
    place = 4
    while place + 2 <= len(section):
        length, group = struct.unpack_from("bb", section, place)
        end_of_name = place + 2 + abs(length)
        if length == 0 or group == 0:
            break
        require(end_of_name + 4 <= len(section), "a parameter is cut off")
        name = section[place + 2 : end_of_name].upper()
        (following,) = struct.unpack_from("<H", section, end_of_name)
        if group < 0:
            groups[-group] = name
            size = 3 + section[end_of_name + 2]
        else:
            size = _size_of_parameter(section, end_of_name)
        fits = end_of_name + size <= len(section) and (
            size <= following or not following
        )
        label = decode(name)
        require(fits, f"the parameter {label} does not fit in its record")
        if name == b"FRAMES" and group > 0:
            frames[group] = _first_number(section, end_of_name)
        if following == 0:
            break
        place = end_of_name + following
    return next((frames[n] for n in frames if groups.get(n) == b"POINT"), 0)


def _size_of_parameter(section: bytes, place: int) -> int:
    """Return the bytes of a parameter after its name, without its description."""
    kind, axes = struct.unpack_from("bB", section, place + 2)
    known = abs(kind) in BYTES_OF_KINDS and axes <= MOST_AXES
    require(known and place + 4 + axes <= len(section), "a parameter of no known kind")
    return 4 + axes + abs(kind) * math.prod(section[place + 4 : place + 4 + axes])


def _first_number(section: bytes, place: int) -> int:
    """Return the first value of a parameter after its name; 0 where it has none."""
    kind, axes = struct.unpack_from("bB", section, place + 2)
    form = {2: "<H", 4: "<f"}.get(kind)
    start = place + 4 + axes
    if form is None or start + kind > len(section):
        return 0
    (number,) = struct.unpack_from(form, section, start)
    return int(number) if 0 <= number < LARGEST_COUNT else 0


def width(scale: float) -> int:
    """Return the bytes of a number, by the sign of the scale: floats, or integers."""
    return 4 if scale < 0 else 2


def _points_of_ezc3d(file: Any, header: C3dHeader) -> tuple[Floats, C3dLayout]:
    """Return the points (n, p, 3) that ezc3d read, NaN for missing ones, and how it
    read the data section.
    """
    # (4, p, n) -> (n, p, 3)
    points = np.asarray(file["data"]["points"], np.float64)[:3].transpose(2, 1, 0)
    residual = np.asarray(file["data"]["meta_points"]["residuals"])[0].T
    points = np.where((residual >= 0)[..., None], points, np.nan)
    frames, count = points.shape[:2]
    analog = np.asarray(file["data"]["analogs"]).size // max(frames, 1)
    scales = np.ravel(file["parameters"]["POINT"].get("SCALE", {}).get("value", ()))
    scale = float(scales[0]) if scales.size else header.scale
    return points, C3dLayout(frames, count, analog, width(scale))


def _fitting_layout(path: Path, header: C3dHeader, read: C3dLayout) -> C3dLayout:
    """Return the layout that fills the data section up to the end of its last block:
    that which ezc3d read, else one with counts of the header.

    ezc3d reads as many frames as there are: where those are not the frames that the
    file announces, nothing but zeros follows them. Raises FormatError where no layout
    fits.
    """
    stated = header.layout
    for layout in (read, stated, stated._replace(frames=header.frames)):
        spare = header.data - layout.bytes
        announced = layout.frames in (stated.frames, header.frames)
        if not layout.bytes or not 0 <= spare < C3D_BLOCK:
            continue
        if announced or not _ends_in(path, spare).strip(b"\0"):
            return layout
    layout = read if read.bytes else stated
    layout = layout._replace(frames=header.frames or stated.frames)
    problem = (
        f"its data section has {header.data} bytes, and {layout.frames} frames of"
        f" {layout.points} points and {layout.analog} analog values take"
        f" {layout.bytes}: it is cut off, or its counts are wrong"
    )
    raise FormatError(problem, "export or copy it again")


def _ends_in(path: Path, count: int) -> bytes:
    """Return the last bytes of a file."""
    with path.open("rb") as file:
        file.seek(-count, os.SEEK_END)
        return file.read()


def _points_by_header(path: Path, header: C3dHeader, layout: C3dLayout) -> Floats:
    """Return the points (n, p, 3) of a data section of this layout, NaN for missing
    ones.
    """
    known = header.processor != DEC
    require(known, "its counts contradict its header, and its numbers are of a DEC")
    floating = layout.width == 4
    kind = "<f4" if floating else "<i2"
    count = layout.bytes // layout.width
    values = np.fromfile(path, kind, count, offset=header.start)
    rows = values.astype(np.float64).reshape(layout.frames, -1)
    # (n, (4 p + analog)) -> (n, p, [x, y, z, residual])
    cells = rows[:, : 4 * layout.points].reshape(layout.frames, layout.points, 4)
    unit = 1.0 if floating else abs(header.scale)
    points: Floats = np.where(cells[..., 3:] >= 0, unit * cells[..., :3], np.nan)
    return points


def _of_markers(
    path: Path,
    points: Floats,
    markers: Sequence[str],
    rate: float,
    unit: str,
    **fields: Any,
) -> Poses:
    """Return the one body of markers (n, m, 3), in metres where the unit is known.

    `subject:` before all their names is the individual; `fields` are those of
    `of_frames`.
    """
    names = make_unique(markers)
    if _are_flat(points):
        return _of_flat_markers(path, points, names, rate, unit, **fields)
    factor, unit = as_metres(unit)
    subjects = {name.rpartition(":")[0] for name in names if not name.startswith("*")}
    individuals = [*subjects] if len(subjects) == 1 and any(subjects) else None
    if individuals:
        names = tuple(name.rpartition(":")[2] for name in names)
    return of_frames(
        path,
        factor * points,
        video=path.stem,
        landmark_names=names,
        individuals=individuals,
        frame_rate=rate if np.isfinite(rate) and rate > 0 else None,
        unit=unit or UNKNOWN_UNIT,
        **fields,
    )


def _are_flat(points: Floats) -> bool:
    """Whether z of all points (n, m, 3) that are known is exactly 0."""
    z = points[..., 2]
    known = np.isfinite(z)
    return bool(known.any()) and not z[known].any()


def _of_flat_markers(
    path: Path,
    points: Floats,
    names: Sequence[str],
    rate: float,
    unit: str,
    *,
    notes: tuple[str, ...] = (),
    **fields: Any,
) -> Poses:
    """Return markers in a plane (n, m, 3) as landmarks in 2D, their y turned down, as
    that of images is.
    """
    note = "z is 0 everywhere: read as landmarks in 2D, y turned down"
    return of_frames(
        path,
        points[..., :2] * (1.0, -1.0),
        video=path.stem,
        landmark_names=tuple(names),
        frame_rate=rate if np.isfinite(rate) and rate > 0 else None,
        unit=unit or UNKNOWN_UNIT,
        notes=(*notes, note),
        **fields,
    )
