"""The tidy table, one row a landmark of an item: its columns, and how its rows become records.

`csv_file` knows text alone.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from itertools import count
from tempfile import TemporaryFile
from typing import Any, NamedTuple

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import input_error
from shapefit.io.checks import input_problems
from shapefit.io.inputs import check_fits
from shapefit.io.records import KINDS, LandmarkSet, concatenate

IGNORED = ("sd_x", "sd_y", "sd_z", "modes", "trusted")
"""Columns of results that may be there, and that nothing here reads back."""

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

MAX_IN_MEMORY = 1 << 19
"""Landmarks of a table that are held; more go to a temporary file, item by item."""

SCATTERED = "the rows of items do not stand together, so that it was read whole: sort it by item"

Cells = Mapping[str, Sequence[str]]
Block = tuple[Integers, Cells]
"""The lines of some rows, and their cells by column."""


class Rows(NamedTuple):
    """An open table: its name and columns, and its rows, which `blocks` reads anew."""

    name: str
    columns: Sequence[str]
    blocks: Callable[[], Iterator[Block]]
    once: bool


def table_columns(kind: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the columns that a table of a kind needs, and those that it may have."""
    if kind == "landmarks":
        return ("item", "landmark", "x", "y"), ("confidence", "sequence")
    return ("item", "landmark", "x", "y", "z"), ("sequence", *IGNORED)


def check_columns(columns: Sequence[str], kind: str, place: str) -> None:
    """Raise InputError for columns that are unknown, there twice, or missing."""
    required, optional = table_columns(kind)
    wanted = ",".join(required) + "".join(f"[,{column}]" for column in optional)
    names = {*required, *optional, *IDENTITIES}
    problems = []
    for column in columns:
        if column not in names:
            near = get_close_matches(column, names, n=1)
            fix = f"did you mean '{near[0]}'?" if near else f"the columns are {wanted}"
            problems.append(f"{place}: unknown column '{column}'; {fix}")
        elif columns.count(column) > 1:
            problems.append(f"{place}: the column '{column}' repeats; keep one of them")
    for column in required:
        if column not in columns:
            problems.append(f"{place}: there is no column '{column}'; the columns are {wanted}")
    if problems:
        raise input_problems(problems)


class Spool:
    """Images of a large table in a temporary file without a name, in parts of some thousands.

    Those of a part are read together; the last part that was read is kept.
    """

    def __init__(self) -> None:
        self.landmark_names: tuple[str, ...] = ()
        self.starts = [0]
        self._file = TemporaryFile()  # noqa: SIM115 gone with the source
        self._offsets: list[int] = []
        self._last: tuple[int, LandmarkSet] | None = None

    def __len__(self) -> int:
        return self.starts[-1]

    def append(self, images: LandmarkSet) -> None:
        """Write images after those that are there."""
        self._offsets.append(self._file.seek(0, 2))
        self.starts.append(len(self) + len(images))
        texts = "\0".join((*images.items, *(images.sequences or ()))).encode()
        np.save(self._file, np.frombuffer(texts, np.uint8))
        for values in (images.landmarks, images.confidence):
            np.save(self._file, np.empty(0) if values is None else values)

    def part(self, number: int) -> LandmarkSet:
        """Read the images of a part; landmarks that came later are unseen in it."""
        if self._last is None or self._last[0] != number:
            self._file.seek(self._offsets[number])
            texts, points, confidence = (np.load(self._file) for _ in range(3))
            n, _, p = points.shape
            items = tuple(texts.tobytes().decode().split("\0"))
            images = LandmarkSet(
                points,
                self.landmark_names[:p],
                items[:n],
                items[n:] or None,
                confidence=confidence if confidence.size else None,
            )
            self._last = number, images.arrange(self.landmark_names)
        return self._last[1]

    def take(self, rows: slice) -> LandmarkSet:
        """Return the images of these rows."""
        parts = []
        for number, (start, stop) in enumerate(zip(self.starts, self.starts[1:], strict=False)):
            if start < rows.stop and rows.start < stop:
                own = slice(max(rows.start - start, 0), rows.stop - start)
                parts.append(self.part(number).take(own))
        return concatenate(parts) if parts else self.part(0).take(slice(0))

    def texts(self, name: str) -> Iterator[Sequence[str]]:
        """Read the items, or the sequences, part by part."""
        for number in range(len(self._offsets)):
            images = self.part(number)
            yield images.items if name == "item" else images.sequences or ()

    def close(self) -> None:
        """Close the file, with which it is gone."""
        self._file.close()


