"""The tidy table, one row a landmark of an item: its columns, and how its rows become records.

CSV is this table; `csv_file` knows text alone.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from itertools import count
from typing import Any, NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.io.checks import input_problems
from shapefit.io.inputs import check_fits
from shapefit.io.records import KINDS, Records, ResultSet
from shapefit.lifting.verdict import TRUSTED

DEVIATIONS = ("sd_x", "sd_y", "sd_z")
"""Columns of results: standard deviations, which nothing here reads back."""

IGNORED = (*DEVIATIONS, "modes", TRUSTED)
"""Columns of results that may be there."""

FINITE_FIX = "write a finite number"
FIXES = {
    "landmarks": f"{FINITE_FIX}, or leave the cell empty where the landmark is unseen",
    "shapes": FINITE_FIX,
    "gaps": f"{FINITE_FIX}, or leave the cell empty where the landmark is unknown",
    "result": f"{FINITE_FIX}, or leave the cell empty where the item failed",
}

MISSED = -1.0
"""Both coordinates of a landmark without confidence that was not found."""

IDENTITIES = ("person_id", "track_id", "individual", "id")
"""Columns that tell apart who is in one image: items and sequences end in them."""

GROWTH = 1.25
"""Room that a growing array makes at once, as a multiple of what it holds."""


class Columns(NamedTuple):
    """What stands in the columns beside `item` and `landmark`.

    numbers are (n, p) each; of_items holds what is the same in all rows of an item, (n,) each.
    """

    numbers: dict[str, Floats]
    of_items: dict[str, Sequence[Any]]


def columns_of(record: Records, part: slice = slice(None)) -> Columns:
    """Return the columns of some items, in their order in a file."""
    points, sd = record.points[part], getattr(record, "shape_sd", None)
    numbers = {"xyz"[axis]: points[:, axis] for axis in range(points.shape[1])}
    if (confidence := getattr(record, "confidence", None)) is not None:
        numbers["confidence"] = confidence[part]
    if sd is not None:
        numbers |= {name: sd[part, axis] for axis, name in enumerate(DEVIATIONS)}
    of_items: dict[str, Sequence[Any]] = {}
    if record.sequences is not None:
        of_items["sequence"] = record.sequences[part]
    if isinstance(record, ResultSet) and (trusted := record.per_item.get(TRUSTED)) is not None:
        of_items[TRUSTED] = np.asarray(trusted[part], bool).tolist()
    return Columns(numbers, of_items)


@dataclass(frozen=True)
class Block:
    """Some rows: cells of text by column, columns that are numbers already, lines of the rows."""

    cells: Mapping[str, Sequence[str]]
    lines: Integers
    numbers: Mapping[str, Floats] = field(default_factory=dict)

    def values(self, name: str) -> tuple[Floats, Flags]:
        """Return the numbers of a column, and which of its cells are no number at all."""
        if name in self.numbers:
            return self.numbers[name], np.zeros(len(self.lines), bool)
        return read_numbers(self.cells[name])


class Rows(NamedTuple):
    """An open table: its name and columns, its rows, which come once, and what marks a line."""

    name: str
    columns: Sequence[str]
    blocks: Iterator[Block]
    mark: str = ":"

    def place(self, line: int) -> str:
        """Name a line in messages."""
        return f"{self.name}{self.mark}{line}"


def table_columns(kind: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the columns that a table of a kind needs, and those that it may have."""
    if kind == "landmarks":
        return ("item", "landmark", "x", "y"), ("confidence", "sequence")
    return ("item", "landmark", "x", "y", "z"), ("sequence", *IGNORED)


def check_columns(columns: Sequence[str], kind: str, place: str) -> None:
    """Raise InputError for columns that are unknown, there twice, or missing."""
    required, optional = table_columns(kind)
    wanted = ",".join(required) + "".join(f"[,{column}]" for column in optional)
    known = {*required, *optional, *IDENTITIES}
    told = []
    for column in columns:
        if column not in known:
            near = get_close_matches(column, known, n=1)
            fix = f"did you mean '{near[0]}'?" if near else f"the columns are {wanted}"
            told.append(f"{place}: unknown column '{column}'; {fix}")
        elif columns.count(column) > 1:
            told.append(f"{place}: the column '{column}' repeats; keep one of them")
    for column in required:
        if column not in columns:
            told.append(f"{place}: there is no column '{column}'; the columns are {wanted}")
    if told:
        raise input_problems(told)


