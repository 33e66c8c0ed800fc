"""Points of motion capture as text: TRC, and the CSV of Vicon."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.errors import counted
from shapefit.geometry.normalisation import as_metres
from shapefit.io.csv_cells import read_numbers
from shapefit.io.formats import Head
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.poses import (
    Poses,
    check_rate,
    frames_of_labels,
    frames_of_times,
    number_repeats,
    poses_from_frames,
    require,
)
from shapefit.io.readers.text import parse_floats, read_table, read_text

HEADER_LINES = 5
"""Lines of TRC before the first frame; names stand in the fourth, X1 in the fifth."""


def is_trc(head: Head) -> bool:
    """Whether a text begins with PathFileType, as only files of TRC do."""
    return head.text.lstrip()[:12].lower() == b"pathfiletype"


def read_trc(paths: tuple[Path, ...]) -> Poses:
    """Read the markers of a TRC file, whose cells are divided by tabs or commas.

    A name stands above the X of each marker.

    A point is missing where a coordinate is empty or nan, and where all three are
    exactly 0. Points without a name, which some programs write after the others, are
    left out.
    """
    path = paths[0]
    text = read_text(path)
    delimiter = "\t" if "\t" in text else ","
    about, labels = _read_trc_header(text, delimiter)
    text, unnamed = _drop_extra_points(text, 3 * len(labels) + 2, delimiter)
    points, frames, times = _read_points(path, text, labels, HEADER_LINES, delimiter)
    origin = np.asarray((points == 0).all(axis=2))
    points = np.where(origin[..., None], np.nan, points)
    named = [number for number, label in enumerate(labels) if label]
    require(named, "no names of markers in line 4, above X1 Y1")
    nameless = [number for number, label in enumerate(labels) if not label]
    unnamed += int(np.isfinite(points[:, nameless]).all(axis=2).sum())
    origins = int(origin[:, named].sum())
    notes = _notes_of_trc(about, len(points), origins, unnamed)
    require("datarate" in about, "there is no DataRate in line 2")
    rate = parse_floats([about["datarate"]])[0]
    timed = len(times) > 0 and bool(np.isfinite(times).all())
    numbers = frames_of_labels(frames)
    if timed and (numbers is None or _are_consecutive(numbers)):
        # Frames that were dropped can leave a gap in the times alone.
        numbers = frames_of_times(times, rate) or numbers
    return poses_from_markers(
        path,
        points[:, named],
        [labels[number] for number in named],
        rate,
        about.get("units", ""),
        labels=frames,
        frames=numbers,
        times=times if timed else None,
        notes=notes,
    )


def _read_trc_header(text: str, delimiter: str) -> tuple[dict[str, str], list[str]]:
    """Parse the header of TRC: return key -> value, and the label of each marker.

    Keys are in small letters; a marker without a name is "". Raises FormatError for
    headers that are not whole.
    """
    lines = text.split("\n")
    require(len(lines) >= HEADER_LINES, f"its header has {len(lines)} lines, not 5")
    head = [_split_cells(line, delimiter) for line in lines[:HEADER_LINES]]
    _, keys, values, names, axes = head
    about = dict(zip(map(str.lower, keys), values, strict=False))
    count = sum(map(bool, axes[2:])) // 3  # X1 Y1 Z1 X2 ...
    require(
        count and names[0].lower() == "frame#",
        "no names of markers in line 4, above X1 Y1",
    )
    require(not any(names[3::3] + names[4::3]), "names that do not stand above an X")
    return about, _labels_above(names, count)


def _split_cells(line: str, delimiter: str) -> list[str]:
    """Split a line into cells, without the spaces around them."""
    return [cell.strip() for cell in line.split(delimiter)]


def _labels_above(names: Sequence[str], count: int) -> list[str]:
    """Return the label above the X of each of `count` markers; "" for none.

    The first marker stands in the third cell; a line may be shorter.
    """
    cells = [*names[2:], *[""] * (3 * count)]
    return cells[: 3 * count : 3]


def _drop_extra_points(text: str, cells: int, delimiter: str) -> tuple[str, int]:
    """Cut rows of TRC to `cells` cells; return the text and the number of points cut.

    A point has three cells: rows whose further cells are not of points stay.
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


def _notes_of_trc(
    about: Mapping[str, str], frames: int, origins: int, unnamed: int
) -> tuple[str, ...]:
    """Return notes on absent frames, points at the origin, and points without a name.

    about: the header of the file; frames: how many there are; origins and unnamed:
    numbers of such points.
    """
    announced = parse_floats([about.get("numframes") or "0"])[0]
    notes = []
    if announced > frames:
        lost = int(announced) - frames
        notes.append(f"{lost} frames are announced in the header, but not there")
    if origins:
        notes.append(f"{origins} points at exactly 0, 0, 0 taken for missing")
    if unnamed:
        notes.append(f"{counted(unnamed, 'point')} without a name left out")
    return tuple(notes)


