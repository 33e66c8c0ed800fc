"""What is wrong with values: the first ten problems are told, and the number of the others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import InputError, counted, input_error
from shapefit.geometry.normalisation import LARGEST
from shapefit.io.layout import LANDMARKS, SHAPES, Layout

LIMIT = 10

Place = Callable[[str, int | None], str]
"""Names a dataset, or a row of it, in messages."""


def place_in_memory(record: str) -> Place:
    """Return what names the datasets of a record that is no file."""

    def place(name: str, row: int | None = None) -> str:
        return (name if name == record else f"{record}.{name}") + (
            "" if row is None else f"[{row}]"
        )

    return place


def input_problems(told: Sequence[str], count: int | None = None) -> InputError:
    """Build the InputError for these problems, of `count` in all; at most ten are listed."""
    shown = list(told[:LIMIT])
    more = (len(told) if count is None else count) - len(shown)
    return InputError([*shown, f"... and {more} more"] if more > 0 else shown)


def raise_at(rows: NDArray[Any] | Sequence[int], word: Callable[[int], str]) -> None:
    """Raise InputError with a line for each of these rows, if there are any."""
    if len(rows):
        raise input_problems([word(int(row)) for row in rows[:LIMIT]], len(rows))


AT_ZERO = 0.01
"""Share of landmarks at exactly (0, 0) from which on there is a warning."""


def warn_of_zeros(points: Floats) -> tuple[str, ...]:
    """Warn of many landmarks (..., 2) at exactly (0, 0), where detectors put what they miss."""
    there = (points == 0).all(axis=-1)
    if there.sum() <= AT_ZERO * there.size:
        return ()
    found = f"{int(there.sum())} of {counted(there.size, 'landmark')} are at exactly (0, 0)"
    return (f"{found}: if these were not found, leave them empty, or NaN",)


def check_points(
    points: Floats, bad: Flags, where: Callable[[int], str], names: Sequence[str], fix: str
) -> None:
    """Raise InputError for points (n, d, p) of which a coordinate is `bad`.

    `where` begins the line of a row; points without names are vertices.
    """
    wrong = np.argwhere(bad.any(axis=1))

    def told(entry: int) -> str:
        row, point = wrong[entry].tolist()
        name = f"landmark '{names[point]}'" if names else f"vertex {point}"
        values = ", ".join(map(str, points[row, :, point].tolist()))
        return f"{where(row)}{name} is ({values}); {fix}"

    raise_at(range(len(wrong)), told)


def check_magnitudes(
    place: str, points: Floats, items: Sequence[str], landmarks: Sequence[str]
) -> None:
    """Raise InputError for points (n, 3, p) whose squares would overflow; nan is no such point."""
    fix = f"correct it, or use a larger unit: the limit is {LARGEST:g}"
    where = lambda row: f"{place}: item '{items[row]}', "  # noqa: E731
    check_points(points, np.abs(points) > LARGEST, where, landmarks, fix)


def check_finite(
    place: Place, name: str, points: Floats, names: Sequence[str] = (), *,
    start: int = 0, gaps: bool = False,
) -> None:  # fmt: skip
    """Raise InputError where a coordinate of the points (n, d, p) is no number to compute with.

    That is NaN, infinite, or so large that its square is. With `gaps` NaN is an unknown landmark.
    The rows are those from `start` on; points without names are vertices.
    """
    fix = f"write a finite number, at most {LARGEST:g}, or leave the item out"
    if gaps:
        fix = f"write a number of at most {LARGEST:g}, or NaN where the landmark is unknown"
    bad = ~(np.abs(points) <= LARGEST) & ~(gaps & np.isnan(points))
    check_points(points, bad, lambda row: f"{place(name, start + row)}: ", names, fix)


def check_values(
    fields: Mapping[str, Any],
    form: Layout,
    place: Place,
    names: Sequence[str],
    *,
    start: int = 0,
    gaps: bool = False,
) -> None:
    """Raise InputError for values of items from `start` on that cannot be computed with.

    fields are those of records, names those of the landmarks; with `gaps` a landmark of a shape may
    be unknown. What results hold is checked where it is read.
    """
    if form is LANDMARKS:
        points, weights = fields["landmarks"], fields.get("confidence")
        where = lambda row: f"{place('landmarks', start + row)}: "  # noqa: E731
        fix = "write NaN where the landmark is unseen"
        check_points(points, np.isinf(points), where, names, fix)
        if weights is not None:
            unfit = ~(np.isfinite(weights) & (weights >= 0))
            where = lambda row: f"{place('confidence', start + row)}: "  # noqa: E731
            fix = "write 0 (hidden) or a positive number"
            check_points(weights[:, None], unfit[:, None], where, names, fix)
    if form is SHAPES:
        check_finite(place, "shapes", fields["shapes"], names, start=start, gaps=gaps)
        check_mesh(place, fields, len(names), start)


def check_mesh(place: Place, fields: Mapping[str, Any], p: int, start: int = 0) -> None:
    """Raise InputError for vertices that are no numbers, and for indices of what is not there."""
    vertices = fields.get("mesh_vertices")
    if vertices is not None:
        check_finite(place, "mesh_vertices", vertices, start=start)
    check_indices(place, "edges", fields.get("edges"), p)
    if vertices is not None:
        check_indices(place, "mesh_faces", fields.get("mesh_faces"), vertices.shape[-1])


def check_indices(place: Place, name: str, indices: Integers | None, size: int) -> None:
    """Raise InputError where an index of edges or faces (e, 2 or 3) is not below `size`."""
    if indices is None:
        return
    rows = np.flatnonzero(((indices < 0) | (indices >= size)).any(axis=1))
    if len(rows):
        found = f"holds the indices {tuple(indices[rows[0]].tolist())}"
        raise input_error(place(name, int(rows[0])), found, f"indices run from 0 to {size - 1}")