def read_tidy(
    rows: Rows, kind: str, *, gaps: bool = False, first: int | None = None
) -> tuple[Any, tuple[str, ...], int | None]:
    """Return the records of a table, or a Spool of many landmarks; warnings; and the last line.

    That is None unless only some `first` landmarks are read, and there are more.

    Items and landmarks stand in order of appearance. A landmark that has no row or lacks a
    coordinate is NaN, its confidence 0; shapes need all unless `gaps`. Raises InputError for the
    first wrong cells, by line.
    """
    table = _Table(rows, kind, gaps)
    spool = Spool() if kind == "landmarks" else None
    hashes: list[NDArray[np.int64]] = []

    def flush(last: int) -> None:
        images = table.pop(last)
        hashes.append(np.fromiter(map(hash, images.items), np.int64, len(images)))
        assert spool is not None
        spool.append(images)

    for lines, cells in rows.blocks():
        table.take(lines, cells)
        if first is not None and table.size > min(first, MAX_IN_MEMORY) and not rows.once:
            return table.pop(-1), (), int(lines[-1])
        if spool is not None and table.size > MAX_IN_MEMORY:
            flush(-1)
    if not hashes or spool is None:
        return table.records(), (), None
    flush(0)
    order = np.sort(np.concatenate(hashes))
    if (order[1:] != order[:-1]).all():
        spool.landmark_names = table.names("landmark")
        return spool, (), None
    spool.close()
    if rows.once:
        found = "rows of an item do not stand together"
        raise input_error(rows.name, found, "sort them by item, or name the file itself")
    table = _Table(rows, kind, gaps)
    for lines, cells in rows.blocks():
        table.take(lines, cells)
    return table.records(), (f"{rows.name}: {SCATTERED}",), None


