"""Whether several files go together, and what their items have in common."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io.checks import check_magnitudes
from shapefit.io.layout import EDGES, UNKNOWN_UNIT
from shapefit.io.options import Direction
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet

Array = NDArray[Any]
APART = "use files that agree, or process them separately"
MESH = frozenset({"mesh_vertices", "mesh_faces"})
ALL_OR_NONE = "give it to all files (CSV cannot hold it) or to none, or process them separately"


def common_head(
    heads: Sequence[tuple[str, Any]],
    y_axes: Sequence[tuple[str, Direction | None]],
    y_axis: Direction | None,
) -> Any:
    """Return what all items of files have in common, each head and direction with the file's name.

    The landmarks of images are those of all files in order of appearance, those of shapes and of
    results are the same in all; where no file states the direction of y, it is `y_axis`, and down
    without. Raises InputError where files do not go together, or state another direction.
    """
    (_, first), *_ = heads
    names = first.landmark_names
    if isinstance(first, ResultSet):
        for place, head in heads:
            if head.landmark_names != names:
                found = f"its landmarks are not those of {heads[0][0]}, in their order"
                raise input_error(place, found, APART)
    else:
        if isinstance(first, LandmarkSet):
            names = tuple(dict.fromkeys(name for _, head in heads for name in head.landmark_names))
        heads = [(place, head.arrange(names, place)) for place, head in heads]
    if isinstance(first, LandmarkSet):
        edges = _first(head.columns.get(EDGES) for _, head in heads)
        heads = [(place, _with_edges(head, edges)) for place, head in heads]
    heads = _with_own_columns(heads)
    _check_same_columns(heads)
    units = [(place, None if head.unit == UNKNOWN_UNIT else head.unit) for place, head in heads]
    rates = [(place, head.frame_rate) for place, head in heads]
    changes = {
        "unit": agreed("unit", units) or UNKNOWN_UNIT,
        "frame_rate": agreed("frame_rate", rates),
    }
    if not isinstance(first, ShapeSet):
        changes["y_axis"] = found = agreed("y_axis", y_axes) or y_axis or "down"
        if y_axis not in (None, found):
            place = next(place for place, stated in y_axes if stated == found)
            fix = "leave the key out; if the file is wrong, correct its attribute y_axis"
            raise input_error(place, f"states that y points {found}, and `y_axis` is {y_axis}", fix)
    for name in ("sequences", "confidence", "edges"):
        if (value := _first(getattr(head, name, None) for _, head in heads)) is not None:
            changes[name] = value
    return heads[0][1].replaced(**changes)


def conform(part: Any, head: Any, place: str) -> Any:
    """Return a part of one file with the landmarks and fields of the whole source."""
    part = _of_items(part, part.whole.keys() & head.per_item.keys())
    changes: dict[str, Any] = {"unit": head.unit, "frame_rate": head.frame_rate}
    if head.sequences is not None and part.sequences is None:
        changes["sequences"] = ("",) * len(part)
    if isinstance(part, ResultSet):
        check_magnitudes(place, part.shapes, part.items, part.landmark_names)
        return part.replaced(**changes, y_axis=head.y_axis, attributes=head.attributes)
    if isinstance(part, ShapeSet):
        return part.arrange(head.landmark_names, place).replaced(**changes, edges=head.edges)
    if head.confidence is not None and part.confidence is None:
        changes["confidence"] = np.ones((len(part), len(part.landmark_names)))
    part = part.replaced(**changes, y_axis=head.y_axis).arrange(head.landmark_names, place)
    return _with_edges(part, head.columns.get(EDGES))


def _with_own_columns(heads: Sequence[tuple[str, Any]]) -> Sequence[tuple[str, Any]]:
    """Return heads of images in which what differs between files, as of cameras, is of items."""
    (_, first), *others = heads
    own = [
        name
        for name in first.whole.keys() - {EDGES, "mirror_index"}
        if isinstance(first, LandmarkSet)
        and all(name in head.whole for _, head in others)
        and len({head.columns[name].shape for _, head in heads}) == 1
        and not all(_agree(first, head, name) for _, head in others)
    ]
    return [(place, _of_items(head, own)) for place, head in heads] if own else heads


def _of_items(records: Any, names: Collection[str]) -> Any:
    """Return records in which these columns of the file are columns of each item."""
    if not names:
        return records
    known = {name: records.whole[name] for name in names}
    spread = {name: np.broadcast_to(v, (len(records), *v.shape)) for name, v in known.items()}
    return records.with_columns(spread)


def _first(values: Iterable[Any]) -> Any:
    """Return the first that is not None; None without any."""
    return next((value for value in values if value is not None), None)


def _with_edges(images: LandmarkSet, edges: Array | None) -> LandmarkSet:
    """Return images whose edges are those of the first file that has any."""
    if edges is None:
        return images
    return images.with_columns(whole={EDGES: edges})


def agreed(what: str, stated: Sequence[tuple[str, Any]]) -> Any:
    """Return what all files state, None if none does; each comes with its name.

    Raises InputError where two files differ.
    """
    known = [(place, value) for place, value in stated if value is not None]
    for place, value in known[1:]:
        first_place, first = known[0]
        if value != first:
            found = f"its {what} is '{_text(value)}', that of {first_place} is '{_text(first)}'"
            raise input_error(place, found, APART)
    return known[0][1] if known else None


def _text(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.17g}"


def _check_same_columns(heads: Sequence[tuple[str, Any]]) -> None:
    """Raise InputError unless all files have the same columns, of results all, of others `_own`.

    Those per item must agree in the shape of a row, the others in their values.
    """
    (first_place, first), *others = heads
    for place, head in others:
        one, other = _own(first), _own(head)
        for has, names in (("has no", one - other), ("has the", other - one)):
            if names:
                found = f"{has} dataset {', '.join(sorted(names))}, unlike {first_place}"
                raise input_error(place, found, ALL_OR_NONE)
        for name in sorted(one):
            if not _agree(first, head, name):
                raise input_error(place, f"its dataset {name} is not that of {first_place}", APART)


def _own(head: Any) -> set[str]:
    """Return the columns that others must have too: those that no layout lists, and meshes."""
    if isinstance(head, ResultSet):
        return {*head.columns}
    return {*head.further, *(head.columns.keys() & MESH)}


def _agree(first: Any, head: Any, name: str) -> bool:
    """Whether a column of two files is per item in both, with rows of one shape, or the same."""
    one, other = first.columns[name], head.columns[name]
    if name in first.per_item or name in head.per_item:
        both = name in first.per_item and name in head.per_item
        return both and one.shape[1:] == other.shape[1:]
    return np.array_equal(one, other, equal_nan=one.dtype.kind == other.dtype.kind == "f")
