"""Points of motion capture: TRC, anipose's CSV, and C3D, which ezc3d reads (the extra `c3d`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shapefit.errors import abbreviate, input_error
from shapefit.geometry.normalisation import as_metres
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.readers.columns import anipose_landmarks
from shapefit.io.readers.poses import Poses, make_unique, of_frames
from shapefit.io.readers.text_table import Table, read_text

HEAD_LINES = 12
"""Within which the names of the markers stand; five as a rule, more with empty lines between."""

AT_ORIGIN = "points at exactly 0, 0, 0 taken for missing"
TOO_FEW = "frames are announced in the header, but not there"


def read_trc(paths: tuple[Path, ...]) -> Poses:
    """Return the markers of a TRC file.

    A point is missing where a coordinate is empty or nan, and where all three are exactly 0.
    Raises InputError for a header without markers, and for frames that are no numbers.
    """
    path = paths[0]
    text = read_text(path)
    header = _read_header(path, text.split("\n")[:HEAD_LINES])
    names, notes = make_unique(header.labels)
    table = Table(path, header.delimiter, text)
    columns = [f"{name} {axis}" for name in names for axis in "XYZ"]
    table.skip(header.lines, ["Frame#", "Time", *columns])
    table.padded = True
    ((_, row),) = table.first_rows(1) or [(0, [])]
    if len(row) == 1:
        table.delimiter = None  # only the header has tabs
    numbers, (firsts,), _ = table.read(range(2, 2 + len(columns)), [0])
    labels = [first or str(frame) for frame, first in enumerate(firsts)]
    factor, unit = as_metres(header.values.get("units", ""))
    points = factor * numbers.reshape(len(labels), len(names), 3)
    origin = np.asarray((points == 0).all(axis=2))
    points[origin] = np.nan
    lost = {TOO_FEW: int(header.number("numframes")) - len(labels), AT_ORIGIN: int(origin.sum())}
    notes += tuple(f"{number} {what}" for what, number in lost.items() if number > 0)
    return of_frames(
        path,
        points,
        labels=labels,
        video=path.stem,
        landmark_names=names,
        frame_rate=header.number("datarate") or None,
        unit=unit or UNKNOWN_UNIT,
        notes=notes,
    )


@dataclass(frozen=True)
class Header:
    """What stands above the frames; `lines` is the number of its lines."""

    delimiter: str
    values: dict[str, str]
    labels: list[str]
    lines: int

    def number(self, name: str) -> float:
        """Return a value as a number; 0 where it is none, or below 0."""
        return _number(self.values.get(name, ""))


def _read_header(path: Path, lines: Sequence[str]) -> Header:
    """Read what stands above the frames. Raises InputError where there are no markers."""
    firsts = [line.replace(",", "\t").split("\t")[0].strip().lower() for line in lines]
    place = next((i for i, first in enumerate(firsts) if first in ("frame#", "frame")), None)
    if place is None:
        fix = "give a TRC file whose fourth line is `Frame#  Time  NAME ...`"
        raise input_error(path, "has no line with the names of markers", fix)
    delimiter = "\t" if "\t" in lines[place] else ","
    values: dict[str, str] = {}
    if "datarate" in firsts:
        at = firsts.index("datarate")
        keys, cells = (line.split(delimiter) for line in lines[at : at + 2])
        values = {k.strip().lower(): c.strip() for k, c in zip(keys, cells, strict=False)}
    cells = [cell.strip() for cell in lines[place].split(delimiter)[2:]]
    axes = 0
    if place + 1 < len(lines) and not firsts[place + 1] and lines[place + 1].strip():
        axes = sum(bool(cell.strip()) for cell in lines[place + 1].split(delimiter)[2:])
        place += 1
    given = [cell for cell in cells if cell]
    markers = axes // 3 or int(_number(values.get("nummarkers", ""))) or len(given)
    side_by_side = len(given) == markers and cells[: len(given)] == given and markers > 1
    labels = given if side_by_side else cells[::3][:markers]
    labels += [""] * (min(markers, max(len(cells), axes)) - len(labels))
    if not labels or not (given or axes):
        raise input_error(f"{path}:{place + 1}", "there are no markers", "give a TRC with markers")
    return Header(delimiter, values, labels, place + 1)


def _number(cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        return 0.0
    return max(value, 0.0) if np.isfinite(value) else 0.0


def read_anipose(paths: tuple[Path, ...]) -> Poses:
    """Read the 3D points that anipose writes: x, y, z, error, cameras and score of each landmark.

    They are in the unit of anipose; the score is their confidence. Raises InputError for rows of
    another width, and cells that are no numbers.
    """
    path = paths[0]
    table = Table(path)
    ((line, cells),) = table.first_rows(1)
    columns = [cell.strip() for cell in cells]
    table.skip(line, columns)
    names = anipose_landmarks(columns)
    place = {name: number for number, name in enumerate(columns)}
    left = [name[:-2] for name in columns if name.endswith("_x") and name[:-2] not in names]
    scored = all(f"{name}_score" in place for name in names)
    wanted = [f"{name}_{axis}" for name in names for axis in "xyz"]
    wanted += [f"{name}_score" for name in names if scored] + ["fnum"] * ("fnum" in place)
    values, _, _ = table.read([place[name] for name in wanted])
    points, scores = np.split(values[:, : 4 * len(names)], [3 * len(names)], axis=1)
    labels = None
    if "fnum" in place and np.isfinite(values[:, -1]).all():
        labels = [f"{number:.15g}" for number in values[:, -1].tolist()]
    scores = np.where(np.isfinite(scores), np.clip(scores, 0, None), np.nan)
    return of_frames(
        path,
        points.reshape(len(values), len(names), 3),
        scores if scored else None,
        labels,
        video=path.stem,
        landmark_names=names,
        notes=(f"points left out: {abbreviate(left)}",) if left else (),
    )