class _Table:
    """The arrays of a table while its blocks come in."""

    def __init__(self, rows: Rows, kind: str, gaps: bool) -> None:
        self._rows, self._kind = rows, kind
        self._axes = ("x", "y") if kind == "landmarks" else ("x", "y", "z")
        self._finite = kind == "shapes" and not gaps
        self._fix = FIXES["gaps" if gaps else kind]
        self._has = {name: name in rows.columns for name in ("confidence", "sequence")}
        self._has["sequence"] |= bool({*IDENTITIES} & {*rows.columns})
        texts = ("item", "landmark", "sequence")
        self._numbers = {name: defaultdict[str, int](count().__next__) for name in texts}
        d = len(self._axes)
        self._grids: dict[str, tuple[NDArray[Any], float]] = {
            "lines": (np.zeros((0, 0), np.uint32), 0),  # of each item and landmark; 0 is none
            "points": (np.empty((0, d, 0)), np.nan),
            "confidence": (np.empty((0, 0)), 0.0),
            "sequence": (np.empty(0, np.int64), -1),
        }
        self._problems: list[tuple[int, str]] = []

    @property
    def size(self) -> int:
        """Number of landmarks of all items."""
        return len(self._numbers["item"]) * len(self._numbers["landmark"])

    def names(self, column: str) -> tuple[str, ...]:
        """Return the texts of a column in order of appearance."""
        return tuple(self._numbers[column])

    def take(self, lines: Integers, cells: Cells) -> None:
        """Take some rows; raises InputError for wrong ones."""
        cells = _with_identities(cells)
        before = len(self._numbers["item"])
        item, landmark = (self._number(name, cells, lines) for name in ("item", "landmark"))
        n, p = len(self._numbers["item"]), len(self._numbers["landmark"])
        place = item * p + landmark
        first_lines = self._grid("lines", n, p).reshape(-1)
        fresh = np.flatnonzero(first_lines[place] == 0)[::-1]  # of equal ones the first wins
        first_lines[place[fresh]] = lines[fresh]
        first = first_lines[place]
        for row in np.flatnonzero(first != lines).tolist():
            names = f"item '{cells['item'][row]}', landmark '{cells['landmark'][row]}'"
            self._tell(lines[row], f"{names} is also on line {first[row]}; keep one of them")
        if self._has["sequence"]:
            codes = self._number("sequence", cells, lines)
            sequence = self._grid("sequence", n)
            new = np.flatnonzero(item >= before)[::-1]
            sequence[item[new]] = codes[new]
            wrong = codes != sequence[item]
            self._note("sequence", cells, lines, wrong, "give all rows of an item one sequence")
        columns = []
        for axis in self._axes:
            values, invalid = read_numbers(cells[axis])
            wrong = invalid | (~np.isfinite(values) if self._finite else np.isinf(values))
            self._note(axis, cells, lines, wrong, self._fix)
            columns.append(values)
        missing = np.isnan(columns).any(axis=0)
        confidence: Any = np.zeros(len(lines))
        if self._has["confidence"]:
            confidence, _ = read_numbers(cells["confidence"])
            wrong = ~(np.isfinite(confidence) & (confidence >= 0))
            fix = "write 0 (hidden) or a positive number"
            self._note("confidence", cells, lines, wrong, fix)
            self._grid("confidence", n, p).reshape(-1)[place] = confidence
        if self._kind == "landmarks":  # as some detectors write what they miss
            missing |= (np.asarray(columns) == MISSED).all(axis=0) & ~(confidence > 0)
        d = len(columns)
        points = self._grid("points", n, d, p).reshape(-1)
        for number, values in enumerate(columns):
            points[(item * d + number) * p + landmark] = np.where(missing, np.nan, values)
        if self._problems:
            raise input_problems([text for _, text in sorted(self._problems, key=lambda p: p[0])])

    def records(self) -> Any:
        """Return what was taken. Raises InputError for landmarks that shapes lack."""
        items, names = self.names("item"), self.names("landmark")
        n, p = len(items), len(names)
        if self._finite:
            missing = np.argwhere(self._grid("lines", n, p)[:n] == 0)
            problems = [
                f"{self._rows.name}: item '{items[row]}' has no landmark '{names[column]}'; "
                "write every landmark of every item"
                for row, column in missing[:10].tolist()
            ]
            if problems:
                raise input_problems(problems, len(missing))
        return self._of_items(items, n)

    def pop(self, last: int) -> LandmarkSet:
        """Take out the items that are there, but for the last one where `last` is -1."""
        items = self.names("item")
        n = len(items) + last
        images: LandmarkSet = self._of_items(items[:n], n)
        retained = {"item": items[n:], "sequence": self.names("sequence")}
        for name, (values, fill) in self._grids.items():
            self._grids[name] = values[n : len(items)].copy(), fill
        sequence = self._grids["sequence"][0]
        retained["sequence"] = tuple(retained["sequence"][code] for code in sequence.tolist())
        sequence[:] = 0  # of one item at most
        for name, texts in retained.items():
            self._numbers[name] = defaultdict(count(len(texts)).__next__, zip(texts, count()))
        return images

    def _of_items(self, items: tuple[str, ...], n: int) -> Any:
        p, d = len(self._numbers["landmark"]), len(self._axes)
        fields: dict[str, Any] = {"landmark_names": self.names("landmark"), "items": items}
        if self._has["sequence"]:
            texts = self.names("sequence")
            codes = self._grid("sequence", n)[:n].tolist()
            fields["sequences"] = tuple(texts[code] for code in codes)
        if self._has["confidence"]:
            fields["confidence"] = self._cut("confidence", n, p)
        return KINDS[self._kind](self._cut("points", n, d, p), **fields)

    def _grid(self, name: str, *shape: int) -> NDArray[Any]:
        """Return an array of at least these axes, the first with room to grow."""
        values, fill = self._grids[name]
        length, *others = values.shape
        if others != list(shape[1:]):
            check_fits(self._rows.name, math.prod(shape) * values.itemsize)
            wider = np.full((length, *shape[1:]), fill, values.dtype)
            wider[tuple(map(slice, values.shape))] = values
            values = wider
        if shape[0] > length:  # where the array lies, so that it is never held twice
            values.resize((shape[0] * 5 // 4, *shape[1:]), refcheck=False)
            values[length:] = fill
        self._grids[name] = values, fill
        return values

    def _cut(self, name: str, *shape: int) -> NDArray[Any]:
        """Return an array of these axes, without the room to grow where all of it is taken."""
        values = self._grid(name, *shape)
        if shape[0] == len(self._numbers["item"]):
            values.resize(shape, refcheck=False)
        return values[: shape[0]]

    def _number(self, column: str, cells: Cells, lines: Integers) -> Integers:
        """Return the number of the text in each row; a new text gets the next one."""
        texts = cells[column]
        if column != "sequence" and "" in texts:
            unnamed = np.array([text == "" for text in texts])
            self._note(column, cells, lines, unnamed, f"name the {column}")
        number, period = self._numbers[column].__getitem__, len(self._numbers[column])
        if 0 < period < len(texts) and texts[period:] == texts[:-period]:  # as most tables repeat
            return np.resize(np.fromiter(map(number, texts[:period]), np.int64), len(texts))
        return np.fromiter(map(number, texts), np.int64, len(texts))

    def _note(self, column: str, cells: Cells, lines: Integers, wrong: Flags, fix: str) -> None:
        """Note the wrong cells of a column."""
        for row in np.flatnonzero(wrong).tolist() if wrong.any() else ():
            cell = cells[column][row]
            found = f"'{cell}'" if cell else "empty"
            self._tell(lines[row], f"{column} is {found}; {fix}")

    def _tell(self, line: int, found: str) -> None:
        self._problems.append((int(line), f"{self._rows.name}:{line}: {found}"))


def _with_identities(cells: Cells) -> Cells:
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
    numbers = np.full(len(cells), math.nan)
    for row, cell in enumerate(map(str.strip, cells)):
        try:
            invalid[row] = "_" in cell or not cell.isascii()  # which float() alone would take
            numbers[row] = math.nan if invalid[row] else float(cell or "nan")
        except ValueError:
            invalid[row] = True
    return numbers, invalid