def with_identities(cells: dict[str, Sequence[str]]) -> dict[str, Sequence[str]]:
    """Return columns of which items and sequences end in who is in the image, where that is said.

    Without sequences, each individual is one.
    """
    named = next((cells[name] for name in IDENTITIES if name in cells), None)
    if named is None:
        return cells
    items = zip(cells["item"], named, strict=True)
    sequences = zip(cells.get("sequence", [""] * len(named)), named, strict=True)
    return {
        **cells,
        "item": [f"{item}/{who}" if item and who else item for item, who in items],
        "sequence": ["/".join(filter(None, pair)) for pair in sequences],
    }


def read_tidy(rows: Rows, kind: str, *, gaps: bool = False) -> Any:
    """Return the records of a table: items and landmarks in order of appearance.

    A landmark that has no row or lacks a coordinate is NaN, its
    confidence 0; shapes need all unless `gaps`. Raises InputError for the first wrong cells, by
    line.
    """
    table = _Table(rows, kind, gaps)
    for block in rows.blocks:
        table.take(block)
    items, names = table.names("item"), table.names("landmark")
    n, p = len(items), len(names)
    if table.finite:
        missing = np.argwhere(table.lines.cut(n, p) == 0)
        told = [
            f"{rows.name}: item '{items[row]}' has no landmark '{names[column]}'; "
            "write every landmark of every item"
            for row, column in missing[:10].tolist()
        ]
        if told:
            raise input_problems(told, len(missing))
    fields: dict[str, Any] = {"landmark_names": names, "items": items}
    if "sequence" in rows.columns:
        known = table.names("sequence")
        fields["sequences"] = tuple(known[code] for code in table.sequence.cut(n).tolist())
    if "confidence" in rows.columns:
        fields["confidence"] = table.confidence.cut(n, p)
    return KINDS[kind](table.points.cut(n, len(table.axes), p), **fields)


class _Grid:
    """An array that grows, cheaply along its first axis; new entries hold `fill`."""

    def __init__(self, name: str, axes: int, fill: float, dtype: type[np.generic]) -> None:
        self.values: NDArray[Any] = np.empty((0,) * axes, dtype)
        self._name, self._fill = name, fill

    def reach(self, *shape: int) -> NDArray[Any]:
        """Grow to at least this shape, with room along the first axis to grow again."""
        length, *others = self.values.shape
        if others != list(shape[1:]):
            check_fits(self._name, math.prod(shape) * self.values.itemsize)
            wider = np.full((length, *shape[1:]), self._fill, self.values.dtype)
            wider[tuple(map(slice, self.values.shape))] = self.values
            self.values = wider
        if shape[0] > length:
            self._lengthen(int(GROWTH * shape[0]))
        return self.values

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


