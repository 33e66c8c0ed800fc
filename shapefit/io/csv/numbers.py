"""Cells of a CSV column as numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import orjson
from numpy.typing import NDArray

_NUMBERS = {float, int}


@dataclass(frozen=True)
class Numbers:
    """A column as numbers: NaN in cells that are empty or `strange` (no number at all)."""

    values: NDArray[np.float64]
    strange: NDArray[np.bool_]


def read_numbers(cells: Sequence[str]) -> Numbers:
    """Read decimal numbers, inf and nan; spaces around them do not count."""
    none_strange = np.zeros(len(cells), bool)
    filled = [cell or "null" for cell in cells] if "" in cells else cells
    try:
        values = orjson.loads(f"[{','.join(filled)}]")  # four times as fast as float()
    except orjson.JSONDecodeError:
        values = []
    if len(values) == len(cells):
        kinds = set(map(type, values))
        if kinds <= _NUMBERS:
            return Numbers(np.fromiter(values, np.float64, len(values)), none_strange)
        if kinds <= {*_NUMBERS, type(None)} and values.count(None) == cells.count(""):
            return Numbers(np.array(values, np.float64), none_strange)
    return _read_one_by_one(cells)


def _read_one_by_one(cells: Sequence[str]) -> Numbers:
    values = np.full(len(cells), math.nan)
    strange = np.zeros(len(cells), bool)
    for row, cell in enumerate(cells):
        try:
            values[row] = _number(cell.strip())
        except ValueError:
            strange[row] = True
    return Numbers(values, strange)


def _number(cell: str) -> float:
    """Return what a cell says; float() alone would take 1_000 and the digits of all scripts."""
    if not cell:
        return math.nan
    if "_" in cell or not cell.isascii():
        raise ValueError
    return float(cell)
