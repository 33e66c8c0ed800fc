"""The columns of the CSV that anipose writes: NAME_x, NAME_y, NAME_z, NAME_error and so on."""

from __future__ import annotations

from collections.abc import Sequence


def split_columns(line: str) -> list[str]:
    """Return the names of the columns in a header."""
    return [cell.strip().strip('"') for cell in line.split(",")]


def find_landmarks(columns: Sequence[str]) -> tuple[str, ...]:
    """Return the landmarks that have x, y, z and what anipose says of them, in order."""
    known = set(columns)
    names = [column[:-2] for column in columns if column.endswith("_x") and len(column) > 2]
    return tuple(
        name
        for name in dict.fromkeys(names)
        if {f"{name}_y", f"{name}_z"} <= known
        and known & {f"{name}_ncams", f"{name}_error", f"{name}_score"}
    )
