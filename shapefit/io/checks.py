"""What is wrong with values: the first ten problems, and the number of the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import InputError, counted, input_error
from shapefit.geometry.normalisation import MAX_COORDINATE
from shapefit.records.items import Items
from shapefit.records.landmarks import Landmarks
from shapefit.records.shapes import Shapes

LIMIT = 10
"""Problems of an input that are listed."""

AT_ZERO = 0.01
"""Share of landmarks at exactly (0, 0) from which on there is a warning."""

CODE_BEYOND = 1.0
"""Sizes of all other points by which a single one must lie outside them to be a code.
"""
CENTRED = 0.1
"""Share of coordinates below 0 from which on 0 is no side of the image."""

PlaceNamer = Callable[..., str]
"""Names a dataset, or a row of it, in messages: place(name), place(name, row)."""


def check_values(record: Items, place: PlaceNamer, *, gaps: bool = False) -> None:
    """Raise InputError where points, weights, edges or a mesh of a record are invalid.

    With `gaps` a landmark of a shape may be unknown (NaN); in results it may always, as
    items can have failed.
    """
    names = record.landmark_names
    if isinstance(record, Landmarks):
        fix = "write NaN where the landmark is unseen"
        infinite = np.isinf(record.landmarks)
        _refuse_points(place, "landmarks", record.landmarks, infinite, names, fix)
        weights = record.confidence
        if weights is not None:
            weights = weights[..., None]
            bad = ~((weights >= 0) & (weights < np.inf))
            fix = "write 0 (hidden) or a positive number"
            _refuse_points(place, "confidence", weights, bad, names, fix)
        return
    whole = isinstance(record, Shapes) and not gaps
    check_finite(place, "shapes", record.points, names, gaps=not whole)
    if isinstance(record, Shapes):
        check_mesh(
            place, len(names), record.edges, record.mesh_vertices, record.mesh_faces
        )


def check_finite(
    place: PlaceNamer,
    name: str,
    points: Floats,
    names: Sequence[str] = (),
    *,
    gaps: bool = False,
) -> None:
    """Raise InputError where points (n, p, d) are infinite, too large, or NaN.

    Too large is beyond MAX_COORDINATE. With `gaps` NaN is allowed, as an unknown
    landmark; points without `names` of landmarks are vertices.
    """
    fix = f"write a finite number, at most {MAX_COORDINATE:g}, or leave the item out"
    bad = ~(np.abs(points) <= MAX_COORDINATE) & ~(gaps & np.isnan(points))
    _refuse_points(place, name, points, bad, names, fix)


def _refuse_points(
    place: PlaceNamer,
    name: str,
    points: Floats,
    bad: Flags,
    names: Sequence[str],
    fix: str,
) -> None:
    """Raise InputError that lists the points (n, p, d) with a `bad` coordinate."""
    if not bad.any():
        return
    wrong = np.argwhere(bad.any(axis=2))
    problems = []
    for row, point in wrong[:LIMIT].tolist():
        what = f"landmark '{names[point]}'" if names else f"vertex {point}"
        values = ", ".join(map(str, points[row, point].tolist()))
        problems.append(f"{place(name, row)}: {what} is ({values}); {fix}")
    raise input_problems(problems, len(wrong))


def check_mesh(
    place: PlaceNamer,
    landmark_count: int,
    edges: Integers | None,
    vertices: Floats | None,
    faces: Integers | None,
) -> None:
    """Raise InputError for edges or faces out of range, and vertices not finite.

    Edges (e, 2) index landmarks; faces (f, 3) index the vertices (n, q, 3).
    """
    q = 0
    if vertices is not None:
        check_finite(place, "mesh_vertices", vertices)
        q = vertices.shape[1]
    _check_indices(place, "edges", edges, landmark_count)
    _check_indices(place, "mesh_faces", faces, q)


def _check_indices(
    place: PlaceNamer, name: str, indices: Integers | None, size: int
) -> None:
    """Raise InputError where indices (m, i) are not from 0 to size - 1; None passes."""
    if indices is None:
        return
    wrong = np.argwhere((indices < 0) | (indices >= size))
    if len(wrong):
        row = int(wrong[0, 0])
        fault = f"holds the indices {tuple(indices[row].tolist())}"
        raise input_error(place(name, row), fault, f"indices run from 0 to {size - 1}")


def warn_of_zeros(points: Floats) -> tuple[str, ...]:
    """Return a warning where many landmarks (..., 2) are at exactly (0, 0), else ().

    Detectors put there what they miss: a corner of the image. Where others are on both
    sides of it, it is the origin of the coordinates.
    """
    zeros = (points == 0).all(axis=-1)
    others = points[~zeros & np.isfinite(points).all(axis=-1)]
    if len(others):
        negative = (others < 0).mean(axis=0)
        if (np.minimum(negative, 1 - negative) > CENTRED).any():
            return ()
    if zeros.sum() <= AT_ZERO * zeros.size:
        return ()
    fault = (
        f"{int(zeros.sum())} of {counted(zeros.size, 'landmark')} are at exactly (0, 0)"
    )
    return (f"{fault}: if these were not found, leave them empty, or NaN",)


def warn_of_codes(points: Floats, weights: Floats | None = None) -> tuple[str, ...]:
    """Return warnings where a code such as -999 may mark missing points (n, p, d).

    Such a code is all coordinates of a point, outside all others. Hidden points, of
    weight 0, do not count.
    """
    placed: Flags = np.asarray(np.isfinite(points).all(axis=2))
    if weights is not None:
        placed &= weights > 0
    found = points[placed]
    alike = found[(found == found[:, :1]).all(axis=1) & (found[:, 0] != 0)]
    values, counts = np.unique(alike[:, 0], return_counts=True)
    warnings = []
    for value, count in zip(values.tolist(), counts.tolist(), strict=True):
        others = found[~np.isin(found[:, 0], values) | (found != found[:, :1]).any(1)]
        if len(others) < count:
            continue
        least = others.min(axis=0)
        most = others.max(axis=0)
        beyond = np.maximum(least - value, value - most) / np.maximum(
            most - least, 1e-9
        )
        certain = CODE_BEYOND if count == 1 else 0.0
        if value.is_integer() and (beyond > certain).all():
            code = ", ".join([f"{value:g}"] * points.shape[2])
            fault = f"{counted(count, 'landmark')} at ({code}), far from all others"
            fix = f"if {value:g} stands for missing, leave them empty, or NaN"
            warnings.append(f"{fault}: {fix}")
    return tuple(warnings[:LIMIT])


def input_problems(problems: Sequence[str], total: int | None = None) -> InputError:
    """Return an InputError that lists the first ten problems, and counts the others.

    `total` is how many there are in all, by default `len(problems)`.
    """
    shown = list(problems[:LIMIT])
    more = (len(problems) if total is None else total) - len(shown)
    return InputError([*shown, f"... and {more} more"] if more > 0 else shown)


def place_in_memory(record: str) -> PlaceNamer:
    """Return a function that names fields of a record in messages: `record.name[3]`."""

    def place(name: str, row: int | None = None) -> str:
        """Return the name of a field of the record, or of a row of the field."""
        where = record if name == record else f"{record}.{name}"
        return where if row is None else f"{where}[{row}]"

    return place
