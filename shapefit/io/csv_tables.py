"""Tidy CSV tables: one row a landmark of an item, to and from arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from shapefit.io.csv_text import CsvText
from shapefit.io.problems import Problems
from shapefit.io.records import Floats, LandmarkSet, ResultSet, ShapeSet

FINITE_FIX = "write a finite number"
UNSEEN_FIX = f"{FINITE_FIX}, or leave the cell empty where the landmark is unseen"
FAILED_FIX = f"{FINITE_FIX}, or leave the cell empty where the item failed"


def read_shape_table(path: Path) -> ShapeSet:
    """Read `item,landmark,x,y,z[,sequence]`, every landmark of every item."""
    table = _Tidy(path, ("x", "y", "z"), ("sequence",))
    table.check_numbers(("x", "y", "z"), FINITE_FIX, empty_allowed=False)
    table.raise_if_wrong()
    table.check_complete()
    return ShapeSet(table.points(("x", "y", "z")), table.landmarks, table.items, table.sequences)


def read_landmark_table(path: Path) -> LandmarkSet:
    """Read `item,landmark,x,y[,confidence][,sequence]`; an empty or nan coordinate is unseen."""
    table = _Tidy(path, ("x", "y"), ("confidence", "sequence"))
    table.check_numbers(("x", "y"), UNSEEN_FIX, empty_allowed=True)
    table.check_confidence()
    table.raise_if_wrong()
    return LandmarkSet(
        landmarks=table.points(("x", "y")),
        confidence=table.confidence(),
        landmark_names=table.landmarks,
        items=table.items,
        sequences=table.sequences,
    )


def read_result_table(path: Path) -> ResultSet:
    """Read `item,landmark,x,y,z[,sequence]`; empty cells stand for items that failed."""
    table = _Tidy(path, ("x", "y", "z"), ("sequence",))
    table.check_numbers(("x", "y", "z"), FAILED_FIX, empty_allowed=True)
    table.raise_if_wrong()
    return ResultSet(
        shapes=table.points(("x", "y", "z")),
        landmark_names=table.landmarks,
        items=table.items,
        sequences=table.sequences,
    )


@dataclass(frozen=True)
class _Numbers:
    """A column as numbers: NaN in cells that are empty or `strange` (no number at all)."""

    values: Floats
    strange: NDArray[np.bool_]


class _Tidy:
    """The rows of a tidy table as indices of items and landmarks, in order of appearance.

    Checks gather their problems; `raise_if_wrong` tells them together, by line.
    """

    def __init__(self, path: Path, coordinates: Sequence[str], optional: Sequence[str]) -> None:
        self._text = CsvText(path, ("item", "landmark", *coordinates), optional)
        self._problems = Problems()
        self._parsed: dict[str, _Numbers] = {}
        self.items, self._item = self._named("item")
        self.landmarks, self._landmark = self._named("landmark")
        self._entry = self._item * len(self.landmarks) + self._landmark
        self._filled = np.zeros(len(self.items) * len(self.landmarks), bool)
        self._filled[self._entry] = True
        self._check_repeated()
        self.sequences = self._read_sequences()

    def raise_if_wrong(self) -> None:
        """Raise InputError with all problems found so far."""
        self._problems.raise_if_any()

    def check_numbers(self, columns: Sequence[str], fix: str, *, empty_allowed: bool) -> None:
        """Note cells that are not numbers or infinite and, unless allowed, empty or nan."""
        for column in columns:
            numbers = self._numbers(column)
            unfit = np.isinf if empty_allowed else _not_finite
            self._note(column, numbers.strange | unfit(numbers.values), fix)

    def check_confidence(self) -> None:
        """Note confidences that are negative, empty, infinite or not numbers."""
        if "confidence" in self._text.columns:
            values = self._numbers("confidence").values
            wrong = _not_finite(values) | (values < 0)
            self._note("confidence", wrong, "write 0 (hidden) or a positive number")

    def check_complete(self) -> None:
        """Raise InputError where an item lacks a landmark."""
        missing = np.flatnonzero(~self._filled)
        problems = Problems()
        problems.add(missing, self._word_missing)
        problems.raise_if_any()

    def points(self, columns: Sequence[str]) -> Floats:
        """Return the coordinates (n, d, p), all NaN for a landmark that lacks one of them."""
        rows = np.stack([self._numbers(column).values for column in columns], axis=-1)
        rows[np.isnan(rows).any(axis=-1)] = np.nan
        points = np.full((len(self.items), len(columns), len(self.landmarks)), np.nan)
        points[self._item, :, self._landmark] = rows
        return points

    def confidence(self) -> Floats | None:
        """Return the confidence (n, p), 0 for rows that are not there; None without the column."""
        if "confidence" not in self._text.columns:
            return None
        confidence = np.zeros((len(self.items), len(self.landmarks)))
        confidence[self._item, self._landmark] = self._numbers("confidence").values
        return confidence

    def _cells(self, column: str) -> pl.Series:
        return self._text.cells[column].fill_null("")

    def _numbers(self, column: str) -> _Numbers:
        if column not in self._parsed:
            cells = self._cells(column).str.strip_chars()
            values = cells.cast(pl.Float64, strict=False)
            self._parsed[column] = _Numbers(
                values.fill_null(np.nan).to_numpy(writable=True),
                (values.is_null() & (cells != "")).to_numpy(),
            )
        return self._parsed[column]

    def _codes(self, column: str) -> tuple[tuple[str, ...], NDArray[np.int64]]:
        """Return the distinct texts of a column in order of appearance, and each row's index."""
        cells = self._cells(column)
        distinct = cells.unique(maintain_order=True)
        codes = cells.cast(pl.Enum(distinct)).to_physical().cast(pl.Int64).to_numpy()
        return tuple(distinct.to_list()), codes

    def _named(self, column: str) -> tuple[tuple[str, ...], NDArray[np.int64]]:
        names, codes = self._codes(column)
        if "" in names:
            self._note(column, codes == names.index(""), f"name the {column}")
        return names, codes

    def _read_sequences(self) -> tuple[str, ...] | None:
        if "sequence" not in self._text.columns:
            return None
        names, codes = self._codes("sequence")
        first_row = np.unique(self._item, return_index=True)[1]
        of_item = codes[first_row]
        self._note(
            "sequence", codes != of_item[self._item], "give all rows of an item one sequence"
        )
        return tuple(names[code] for code in of_item)

    def _check_repeated(self) -> None:
        if np.count_nonzero(self._filled) == len(self._entry):
            return
        _, first, inverse = np.unique(self._entry, return_index=True, return_inverse=True)
        first_row = first[inverse]
        rows = np.flatnonzero(first_row != np.arange(len(first_row)))
        self._problems.add(rows, lambda row: self._word_repeated(row, int(first_row[row])))

    def _note(self, column: str, wrong: NDArray[np.bool_], fix: str) -> None:
        self._problems.add(np.flatnonzero(wrong), lambda row: self._word(column, row, fix))

    def _word(self, column: str, row: int, fix: str) -> str:
        cell = self._cells(column)[row]
        found = f"{column} is '{cell}'" if cell else f"{column} is empty"
        return f"{self._text.place(row)}: {found}; {fix}"

    def _word_repeated(self, row: int, first: int) -> str:
        item, landmark = self.items[self._item[row]], self.landmarks[self._landmark[row]]
        found = f"item '{item}', landmark '{landmark}' stands also on line {self._text.line(first)}"
        return f"{self._text.place(row)}: {found}; keep one of them"

    def _word_missing(self, entry: int) -> str:
        item, landmark = divmod(entry, len(self.landmarks))
        found = f"item '{self.items[item]}' has no landmark '{self.landmarks[landmark]}'"
        return f"{self._text.name}: {found}; write every landmark of every item"


def _not_finite(values: Floats) -> NDArray[np.bool_]:
    return ~np.isfinite(values)