def _are_consecutive(numbers: Sequence[int]) -> bool:
    """Whether frame numbers are 0, 1, 2, ... in any order, without a gap."""
    return sorted(numbers) == [*range(len(numbers))]


def is_vicon(head: Head) -> bool:
    """Whether a text has a section `Trajectories` with columns as of Vicon Nexus."""
    _, _, after = head.text.lower().partition(b"trajectories")
    return b"frame,sub frame," in after


def read_vicon(paths: tuple[Path, ...]) -> Poses:
    """Read the section `Trajectories` of a CSV that Vicon Nexus exports.

    Below it stand the rate, a label above the X of each marker, `Frame,Sub
    Frame,X,Y,Z,...`, the units, and the frames up to an empty line. An empty cell is
    missing.
    """
    path = paths[0]
    lines = read_text(path).split("\n")
    start, end = _find_trajectories(lines)
    head = [_split_cells(line, ",") for line in lines[start : start + 4]]
    whole = len(head) == 4 and len(head[3]) > 2
    require(whole, "the four lines below Trajectories are not complete")
    rates, names, axes, units = head
    count = axes.count("X")
    require(
        axes == ["Frame", "Sub Frame", *"XYZ" * count], "other columns than X, Y and Z"
    )
    labels = _labels_above(names, count)
    text = "\n".join(lines[:end])
    points, frames, _ = _read_points(path, text, labels, start + 4)
    return poses_from_markers(
        path,
        points,
        labels,
        rate=parse_floats([rates[0]])[0],
        unit=units[2],
        labels=frames,
        frames=frames_of_labels(frames),
    )


def _find_trajectories(lines: Sequence[str]) -> tuple[int, int]:
    """Return the indices of the first line of section `Trajectories`, and its end.

    The first is that below its title, the second that after its last line. Raises
    FormatError where there is no such section.
    """
    bare = [line.strip(', "\t') for line in lines]
    sections = [line.lower() for line in bare]
    require("trajectories" in sections, "no section Trajectories")
    start = sections.index("trajectories") + 1
    return start, bare.index("", start) if "" in bare[start:] else len(bare)


def _read_points(
    path: Path, text: str, labels: Sequence[str], after: int, delimiter: str = ","
) -> tuple[Floats, list[str], Floats]:
    """Read rows of markers: points (n, m, 3), frame labels, and the second column (n,).

    That is of times, or of other numbers; NaN where it is no number. The rows come
    after `after` lines, and are a frame, the second column, and x, y, z of each marker.
    """
    columns = ["Frame", "", *(f"{name} {axis}" for name in labels for axis in "XYZ")]
    table = read_table(path, text, columns, delimiter, after=after, padded=True)
    points = table.numbers(range(2, len(columns))).reshape(-1, len(labels), 3)
    frames = [frame or str(number) for number, frame in enumerate(table.texts(0)[0])]
    beside, _ = read_numbers(table.texts(1)[0])
    return points, frames, beside


def poses_from_markers(
    path: Path,
    points: Floats,
    markers: Sequence[str],
    rate: float,
    unit: str,
    *,
    labels: Sequence[str],
    frames: Sequence[int] | Integers | None = None,
    times: Floats | None = None,
    notes: tuple[str, ...] = (),
) -> Poses:
    """Make Poses of the markers (n, m, 3) of one body, in metres if `unit` is known.

    y points up where they are landmarks in a plane.

    `subject:` before all their names is the individual; labels, frames and times (n)
    as `poses_from_frames` takes them.
    """
    names = number_repeats(markers)
    factor, unit = as_metres(unit)
    is_known, doubts = check_rate(rate)
    subjects = {name.rpartition(":")[0] for name in names if not name.startswith("*")}
    individuals = [*subjects] if len(subjects) == 1 and any(subjects) else None
    if individuals:
        names = tuple(name.rpartition(":")[2] for name in names)
    return poses_from_frames(
        path,
        factor * points,
        video=path.stem,
        landmark_names=names,
        individuals=individuals,
        frame_rate=rate if is_known else None,
        unit=unit or UNKNOWN_UNIT,
        y_axis="up",
        labels=labels,
        frames=frames,
        times=None if doubts else times,
        notes=(*notes, *doubts),
    )
