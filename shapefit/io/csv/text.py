"""Read CSV text a block at a time into columns of cells, with the line of every row."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import InputError, input_error
from shapefit.io.csv.rows import bad_line, read_rows, split_columns
from shapefit.io.csv.sections import Section, read_sections
from shapefit.io.problems import Problems
from shapefit.io.sources import source_name

Columns = Sequence[Sequence[str]]
Lines = NDArray[np.int64]


@dataclass(frozen=True)
class Block:
    """Some rows of a table: the cells of each column, and the line on which each row begins."""

    cells: dict[str, Sequence[str]]
    lines: Lines


class CsvText:
    """The rows of a CSV file as blocks of text cells; empty rows are dropped.

    `required` columns must be there, `optional` ones may, in any order. Where the header has
    spaces around its names, so have the cells, and they are taken away. Raises InputError for
    text that is not UTF-8 and for other columns.
    """

    def __init__(self, path: Path, required: Sequence[str], optional: Sequence[str]) -> None:
        self.name = source_name(path)
        self._sections = read_sections(path)
        self._first = next(self._sections)
        header = self._split_header()
        self._spaced = any(column != column.strip() for column in header)
        self.columns = self._check_header([column.strip() for column in header], required, optional)

    def blocks(self) -> Iterator[Block]:
        """Give out all rows, once.

        Raises InputError for text that is not UTF-8, for cells that are no CSV and, when
        everything is read, for rows with too few or too many cells.
        """
        widths = Problems()
        for section in chain([self._first.without_header()], self._sections):
            columns, lines = self._split(section, widths)
            if self._spaced:
                columns = [[cell.strip() for cell in column] for column in columns]
            if len(lines):
                yield Block(dict(zip(self.columns, columns, strict=True)), lines)
        widths.raise_if_any()

    def _split(self, section: Section, widths: Problems) -> tuple[Columns, Lines]:
        width = len(self.columns)
        columns = split_columns(section, width) if section else None
        if columns is not None:
            return columns, np.arange(section.line, section.line + len(columns[0]))
        rows: list[list[str]] = []
        lines: list[int] = []
        try:
            for line, row in read_rows(section, self.name):
                if len(row) != width:
                    found = f"has {len(row)} cells for {width} columns"
                    widths.tell(f"{self.name}:{line}: {found}; write one cell per column", line)
                    continue
                rows.append(row)
                lines.append(line)
        except InputError:
            widths.raise_if_any()
            raise
        return list(zip(*rows, strict=True)), np.array(lines, np.int64)

    def _split_header(self) -> list[str]:
        try:
            return next(csv.reader([self._first_line]), [])
        except csv.Error as error:
            raise bad_line(f"{self.name}:1", error) from error

    @property
    def _first_line(self) -> str:
        return self._first.text.partition("\n")[0].rstrip("\r")

    def _check_header(
        self, columns: list[str], required: Sequence[str], optional: Sequence[str]
    ) -> list[str]:
        wanted = ",".join(required) + "".join(f"[,{column}]" for column in optional)
        known = {*required, *optional}
        place = f"{self.name}:1"
        if not known & set(columns) and len(columns) == 1:
            for letter, name in ((";", "semicolons"), ("\t", "tabs")):
                if letter in columns[0] and not known & set(columns[0].split(letter)):
                    fix = "save it with commas between the cells, and with decimal points"
                    raise input_error(place, f"separates its cells by {name}", fix)
        if "frame_idx" in columns and "item" not in columns:
            fix = "give the .slp file, or export the analysis HDF5 file of SLEAP"
            raise input_error(place, "is one of SLEAP's tables, which are not read", fix)
        if not known & set(columns):
            fix = f"write the header {wanted}, with commas"
            raise input_error(place, f"the header is '{self._first_line.strip()[:80]}'", fix)
        problems = Problems()
        for column in columns:
            if column not in known:
                near = get_close_matches(column, known, n=1)
                fix = f"did you mean '{near[0]}'?" if near else f"the columns are {wanted}"
                problems.tell(f"{place}: unknown column '{column}'; {fix}")
            elif columns.count(column) > 1:
                fix = "keep one of them"
                problems.tell(f"{place}: the column '{column}' repeats; {fix}")
        for column in required:
            if column not in columns:
                fix = f"the columns are {wanted}"
                problems.tell(f"{place}: there is no column '{column}'; {fix}")
        problems.raise_if_any()
        return columns
