"""DeepLabCut CSV, which Lightning Pose writes, too: a row for each frame, columns by name.

Three lines of names (scorer, bodyparts, coords) come first, four with `individuals`. The first
column is the number of the frame, or the path of an image, which may be split in three columns.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import chain
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.errors import input_error, printable
from shapefit.io.csv.numbers import read_numbers
from shapefit.io.csv.text import (
    Section,
    bad_line,
    read_rows,
    read_sections,
    split_columns,
)
from shapefit.io.foreign.recording import Instances, Recording, video_name
from shapefit.io.motion.text import read_plain
from shapefit.io.problems import Problems
from shapefit.io.sources import source_name
from shapefit.io.trackers.columns import Layout, arrange
from shapefit.io.trackers.deeplabcut_project import skeleton_edges
from shapefit.io.trackers.frame_names import image_labels, number_label
from shapefit.io.trackers.reading import BLOCK_FRAMES

HEADER = ("scorer", "individuals", "bodyparts", "coords")

Columns = Sequence[Sequence[str]]

ABSENT = {"NA", "N/A", "#N/A", "NULL", "null", "None"}
"""Cells that pandas takes for missing, besides those of nan."""

FIX = "write a number, or leave the cell empty where the landmark is missing"


@dataclass(frozen=True)
class _Rows:
    """Frames in a row: what they are called, and their numbers (n, columns)."""

    labels: list[str]
    values: Floats


def record(paths: tuple[Path, ...]) -> Recording:
    """Open a file; it is read when its blocks are."""
    return _Table(paths[0]).recording()


class _Table:
    """A CSV file: its columns, and what reads its rows."""

    def __init__(self, path: Path) -> None:
        self._path, self._name = path, source_name(path)
        first, _ = self._sections()
        rows = list(_split_lines(first, self._name, len(HEADER) + 1))
        header: dict[str, list[str]] = {}
        for row in rows:
            if row[0].strip() not in HEADER or row[0].strip() in header:
                break
            header[row[0].strip()] = [cell.strip() for cell in row]
        self._header_lines = len(header)
        for name in ("bodyparts", "coords"):
            if name not in header:
                fix = "save the table again with DeepLabCut"
                raise input_error(f"{self._name}:1", f"there is no line {name!r}", fix)
        coords = header["coords"]
        named = [column for column in range(1, len(coords)) if coords[column]]
        self._indices = named[0] if named else 1
        self._width = len(coords)
        self._columns = np.array(named, dtype=np.intp)
        if len(header["bodyparts"]) != self._width:
            found = f"the lines of names have {len(header['bodyparts'])} and {self._width} cells"
            raise input_error(f"{self._name}:1", found, "give each column a name in each line")
        self._layout = self._arrange(header, named)
        data = rows[self._header_lines :]
        self._is_numbered = not data or not read_numbers([data[0][0]]).strange.any()
        self._has_index_names = bool(
            data and not self._is_numbered and "." not in data[0][0] and not any(data[0][1:])
        )

    def recording(self) -> Recording:
        """Return what the file holds."""
        layout = self._layout
        return Recording(
            name=self._name,
            video=video_name(self._path),
            dimensions=layout.dimensions,
            landmark_names=layout.landmarks,
            blocks=self._blocks,
            individuals=layout.individuals,
            notes=layout.notes,
            edges=skeleton_edges(self._path, layout.landmarks),
            unit="px" if layout.dimensions == 2 else "unknown",
        )

    def _arrange(self, header: dict[str, list[str]], named: list[int]) -> Layout:
        levels = [header["bodyparts"], header["coords"]]
        if "individuals" in header:
            levels.insert(0, header["individuals"])
        scorers = header.get("scorer", [])
        if any(len(level) != self._width for level in levels):
            found = "the line 'individuals' has another number of cells than 'coords'"
            raise input_error(f"{self._name}:1", found, "give each column a name in each line")
        columns = [
            (scorers[column] if column < len(scorers) else "", *(level[column] for level in levels))
            for column in named
        ]
        return arrange(f"{self._name}:1", columns)

    def _blocks(self) -> Iterator[Instances]:
        """Read all frames."""
        images: Iterator[str] | None = None
        if not self._is_numbered:
            every = [label for rows in self._rows() for label in rows.labels]
            images = iter(image_labels(every))
        start = 0
        for rows in _gathered(self._rows()):
            labels = rows.labels if images is None else [next(images) for _ in rows.labels]
            yield self._layout.instances(rows.values[:, self._columns], start, labels)
            start += len(rows.labels)

    def _sections(self) -> tuple[Section, Iterator[Section]]:
        """Return a first section that has all lines of names, and the others."""
        sections = read_sections(self._path)
        first = next(sections)
        while first.data.count(b"\n") <= len(HEADER) + 1:
            more = next(sections, None)
            if more is None:
                break
            first = Section(first.data + more.data, first.text + more.text, first.line)
        return first, sections

    def _rows(self) -> Iterator[_Rows]:
        first, others = self._sections()
        for _ in range(self._header_lines + self._has_index_names):
            first = first.without_header()
        problems = Problems()
        for section in chain([first], others):
            if section.data.strip():
                yield self._fast(section) or self._slow(section, problems)
                problems.raise_if_any()

    def _fast(self, section: Section) -> _Rows | None:
        """Read a section that holds numbers alone; None for others, which `_slow` reads."""
        if not self._is_numbered or self._indices != 1:
            return None
        lines = section.text.replace("\r\n", "\n").removesuffix("\n").split("\n")
        values = read_plain(lines, ",", self._width)
        if values is None or not np.isfinite(values[:, 0]).all():
            return None
        labels = [number_label(place) for place in values[:, 0].tolist()]
        return _Rows(labels, values)

    def _slow(self, section: Section, problems: Problems) -> _Rows:
        """Read any section, and say what is wrong with its cells."""
        columns: Columns | None
        columns = split_columns(section, self._width) if section else None
        lines = np.arange(section.line, section.line + (len(columns[0]) if columns else 0))
        if columns is None:
            rows = list(read_rows(section, self._name))
            if not self._is_numbered:  # tables of labels may end before their empty cells
                rows = [(line, row + [""] * (self._width - len(row))) for line, row in rows]
            wrong = [line for line, row in rows if len(row) != self._width]
            found = f"has another number of cells than there are columns ({self._width})"
            fix = "write one cell for each column"
            problems.add(wrong, lambda line: f"{self._name}:{line}: {found}; {fix}")
            problems.raise_if_any()
            columns = list(zip(*(row for _, row in rows), strict=True))
            lines = np.array([line for line, _ in rows], np.int64)
        if not columns:
            return _Rows([], np.empty((0, self._width)))
        values = np.full((len(lines), self._width), np.nan)
        for column in self._columns.tolist():
            numbers = read_numbers(columns[column])
            if numbers.strange.any():
                cells = ["" if cell.strip() in ABSENT else cell for cell in columns[column]]
                numbers = read_numbers(cells)
            values[:, column] = numbers.values
            told = {}
            for row in np.flatnonzero(numbers.strange):
                found = f"column {column + 1} is {printable(columns[column][row])!r}"
                told[int(lines[row])] = f"{self._name}:{lines[row]}: {found}; {FIX}"
            problems.add(list(told), told.__getitem__)
        return _Rows(self._labels(columns, lines), values)

    def _labels(self, columns: Columns, lines: Integers) -> list[str]:
        parts = [[cell.strip() for cell in column] for column in columns[: self._indices]]
        if not self._is_numbered:
            return ["/".join(filter(None, row)) for row in zip(*parts, strict=True)]
        numbers = read_numbers(parts[0])
        wrong = ~np.isfinite(numbers.values)
        if wrong.any():
            row = int(np.argmax(wrong))
            found = f"the frame is {printable(parts[0][row])!r}, and others are numbers"
            raise input_error(f"{self._name}:{lines[row]}", found, "number the frames")
        return [number_label(value) for value in numbers.values.tolist()]


def _gathered(parts: Iterator[_Rows]) -> Iterator[_Rows]:
    """Join rows to blocks of some thousand frames."""
    held: list[_Rows] = []
    for rows in parts:
        held.append(rows)
        if sum(len(each.labels) for each in held) >= BLOCK_FRAMES:
            yield _joined(held)
            held = []
    if held:
        yield _joined(held)


def _joined(held: list[_Rows]) -> _Rows:
    return _Rows(
        [label for rows in held for label in rows.labels],
        np.concatenate([rows.values for rows in held]),
    )


def _split_lines(section: Section, name: str, count: int) -> Iterator[list[str]]:
    """Yield the cells of the first lines."""
    reader = csv.reader(StringIO(section.text, newline="\n"), strict=True)
    try:
        for row in reader:
            if row:
                yield row
            if reader.line_num >= count:
                return
    except csv.Error as error:
        raise bad_line(f"{name}:{reader.line_num}", error) from error
