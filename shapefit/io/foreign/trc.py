"""TRC, the tables of markers of OpenSim and motion capture: tabs, or commas as pyomeca writes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.geometry.length_units import as_metres
from shapefit.io.foreign.recording import Recording, one_individual
from shapefit.io.foreign.text import read_blocks, read_head, read_plain, read_table, unique_names
from shapefit.io.layout import UNKNOWN_UNIT

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
    labels, numbers = read_frames(path, header, len(names))
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
    lines = read_head(path, HEAD_LINES)
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


def read_frames(path: Path, header: Header, p: int) -> tuple[list[str], NDArray[np.float64]]:
    """Read the labels of the frames, and their coordinates (n, 3 p)."""
    width = 2 + 3 * p
    labels: list[str] = []
    parts = [np.empty((0, 3 * p))]
    for first, texts in read_blocks(path, header.lines):
        own = [text.partition(header.separator)[0].strip() for text in texts]
        plain = read_plain(texts, header.separator, width) if all(own) else None
        if plain is None:
            own, numbers = read_rows(path, header, first, texts, width)
        else:
            numbers = plain[:, 2:]
        labels += [label or str(frame) for frame, label in enumerate(own, len(labels))]
        parts.append(numbers)
    return labels, np.concatenate(parts)


def read_rows(
    path: Path, header: Header, first: int, texts: list[str], width: int
) -> tuple[list[str], NDArray[np.float64]]:
    """Read lines cell by cell: the labels of their frames, and their coordinates (n, 3p)."""
    lines, rows = [], []
    for line, text in enumerate(texts, first):
        if not text.strip(" \t,"):
            continue
        row = text.split(header.separator) if header.separator in text else text.split()
        if len(row) != width:
            row = _fitted(row, width, f"{path}:{line}")
        rows.append(row)
        lines.append(line)
    if not rows:
        return [], np.empty((0, width - 2))
    return [row[0].strip() for row in rows], read_table([row[2:] for row in rows], lines, path)


def _fitted(row: list[str], width: int, place: str) -> list[str]:
    """Return a row of this width: cells that are not there at its end are empty."""
    if len(row) < 2 or any(cell.strip() for cell in row[width:]):
        found = f"has {len(row)} cells for {width} columns"
        raise input_error(place, found, "write three cells per marker")
    return (row + [""] * (width - len(row)))[:width]


def _number(cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        return 0.0
    return value if np.isfinite(value) else 0.0
