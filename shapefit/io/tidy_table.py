"""The tidy table, one row a landmark of an item: its columns, and how its rows become records."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from itertools import count
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import input_error
from shapefit.io.checks import input_problems
from shapefit.io.csv_file import Block, open_table
from shapefit.io.inputs import check_fits, is_stream, read_head, source_name
from shapefit.io.records import KINDS, LandmarkSet, concatenate

OPTIONAL = {
    "landmarks": ("confidence", "sequence"),
    "shapes": ("sequence", "sd_x", "sd_y", "sd_z", "modes", "trusted"),
}
"""Columns that may be there; of shapes and results all but `sequence` are not read back."""

FINITE_FIX = "write a finite number"
FIXES = {
    "landmarks": f"{FINITE_FIX}, or leave the cell empty where the landmark is unseen",
    "shapes": FINITE_FIX,
    "gaps": f"{FINITE_FIX}, or leave the cell empty where the landmark is unknown",
    "result": f"{FINITE_FIX}, or leave the cell empty where the item failed",
}

MISSED = -1.0
"""Both coordinates of a landmark without confidence that was not found."""

MAX_IN_MEMORY = 1 << 19
"""Rows of a table that are held; more go to a temporary file, item by item."""


def read_csv(path: Path, kind: str, *, gaps: bool = False) -> tuple[Any, tuple[str, ...]]:
    """Read `item,landmark,x,y[,confidence]` or `item,landmark,x,y,z`, each with `[,sequence]`.

    Return records, or a Spool of many landmarks, and warnings. Items and landmarks stand in order
    of appearance. A landmark that has no row or lacks a coordinate is NaN, its confidence 0; shapes
    need all unless `gaps`. Raises InputError for the first wrong cells, by line.
    """
    name, spool = source_name(path), None
    table, blocks = _begin(path, kind, gaps)
    for lines, cells in blocks:
        table.take(lines, cells)
        if kind == "landmarks" and table.size > MAX_IN_MEMORY:
            spool = spool or Spool()
            spool.append(table.pop_complete())
    rest = table.records()
    if spool is None:
        return rest, ()
    spool.append(rest)
    if not spool.repeats():
        return spool, ()
    spool.close()
    fault = "the rows of items do not stand together"
    if is_stream(path) or not path.is_file():
        raise input_error(name, fault, "sort them by item, or name the file itself")
    table, blocks = _begin(path, kind, gaps)
    for lines, cells in blocks:
        table.take(lines, cells)
    return table.records(), (f"{name}: {fault}, so that it was read whole: sort it by item",)


def read_csv_head(path: Path, kind: str) -> tuple[Any, float]:
    """Read the first rows of a table, and return them with their share of all rows."""
    table, blocks = _begin(path, kind, gaps=True)
    for lines, cells in blocks:
        table.take(lines, cells)
        if table.size > MAX_IN_MEMORY // 4 and path.is_file():
            text = read_head(path, 1 << 20)
            rows = path.stat().st_size * text.count(b"\n") / len(text)
            return table.records(), min(table.size / rows, 1.0)
    return table.records(), 1.0


def _begin(path: Path, kind: str, gaps: bool) -> tuple[_Table, Iterator[Block]]:
    """Return an empty table with the columns of a file, checked, and the blocks of its rows."""
    name, (columns, blocks) = source_name(path), open_table(path)
    _check_columns(columns, kind, f"{name}:1")
    return _Table(name, columns, kind, gaps), blocks


def _check_columns(columns: Sequence[str], kind: str, place: str) -> None:
    """Raise InputError for columns that are unknown, there twice, or missing."""
    required = ("item", "landmark", "x", "y", *(() if kind == "landmarks" else ("z",)))
    names = (*required, *OPTIONAL.get(kind, OPTIONAL["shapes"]))
    wanted = ",".join(required) + "".join(f"[,{column}]" for column in names[len(required) :])
    if not {*names} & {*columns}:
        fault = f"the header is '{','.join(columns)[:80]}'"
        raise input_error(place, fault, f"write the header {','.join(required)}, with commas")
    problems = []
    for column in dict.fromkeys((*columns, *required)):
        if column not in names:
            near = get_close_matches(column, names, n=1)
            fix = f"did you mean '{near[0]}'?" if near else f"the columns are {wanted}"
            problems.append(f"{place}: unknown column '{column}'; {fix}")
        elif columns.count(column) > 1:
            problems.append(f"{place}: the column '{column}' repeats; keep one of them")
        elif column not in columns and column in required:
            problems.append(f"{place}: there is no column '{column}'; the columns are {wanted}")
    if problems:
        raise input_problems(problems)


class _Table:
    """The rows of a table while its blocks come in: numbers of items and landmarks, and values."""

    def __init__(self, name: str, columns: Sequence[str], kind: str, gaps: bool) -> None:
        self._name, self._kind = name, kind
        self._axes = ("x", "y") if kind == "landmarks" else ("x", "y", "z")
        self._finite = kind == "shapes" and not gaps
        self._fix = FIXES["gaps" if gaps else kind]
        self._scored = kind == "landmarks" and "confidence" in columns
        self._sequences: dict[str, str] | None = {} if "sequence" in columns else None
        self._items = _numbering()
        self._landmarks = _numbering()
        self._parts: list[tuple[Any, ...]] = []
        self.size = 0
        self._problems: list[tuple[int, str]] = []

    def take(self, lines: Integers, cells: Mapping[str, Sequence[str]]) -> None:
        """Take some rows; raises InputError for wrong ones."""
        for column in ("item", "landmark"):
            if "" in cells[column]:
                empty = np.array([text == "" for text in cells[column]])
                self._note(column, cells, lines, empty, f"name the {column}")
        item = _numbers_of(cells["item"], self._items)
        landmark = _numbers_of(cells["landmark"], self._landmarks)
        if self._sequences is not None:
            fresh = dict(zip(reversed(cells["item"]), reversed(cells["sequence"]), strict=True))
            for name, sequence in fresh.items():
                self._sequences.setdefault(name, sequence)
            first = [*map(self._sequences.__getitem__, cells["item"])]
            if first != [*cells["sequence"]]:
                wrong = np.array(first, object) != np.array(cells["sequence"], object)
                fix = "give all rows of an item one sequence"
                self._note("sequence", cells, lines, wrong, fix)
        points = []
        for axis in self._axes:
            values, invalid = read_numbers(cells[axis])
            wrong = invalid | (~np.isfinite(values) if self._finite else np.isinf(values))
            self._note(axis, cells, lines, wrong, self._fix)
            points.append(values)
        missing = np.isnan(points).any(axis=0)
        confidence = np.zeros(len(lines))
        if self._scored:
            confidence, _ = read_numbers(cells["confidence"])
            wrong = ~(np.isfinite(confidence) & (confidence >= 0))
            fix = "write 0 (hidden) or a positive number"
            self._note("confidence", cells, lines, wrong, fix)
        if self._kind == "landmarks":  # as some detectors write what they miss
            missing |= (np.array(points) == MISSED).all(axis=0) & ~(confidence > 0)
        for values in points:
            values[missing] = np.nan
        self._raise_problems()
        self.size += len(lines)
        self._parts.append((lines.astype(np.int32), item, landmark, *points, confidence))

    def records(self) -> Any:
        """Return what was taken. Raises InputError for double rows, and for what shapes lack."""
        columns = [np.concatenate(part) for part in zip(*self._parts, strict=True)]
        self._parts = [tuple(columns)] if columns else []
        items, names = tuple(self._items), tuple(self._landmarks)
        n, p, d = len(items), len(names), len(self._axes)
        check_fits(self._name, n * p * 8 * (d + 2))
        planes = np.full((d, n * p), np.nan)
        confidence = np.zeros(n * p)
        if columns:
            lines, item, landmark, *values, scores = columns
            cells = item * np.int64(p) + landmark
            counts = np.bincount(cells, minlength=n * p)
            if (counts > 1).any():
                self._raise_for_repeated(lines, cells)
            if self._finite and not counts.all():
                self._raise_for_missing(np.flatnonzero(counts == 0))
            for plane, column in zip(planes, values, strict=True):
                plane[cells] = column
            confidence[cells] = scores
        points = np.ascontiguousarray(planes.reshape(d, n, p).swapaxes(0, 1))
        sequences = None if self._sequences is None else [self._sequences[name] for name in items]
        fields: dict[str, Any] = {"confidence": confidence.reshape(n, p)} if self._scored else {}
        return KINDS[self._kind](points, names, items, sequences, **fields)

    def pop_complete(self) -> LandmarkSet:
        """Take out all items but the last one, of which more rows may come."""
        images: LandmarkSet = self.records()
        last = len(images) - 1
        item, (lines, items, *values) = images.items[last], self._parts[0]
        rows = np.flatnonzero(items == last)
        remaining = (lines[rows], np.zeros_like(items[rows]), *(column[rows] for column in values))
        self._parts, self._items, self.size = [remaining], _numbering(item), len(rows)
        if self._sequences is not None:
            self._sequences = {item: self._sequences[item]}
        return images.take(slice(0, last))

    def _raise_for_repeated(self, lines: Integers, cells: Integers) -> None:
        """Raise InputError for the rows whose item and landmark are on an earlier line, too."""
        items, names = tuple(self._items), tuple(self._landmarks)
        _, first, inverse = np.unique(cells, return_index=True, return_inverse=True)
        for row in np.flatnonzero(first[inverse] != np.arange(len(cells))).tolist():
            i, j = divmod(int(cells[row]), len(names))
            again = f"is also on line {lines[first[inverse[row]]]}; keep one of them"
            self._tell(lines[row], f"item '{items[i]}', landmark '{names[j]}' {again}")
        self._raise_problems()

    def _raise_for_missing(self, cells: Integers) -> None:
        """Raise InputError for items and landmarks without a row."""
        items, names = tuple(self._items), tuple(self._landmarks)
        fix = "write every landmark of every item"
        pairs = [divmod(cell, len(names)) for cell in cells[:10].tolist()]
        faults = [f"item '{items[i]}' has no landmark '{names[j]}'; {fix}" for i, j in pairs]
        raise input_problems([f"{self._name}: {fault}" for fault in faults], len(cells))

    def _note(
        self,
        column: str,
        cells: Mapping[str, Sequence[str]],
        lines: Integers,
        wrong: Flags,
        fix: str,
    ) -> None:
        """Note the wrong cells of a column."""
        for row in np.flatnonzero(wrong).tolist() if wrong.any() else ():
            cell = cells[column][row]
            fault = f"is '{cell}'" if cell else "is empty"
            self._tell(lines[row], f"{column} {fault}; {fix}")

    def _tell(self, line: int, fault: str) -> None:
        self._problems.append((int(line), f"{self._name}:{line}: {fault}"))

    def _raise_problems(self) -> None:
        if self._problems:
            raise input_problems([text for _, text in sorted(self._problems, key=lambda p: p[0])])


def _numbering(*texts: str) -> defaultdict[str, int]:
    """Return a dictionary that gives the next number to each new text, beginning with these."""
    return defaultdict(count(len(texts)).__next__, zip(texts, count()))


def _numbers_of(texts: Sequence[str], numbers: defaultdict[str, int]) -> NDArray[np.int32]:
    """Return the number of the text in each row; a new text gets the next one."""
    return np.fromiter(map(numbers.__getitem__, texts), np.int32, len(texts))


class Spool:
    """Images of a large table in a temporary file without a name, in parts of some thousands.

    Those of a part are read together; the last part that was read is kept.
    """

    def __init__(self) -> None:
        self.landmark_names: tuple[str, ...] = ()
        self._file = TemporaryFile()  # noqa: SIM115 gone with the source
        self._starts, self._offsets = [0], list[int]()
        self._hashes: list[NDArray[np.int64]] = []
        self._last: tuple[int, LandmarkSet] | None = None

    def __len__(self) -> int:
        return self._starts[-1]

    def append(self, images: LandmarkSet) -> None:
        """Write images after those that are there."""
        self.landmark_names = images.landmark_names
        self._offsets.append(self._file.seek(0, 2))
        self._starts.append(len(self) + len(images))
        self._hashes.append(np.fromiter(map(hash, images.items), np.int64, len(images)))
        texts = orjson.dumps((images.items, images.sequences))
        absent = np.empty(0)
        scores = absent if images.confidence is None else images.confidence
        for values in (np.frombuffer(texts, np.uint8), images.landmarks, scores):
            np.save(self._file, values)

    def repeats(self) -> bool:
        """Whether an item is there twice, as its rows do not stand together."""
        hashes = np.sort(np.concatenate(self._hashes))
        return bool((hashes[1:] == hashes[:-1]).any())

    def take(self, rows: slice) -> LandmarkSet:
        """Return the images of these rows."""
        parts = []
        for number, start in enumerate(self._starts[:-1]):
            if start < rows.stop and rows.start < self._starts[number + 1]:
                inner = slice(max(rows.start - start, 0), rows.stop - start)
                parts.append(self._part(number).take(inner))
        return concatenate(parts) if parts else self._part(0).take(slice(0))

    def texts(self, name: str) -> Iterator[Sequence[str]]:
        """Read the items, or the sequences, part by part."""
        for number in range(len(self._offsets)):
            images = self._part(number)
            yield images.items if name == "item" else images.sequences or ()

    def close(self) -> None:
        """Close the file, with which it is gone."""
        self._file.close()

    def _part(self, number: int) -> LandmarkSet:
        """Read the images of a part; landmarks that came later are unseen in it."""
        if self._last is None or self._last[0] != number:
            self._file.seek(self._offsets[number])
            texts, points, confidence = (np.load(self._file) for _ in range(3))
            items, sequences = orjson.loads(texts.tobytes())
            names = self.landmark_names[: points.shape[2]]
            scores = confidence if confidence.size else None
            images = LandmarkSet(points, names, items, sequences, confidence=scores)
            self._last = number, images.arrange(self.landmark_names)
        return self._last[1]


def read_numbers(cells: Sequence[str]) -> tuple[Floats, Flags]:
    """Read decimal numbers, inf and nan; return them, and which cells are no number at all.

    Spaces around them do not count; an empty cell, and what is no number, is NaN.
    """
    invalid = np.zeros(len(cells), bool)
    filled = [cell or "null" for cell in cells] if "" in cells else cells
    try:
        values = orjson.loads(f"[{','.join(filled)}]")  # four times as fast as float()
    except orjson.JSONDecodeError:
        values = []
    if len(values) == len(cells):
        kinds = set(map(type, values))
        if kinds <= {float, int}:
            return np.fromiter(values, np.float64, len(values)), invalid
        if kinds <= {float, int, type(None)} and values.count(None) == cells.count(""):
            return np.array(values, np.float64), invalid
    numbers = np.full(len(cells), np.nan)
    for row, cell in enumerate(map(str.strip, cells)):
        try:
            invalid[row] = "_" in cell or not cell.isascii()  # which float() alone would take
            numbers[row] = np.nan if invalid[row] else float(cell or "nan")
        except ValueError:
            invalid[row] = True
    return numbers, invalid
