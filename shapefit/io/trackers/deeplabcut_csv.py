"""DeepLabCut CSV, which Lightning Pose writes, too: a row for each frame, columns by name.

Three lines of names (scorer, bodyparts, coords) come first, four with `individuals`. The first
column is the number of the frame, or the path of an image, which may be split in three columns.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.errors import input_error, printable
from shapefit.io.csv.text import Section, bad_line, read_columns, read_numbers, read_sections
from shapefit.io.foreign.recording import Instances, Recording, stacked, video_name
from shapefit.io.motion.text import read_head, read_plain
from shapefit.io.problems import Problems
from shapefit.io.sources import source_name
from shapefit.io.trackers.deeplabcut_table import SAVE, Layout, arrange, skeleton_edges
from shapefit.io.trackers.frame_names import image_labels, number_label
from shapefit.io.trackers.reading import BLOCK_FRAMES

HEADER = ("scorer", "individuals", "bodyparts", "coords")

Columns = Sequence[Sequence[str]]

ABSENT = {"NA", "N/A", "#N/A", "NULL", "null", "None"}
"""Cells that pandas takes for missing, besides those of nan."""

FIX = "write a number, or leave the cell empty where the landmark is missing"


def record(paths: tuple[Path, ...]) -> Recording:
    """Open a file; it is read when its blocks are."""
    table = _Table(paths[0])
    layout = table.layout
    return Recording(
        name=source_name(paths[0]),
        video=video_name(paths[0]),
        dimensions=layout.dimensions,
        landmark_names=layout.landmarks,
        blocks=table.blocks,
        individuals=layout.individuals,
        notes=layout.notes,
        edges=skeleton_edges(paths[0], layout.landmarks),
        unit=layout.unit,
    )


class _Table:
    """A CSV file: its columns, and what reads its rows."""

    def __init__(self, path: Path) -> None:
        self._path, self._name = path, source_name(path)
        rows = _first_rows(path, self._name)
        header: dict[str, list[str]] = {}
        for row in rows:
            if row[0].strip() not in HEADER or row[0].strip() in header:
                break
            header[row[0].strip()] = [cell.strip() for cell in row]
        for name in ("bodyparts", "coords"):
            if name not in header:
                raise input_error(f"{self._name}:1", f"there is no line {name!r}", SAVE)
        coords = header["coords"]
        named = [column for column in range(1, len(coords)) if coords[column]]
        self._indices = named[0] if named else 1
        self._width = len(coords)
        self._columns = np.array(named, dtype=np.intp)
        self.layout = self._arrange(header, named)
        data = rows[len(header) :]
        self._is_numbered = not data or not read_numbers([data[0][0]]).strange.any()
        names_of_index = (
            data and not self._is_numbered and "." not in data[0][0] and not any(data[0][1:])
        )
        self._lines_before = len(header) + bool(names_of_index)

    def _arrange(self, header: dict[str, list[str]], named: list[int]) -> Layout:
        levels = [header[name] for name in HEADER[1:] if name in header]
        if sizes := sorted({len(level) for level in levels} - {self._width}):
            found = f"the lines of names have {sizes[0]} and {self._width} cells"
            raise input_error(f"{self._name}:1", found, "give each column a name in each line")
        scorers = header.get("scorer", [])
        columns = [
            (scorers[column] if column < len(scorers) else "", *(level[column] for level in levels))
            for column in named
        ]
        return arrange(f"{self._name}:1", columns)

    def blocks(self) -> Iterator[Instances]:
        """Read all frames, some thousand at a time."""
        images: Iterator[str] | None = None
        if not self._is_numbered:
            images = iter(image_labels([*chain.from_iterable(names for names, _ in self._rows())]))
        start = 0
        held: list[Instances] = []
        for labels, values in self._rows():
            names = labels if images is None else [next(images) for _ in labels]
            held.append(self.layout.instances(values[:, self._columns], start, names))
            start += len(labels)
            if sum(map(len, held)) >= BLOCK_FRAMES:
                yield stacked(held)
                held = []
        if held:
            yield stacked(held)

    def _rows(self) -> Iterator[tuple[list[str], Floats]]:
        """Read what frames are called, and their numbers (n, columns), section by section."""
        before = self._lines_before
        problems = Problems()
        for section in read_sections(self._path):
            while before and section:
                section, before = section.without_header(), before - 1
            if section.data.strip():
                yield self._plain(section) or self._cells(section, problems)
                problems.raise_if_any()

    def _plain(self, section: Section) -> tuple[list[str], Floats] | None:
        """Read a section that holds numbers alone; None for others, which `_cells` reads."""
        if not self._is_numbered or self._indices != 1:
            return None
        lines = section.text.replace("\r\n", "\n").removesuffix("\n").split("\n")
        values = read_plain(lines, ",", self._width)
        if values is None or not np.isfinite(values[:, 0]).all():
            return None
        return [number_label(place) for place in values[:, 0].tolist()], values

    def _cells(self, section: Section, problems: Problems) -> tuple[list[str], Floats]:
        """Read any section, and say what is wrong with its cells.

        Rows of images may end before their empty cells.
        """
        padded = not self._is_numbered
        columns, lines = read_columns(section, self._width, self._name, problems, padded=padded)
        problems.raise_if_any()
        values = np.full((len(lines), self._width), np.nan)
        for column in self._columns.tolist():
            numbers = read_numbers(columns[column])
            if numbers.strange.any():
                cells = ["" if cell.strip() in ABSENT else cell for cell in columns[column]]
                numbers = read_numbers(cells)
            values[:, column] = numbers.values
            told = {}
            for row in np.flatnonzero(numbers.strange).tolist():
                found = f"column {column + 1} is {printable(columns[column][row])!r}"
                told[int(lines[row])] = f"{self._name}:{lines[row]}: {found}; {FIX}"
            problems.add(list(told), told.__getitem__)
        return self._labels(columns, lines), values

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


def _first_rows(path: Path, name: str) -> list[list[str]]:
    """Return the cells of the first lines that are not empty."""
    reader = csv.reader(read_head(path, len(HEADER) + 1), strict=True)
    try:
        return [row for row in reader if row]
    except csv.Error as error:
        raise bad_line(f"{name}:{reader.line_num}", error) from error
