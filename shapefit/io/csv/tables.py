"""Tidy CSV tables: one row a landmark of an item, to arrays."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.io.csv.text import Block, CsvText, check_columns
from shapefit.io.layout import MODE_COUNT
from shapefit.io.memory import check_fits
from shapefit.io.problems import Problems
from shapefit.io.records import LandmarkSet, Names, ResultSet, ShapeSet
from shapefit.lifting.verdict import TRUSTED

__all__ = ["Block", "TidyTable", "check_columns", "records_of"]

GROWTH = 1.25
"""Room that a growing array makes at once, as a multiple of what it holds."""


class NumberedNames:
    """The distinct texts of a column, numbered in order of appearance."""

    def __init__(self) -> None:
        self._numbers: defaultdict[str, int] = defaultdict(count().__next__)

    def __len__(self) -> int:
        return len(self._numbers)

    def number(self, cells: Sequence[str]) -> NDArray[np.int64]:
        """Return the number of the text in each cell; a new text gets the next one."""
        return np.fromiter(map(self._numbers.__getitem__, cells), np.int64, len(cells))

    def names(self) -> tuple[str, ...]:
        """Return the texts in the order of their numbers."""
        return tuple(self._numbers)


class Grid:
    """An array that grows, cheaply along its first axis; new entries hold `fill`."""

    def __init__(self, axes: int, fill: float, dtype: type[np.generic]) -> None:
        self.values: NDArray[Any] = np.empty((0,) * axes, dtype)
        self._fill = fill

    def reach(self, *shape: int) -> None:
        """Grow to at least this shape, with room along the first axis to grow again."""
        length, *others = self.values.shape
        if others != list(shape[1:]):
            wider = np.full((length, *shape[1:]), self._fill, self.values.dtype)
            wider[tuple(map(slice, self.values.shape))] = self.values
            self.values = wider
        if shape[0] > length:
            self._lengthen(int(GROWTH * shape[0]))

    def cut(self, *shape: int) -> NDArray[Any]:
        """Return the array in this shape, without the room to grow."""
        self.reach(*shape)
        self._lengthen(shape[0])
        return self.values

    def _lengthen(self, length: int) -> None:
        """Change the first axis where the array lies, so that it is never held twice."""
        before = len(self.values)
        self.values.resize((length, *self.values.shape[1:]), refcheck=False)
        self.values[before:] = self._fill


FINITE_FIX = "write a finite number"
UNSEEN_FIX = f"{FINITE_FIX}, or leave the cell empty where the landmark is unseen"
UNKNOWN_FIX = f"{FINITE_FIX}, or leave the cell empty where the landmark is unknown"
FAILED_FIX = f"{FINITE_FIX}, or leave the cell empty where the item failed"
FIXES = {"landmarks": UNSEEN_FIX, "shapes": FINITE_FIX, "gaps": UNKNOWN_FIX, "result": FAILED_FIX}
CONFIDENCE_FIX = "write 0 (hidden) or a positive number"


DEVIATIONS = ("sd_x", "sd_y", "sd_z")
"""Columns of results: standard deviations, which nothing here reads back."""

RESULT_COLUMNS = ("sequence", *DEVIATIONS, MODE_COUNT.name, TRUSTED)
"""Columns that a result may have; only the sequence is read."""


def read_shape_table(path: Path, *, gaps: bool = False) -> ShapeSet:
    """Read `item,landmark,x,y,z[,sequence]`, every landmark of every item.

    With `gaps` a landmark that has no row, or an empty or nan coordinate, is unknown: NaN.
    """
    shapes: ShapeSet = records_of(TidyTable(path, "shapes", CsvText, gaps=gaps), "shapes")
    return shapes


def read_landmark_table(path: Path) -> LandmarkSet:
    """Read `item,landmark,x,y[,confidence][,sequence]`; an empty or nan coordinate is unseen."""
    landmarks: LandmarkSet = records_of(TidyTable(path, "landmarks", CsvText), "landmarks")
    return landmarks


def read_result_table(path: Path) -> ResultSet:
    """Read `item,landmark,x,y,z[,sequence]`; empty cells stand for items that failed."""
    results: ResultSet = records_of(TidyTable(path, "result", CsvText), "result")
    return results


def records_of(table: TidyTable, kind: str) -> Any:
    """Return what a table holds as records of a kind."""
    named = (table.points, table.landmarks, table.items, table.sequences)
    if kind == "landmarks":
        return LandmarkSet(*named, confidence=table.confidence)
    return ShapeSet(*named) if kind == "shapes" else ResultSet(*named)


class TidyTable:
    """The rows of a tidy table as arrays over items and landmarks, in order of appearance.

    points (n, d, p), all NaN for a landmark that has no row or lacks a coordinate; confidence
    (n, p), 0 where there is no row; sequences (n); None without the column. Raises InputError
    with all wrong cells together, by line.
    """

    def __init__(
        self,
        path: Path,
        kind: str,
        source: Callable[[Path, Sequence[str], Sequence[str]], Any],
        *,
        gaps: bool = False,
    ) -> None:
        """Read all that `source` gives of a file: CsvText, or ParquetRows.

        With `gaps` a landmark of a shape may have no row, or no coordinates.
        """
        coordinates = ("x", "y") if kind == "landmarks" else ("x", "y", "z")
        optional = ("confidence", "sequence") if kind == "landmarks" else RESULT_COLUMNS
        empty_allowed = gaps or kind != "shapes"
        self._text = source(path, ("item", "landmark", *coordinates), optional)
        self.said = getattr(self._text, "said", {})
        self._coordinates, self._fix = coordinates, FIXES[kind if not gaps else "gaps"]
        self._unfit = np.isinf if empty_allowed else _not_finite
        kinds = ("item", "landmark", "repeated", "sequence", *coordinates, "confidence")
        self._problems = {kind: Problems() for kind in kinds}
        self._names = {column: NumberedNames() for column in ("item", "landmark", "sequence")}
        self._lines = Grid(2, 0, np.uint32)  # of the row of each item and landmark; 0 is none
        self._points = Grid(3, np.nan, np.float64)
        self._confidence = Grid(2, 0.0, np.float64)
        self._sequence = Grid(1, -1, np.int64)
        for block in self._text.blocks():
            self._take(block)
        self._raise_if_wrong()
        self.items, self.landmarks = (self._names[c].names() for c in ("item", "landmark"))
        n, p = len(self.items), len(self.landmarks)
        self.points: Floats = self._points.cut(n, len(coordinates), p)
        self.confidence: Floats | None = None
        if "confidence" in self._text.columns:
            self.confidence = self._confidence.cut(n, p)
        self.sequences: Names | None = None
        if "sequence" in self._text.columns:
            names = self._names["sequence"].names()
            self.sequences = tuple(names[code] for code in self._sequence.cut(n).tolist())
        if not empty_allowed:
            self._check_complete()

    def _check_complete(self) -> None:
        """Raise InputError where an item lacks a landmark."""
        missing = np.flatnonzero(self._lines.cut(len(self.items), len(self.landmarks)) == 0)
        problems = Problems()
        problems.add(missing, self._word_missing)
        problems.raise_if_any()

    def _take(self, block: Block) -> None:
        known = len(self._names["item"])
        item, landmark = self._number(block, "item"), self._number(block, "landmark")
        n, p = len(self._names["item"]), len(self._names["landmark"])
        self._check_fits(n, p)
        self._take_lines(block, item, landmark, (n, p))
        if "sequence" in block.cells:
            self._take_sequences(block, item, known)
        rows = np.stack([self._numbers(block, column) for column in self._coordinates], axis=-1)
        rows[np.isnan(rows).any(axis=-1)] = np.nan
        self._points.reach(n, len(self._coordinates), p)
        self._points.values[item, :, landmark] = rows
        if "confidence" in self._text.columns:
            self._confidence.reach(n, p)
            self._confidence.values[item, landmark] = self._confidences(block)

    def _check_fits(self, n: int, p: int) -> None:
        """Raise InputError where the arrays of n items and p landmarks are more than memory holds.

        A row of an item and a landmark of its own each takes p and n numbers more, not one.
        """
        grids = (self._lines, self._points, self._confidence)
        held = self._lines.values.shape
        if n <= held[0] and p <= held[1]:
            return
        axes = len(self._coordinates)
        entry = sum(grid.values.itemsize for grid in (*grids, *(axes - 1) * [self._points]))
        size = int(entry * n * p * GROWTH)
        size -= sum(grid.values.nbytes for grid in grids) if p == held[1] else 0
        check_fits(self._text.name, size, f"a table of {n} items and {p} landmarks")

    def _number(self, block: Block, column: str) -> Integers:
        """Return the number of the item or landmark of each row."""
        cells = block.cells[column]
        if "" in cells:
            unnamed = np.array([cell == "" for cell in cells])
            self._note(column, block, unnamed, f"name the {column}")
        return self._names[column].number(cells)

    def _take_lines(
        self, block: Block, item: Integers, landmark: Integers, shape: tuple[int, int]
    ) -> None:
        """Remember the first row of each item and landmark, and note the others."""
        self._lines.reach(*shape)
        lines = self._lines.values
        fresh = np.flatnonzero(lines[item, landmark] == 0)[::-1]  # of equal ones the first wins
        lines[item[fresh], landmark[fresh]] = block.lines[fresh]
        first = lines[item, landmark]

        def word(row: int) -> str:
            name, of = block.cells["item"][row], block.cells["landmark"][row]
            found = f"item '{name}', landmark '{of}' is also on line {first[row]}"
            return f"{found}; keep one of them"

        self._tell("repeated", block, first != block.lines, word)

    def _take_sequences(self, block: Block, item: Integers, known: int) -> None:
        """Take the sequence of each item from its first row, of new ones those from `known` on."""
        codes = self._names["sequence"].number(block.cells["sequence"])
        new, first = np.unique(item, return_index=True)
        is_new = new >= known
        self._sequence.reach(len(self._names["item"]))
        self._sequence.values[new[is_new]] = codes[first[is_new]]
        differs = codes != self._sequence.values[item]
        self._note("sequence", block, differs, "give all rows of an item one sequence")

    def _numbers(self, block: Block, column: str) -> Floats:
        numbers = block.column(column)
        self._note(column, block, numbers.strange | self._unfit(numbers.values), self._fix)
        return numbers.values

    def _confidences(self, block: Block) -> Floats:
        values = block.column("confidence").values
        self._note("confidence", block, _not_finite(values) | (values < 0), CONFIDENCE_FIX)
        return values

    def _note(self, column: str, block: Block, wrong: NDArray[np.bool_], fix: str) -> None:
        """Note the wrong cells of a column."""

        def word(row: int) -> str:
            cell = block.word(column, row)
            return f"{column} is '{cell}'; {fix}" if cell else f"{column} is empty; {fix}"

        self._tell(column, block, wrong, word)

    def _tell(
        self, kind: str, block: Block, wrong: NDArray[np.bool_], word: Callable[[int], str]
    ) -> None:
        if not wrong.any():
            return
        rows = np.flatnonzero(wrong)
        row_of = dict(zip(block.lines[rows].tolist(), rows.tolist(), strict=True))
        place = self._text.place
        self._problems[kind].add(list(row_of), lambda line: f"{place(line)}: {word(row_of[line])}")

    def _raise_if_wrong(self) -> None:
        problems = Problems()
        for found in self._problems.values():
            problems.join(found)
        problems.raise_if_any()

    def _word_missing(self, entry: int) -> str:
        item, landmark = divmod(entry, len(self.landmarks))
        found = f"item '{self.items[item]}' has no landmark '{self.landmarks[landmark]}'"
        return f"{self._text.name}: {found}; write every landmark of every item"


def _not_finite(values: Floats) -> NDArray[np.bool_]:
    return ~np.isfinite(values)