class _Table:
    """The arrays of a table while its blocks come in."""

    def __init__(self, rows: Rows, kind: str, gaps: bool) -> None:
        self.axes = ("x", "y") if kind == "landmarks" else ("x", "y", "z")
        self.finite = kind == "shapes" and not gaps
        self._rows_are_landmarks = kind == "landmarks"
        self.lines = _Grid(rows.name, 2, 0, np.uint32)  # of each item and landmark; 0 is none
        self.points = _Grid(rows.name, 3, np.nan, np.float64)
        self.confidence = _Grid(rows.name, 2, 0.0, np.float64)
        self.sequence = _Grid(rows.name, 1, -1, np.int64)
        self._rows, self._fix = rows, FIXES["gaps" if gaps else kind]
        texts = ("item", "landmark", "sequence")
        self._numbers = {text: defaultdict[str, int](count().__next__) for text in texts}
        self._told: list[tuple[int, str]] = []

    def names(self, column: str) -> tuple[str, ...]:
        """Return the texts of a column in order of appearance."""
        return tuple(self._numbers[column])

    def take(self, block: Block) -> None:
        """Take the rows of a block; raises InputError for wrong ones."""
        known = len(self._numbers["item"])
        item, landmark = self._number(block, "item"), self._number(block, "landmark")
        n, p = len(self._numbers["item"]), len(self._numbers["landmark"])
        place = item * p + landmark
        self._take_lines(block, place, self.lines.reach(n, p).reshape(-1))
        if "sequence" in self._rows.columns:
            self._take_sequences(block, item, known)
        columns = [self._coordinate(block, axis) for axis in self.axes]
        missing = np.isnan(columns).any(axis=0)
        if self._rows_are_landmarks:  # as some detectors write what they miss
            confidence = block.values("confidence")[0] if "confidence" in self._rows.columns else 0
            missing |= (np.asarray(columns) == MISSED).all(axis=0) & ~(np.asarray(confidence) > 0)
        points = self.points.reach(n, len(columns), p).reshape(-1)
        for axis, values in enumerate(columns):
            points[(item * len(columns) + axis) * p + landmark] = np.where(missing, np.nan, values)
        if "confidence" in self._rows.columns:
            values, _ = block.values("confidence")
            wrong = ~(np.isfinite(values) & (values >= 0))
            self._note("confidence", block, wrong, "write 0 (hidden) or a positive number")
            self.confidence.reach(n, p).reshape(-1)[place] = values
        if self._told:
            raise input_problems([found for _, found in sorted(self._told, key=lambda row: row[0])])

    def _number(self, block: Block, column: str) -> Integers:
        """Return the number of the text in each row; a new text gets the next one."""
        cells = block.cells[column]
        if column != "sequence" and "" in cells:
            unnamed = np.array([cell == "" for cell in cells])
            self._note(column, block, unnamed, f"name the {column}")
        number, period = self._numbers[column].__getitem__, len(self._numbers[column])
        if 0 < period < len(cells) and cells[period:] == cells[:-period]:  # as most tables repeat
            return np.resize(np.fromiter(map(number, cells[:period]), np.int64), len(cells))
        return np.fromiter(map(number, cells), np.int64, len(cells))

    def _take_lines(self, block: Block, place: Integers, lines: NDArray[np.uint32]) -> None:
        """Remember the first row of each item and landmark, and tell the others."""
        fresh = np.flatnonzero(lines[place] == 0)[::-1]  # of equal ones the first wins
        lines[place[fresh]] = block.lines[fresh]
        first = lines[place]
        for row in np.flatnonzero(first != block.lines).tolist():
            names = f"item '{block.cells['item'][row]}', landmark '{block.cells['landmark'][row]}'"
            self._tell(block, row, f"{names} is also on line {first[row]}; keep one of them")

    def _take_sequences(self, block: Block, item: Integers, known: int) -> None:
        """Take the sequence of each item from its first row, of new ones those from `known` on."""
        codes = self._number(block, "sequence")
        new = np.flatnonzero(item >= known)[::-1]  # of equal ones the first wins
        sequence = self.sequence.reach(len(self._numbers["item"]))
        sequence[item[new]] = codes[new]
        differing = codes != sequence[item]
        self._note("sequence", block, differing, "give all rows of an item one sequence")

    def _coordinate(self, block: Block, axis: str) -> Floats:
        values, strange = block.values(axis)
        unfit = ~np.isfinite(values) if self.finite else np.isinf(values)
        self._note(axis, block, strange | unfit, self._fix)
        return values

    def _note(self, column: str, block: Block, wrong: Flags, fix: str) -> None:
        """Note the wrong cells of a column."""
        for row in np.flatnonzero(wrong).tolist() if wrong.any() else ():
            cell = block.cells[column][row] if column in block.cells else block.numbers[column][row]
            found = "empty" if cell == "" else f"'{cell}'"
            self._tell(block, row, f"{column} is {found}; {fix}")

    def _tell(self, block: Block, row: int, found: str) -> None:
        line = int(block.lines[row])
        self._told.append((line, f"{self._rows.place(line)}: {found}"))


def read_numbers(cells: Sequence[str]) -> tuple[Floats, Flags]:
    """Read decimal numbers, inf and nan; return them, and which cells are no number at all.

    Spaces around them do not count; an empty cell, and what is no number, is NaN.
    """
    strange = np.zeros(len(cells), bool)
    filled = [cell or "null" for cell in cells] if "" in cells else cells
    try:
        values = orjson.loads(f"[{','.join(filled)}]")  # four times as fast as float()
    except orjson.JSONDecodeError:
        values = []
    if len(values) == len(cells):
        kinds = set(map(type, values))
        if kinds <= {float, int}:
            return np.fromiter(values, np.float64, len(values)), strange
        if kinds <= {float, int, type(None)} and values.count(None) == cells.count(""):
            return np.array(values, np.float64), strange
    numbers = np.full(len(cells), math.nan)
    for row, cell in enumerate(map(str.strip, cells)):
        try:
            strange[row] = "_" in cell or not cell.isascii()  # which float() alone would take
            numbers[row] = math.nan if strange[row] else float(cell or "nan")
        except ValueError:
            strange[row] = True
    return numbers, strange
