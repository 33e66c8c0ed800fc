"""A table of numbers and labels as CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a header and rows; None and nan become empty cells."""
    with path.open("w", newline="", encoding="utf-8") as file:
        # A writer that ends its lines in CR LF puts cells with a CR in quotes, others do not.
        table = csv.writer(SimpleNamespace(write=lambda line: file.write(f"{line[:-2]}\n")))
        table.writerow(columns)
        table.writerows([null_for_nan(value) for value in row] for row in rows)


def null_for_nan(value: Any) -> Any:
    """Return None in place of nan, as JSON and CSV have it."""
    return None if isinstance(value, float) and math.isnan(value) else value
