"""What is wrong with values: the first ten problems, and the number of the others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.errors import InputError, counted, input_error
from shapefit.geometry.normalisation import LARGEST
from shapefit.io.layout import LANDMARKS, SHAPES, Layout

LIMIT = 10

Place = Callable[..., str]
"""Names a dataset, or a row of it, in messages: place(name), place(name, row)."""


def place_in_memory(record: str) -> Place:
    """Return what names the datasets of a record that is no file."""

    def place(name: str, row: int | None = None) -> str:
        where = name if name == record else f"{record}.{name}"
        return where if row is None else f"{where}[{row}]"

    return place


def input_problems(problems: Sequence[str], count: int | None = None) -> InputError:
    """Build the InputError for these problems, of `count` in all; at most ten are listed."""
    shown = list(problems[:LIMIT])
    more = (len(problems) if count is None else count) - len(shown)
    return InputError([*shown, f"... and {more} more"] if more > 0 else shown)


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
    problems = []
    for row, point in wrong[:LIMIT].tolist():
        name = f"landmark '{names[point]}'" if names else f"vertex {point}"
        values = ", ".join(map(str, points[row, :, point].tolist()))
        problems.append(f"{where(row)}{name} is ({values}); {fix}")
    if problems:
        raise input_problems(problems, len(wrong))


def check_magnitudes(
    place: str, points: Floats, items: Sequence[str], landmarks: Sequence[str]
) -> None:
    """Raise InputError for points (n, 3, p) whose squares would overflow; nan is no such point."""

    def where(row: int) -> str:
        return f"{place}: item '{items[row]}', "

    fix = f"correct it, or use a larger unit: the limit is {LARGEST:g}"
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

    fields are columns of records, names those of the landmarks; with `gaps` a landmark of a shape
    may be unknown. Results may hold NaN in items that failed.
    """
    if form is LANDMARKS:
        points, weights = fields["landmarks"], fields.get("confidence")
        checks = [("landmarks", points, np.isinf(points), "write NaN where the landmark is unseen")]
        if weights is not None:
            unfit, fix = ~((weights >= 0) & (weights < np.inf)), "write 0 (hidden) or a positive"
            checks.append(("confidence", weights[:, None], unfit[:, None], f"{fix} number"))
        for name, values, bad, fix in checks:
            where = lambda row, name=name: f"{place(name, start + row)}: "  # noqa: E731
            check_points(values, bad, where, names, fix)
    if form is SHAPES:
        check_finite(place, "shapes", fields["shapes"], names, start=start, gaps=gaps)
        check_mesh(place, fields, len(names), start)


def check_mesh(place: Place, fields: Mapping[str, Any], p: int, start: int = 0) -> None:
    """Raise InputError for vertices that are no numbers, and for indices of what is not there."""
    vertices = fields.get("mesh_vertices")
    sizes = {"edges": p}
    if vertices is not None:
        check_finite(place, "mesh_vertices", vertices, start=start)
        sizes["mesh_faces"] = vertices.shape[-1]
    for name, size in sizes.items():
        indices = fields.get(name)
        if indices is not None and len(wrong := np.argwhere((indices < 0) | (indices >= size))):
            row = int(wrong[0, 0])
            found = f"holds the indices {tuple(indices[row].tolist())}"
            raise input_error(place(name, row), found, f"indices run from 0 to {size - 1}")
