"""Whether several files go together, and what their items have in common."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from shapefit.errors import input_error
from shapefit.io.checks import check_magnitudes
from shapefit.io.layout import EDGES, UNKNOWN_UNIT
from shapefit.io.options import Direction
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet

SEPARATELY = "use files that agree, or process them separately"
ALL_OR_NONE = "give it to all files (CSV cannot hold it) or to none, or process them separately"
MESH = frozenset({"mesh_vertices", "mesh_faces"})


def merge_heads(
    heads: Sequence[tuple[str, Any]],
    y_axes: Sequence[tuple[str, Direction | None]],
    y_axis: Direction | None,
) -> Any:
    """Return what all items of files have in common, each head and direction with the file's name.

    The landmarks of images are those of all files in order of appearance, those of shapes and of
    results are the same in all; where no file states the direction of y, it is `y_axis`, and down
    without. What differs between files of images, as of cameras, is of items. Raises InputError
    where files do not go together, or state another direction.
    """
    (first_file, first), *others = heads
    names = first.landmark_names
    if isinstance(first, LandmarkSet):
        names = tuple(dict.fromkeys(name for _, head in heads for name in head.landmark_names))
    if isinstance(first, ResultSet):
        for file, head in others:
            if head.landmark_names != names:
                found = f"its landmarks are not those of {first_file}, in their order"
                raise input_error(file, found, SEPARATELY)
    else:
        heads = [(file, head.arrange(names, file)) for file, head in heads]
    if isinstance(first, LandmarkSet):
        edges = next((head.whole[EDGES] for _, head in heads if EDGES in head.whole), None)
        heads = [(file, _with_edges(head, edges)) for file, head in heads]
        differing = [
            name
            for name in heads[0][1].whole.keys() - {EDGES, "mirror_index"}
            if all(name in head.whole for _, head in others)
            and len({head.whole[name].shape for _, head in heads}) == 1
            and not all(_agree(heads[0][1], head, name) for _, head in heads[1:])
        ]
        heads = [(file, _per_item(head, differing)) for file, head in heads]
    _check_columns(heads)
    units = [(file, None if head.unit == UNKNOWN_UNIT else head.unit) for file, head in heads]
    changes: dict[str, Any] = {
        "unit": agreed("unit", units) or UNKNOWN_UNIT,
        "frame_rate": agreed("frame_rate", [(file, head.frame_rate) for file, head in heads]),
    }
    if not isinstance(first, ShapeSet):
        stated = agreed("y_axis", y_axes)
        changes["y_axis"] = stated or y_axis or "down"
        if y_axis is not None and stated not in (None, y_axis):
            file = next(file for file, direction in y_axes if direction == stated)
            fix = "leave the key out; if the file is wrong, correct its attribute y_axis"
            raise input_error(file, f"states that y points {stated}, and `y_axis` is {y_axis}", fix)
    for name in ("sequences", "confidence", "edges"):
        values = (getattr(head, name, None) for _, head in heads)
        if (value := next((v for v in values if v is not None), None)) is not None:
            changes[name] = value
    return heads[0][1].replaced(**changes)


def align_to(part: Any, head: Any, file: str) -> Any:
    """Return a part of one file with the landmarks and fields of the whole source."""
    part = _per_item(part, part.whole.keys() & head.per_item.keys())
    changes: dict[str, Any] = {"unit": head.unit, "frame_rate": head.frame_rate}
    if head.sequences is not None and part.sequences is None:
        changes["sequences"] = ("",) * len(part)
    if isinstance(part, ResultSet):
        check_magnitudes(file, part.shapes, part.items, part.landmark_names)
        return part.replaced(**changes, y_axis=head.y_axis, attributes=head.attributes)
    if isinstance(part, ShapeSet):
        return part.arrange(head.landmark_names, file).replaced(**changes, edges=head.edges)
    if head.confidence is not None and part.confidence is None:
        changes["confidence"] = np.ones((len(part), len(part.landmark_names)))
    part = part.replaced(**changes, y_axis=head.y_axis).arrange(head.landmark_names, file)
    return _with_edges(part, head.whole.get(EDGES))


def agreed(what: str, stated: Sequence[tuple[str, Any]]) -> Any:
    """Return what all files state, None if none does; each comes with its name.

    Raises InputError where two files differ.
    """
    known = [(file, value) for file, value in stated if value is not None]
    for file, value in known[1:]:
        first_file, first = known[0]
        if value != first:
            one, other = (v if isinstance(v, str) else f"{v:.17g}" for v in (value, first))
            raise input_error(
                file, f"its {what} is '{one}', that of {first_file} is '{other}'", SEPARATELY
            )
    return known[0][1] if known else None


def _per_item(records: Any, names: Collection[str]) -> Any:
    """Return records in which these columns of the file are columns of each item."""
    if not names:
        return records
    n = len(records)
    values = {name: records.whole[name] for name in names}
    return records.with_columns({k: np.broadcast_to(v, (n, *v.shape)) for k, v in values.items()})


def _with_edges(images: LandmarkSet, edges: Any) -> LandmarkSet:
    """Return images whose edges are those of the first file that has any."""
    return images if edges is None else images.with_columns(whole={EDGES: edges})


def _check_columns(heads: Sequence[tuple[str, Any]]) -> None:
    """Raise InputError unless all files have the same columns that no layout lists, and meshes.

    Of results these are all columns. Those per item must agree in the shape of a row, the others
    in their values.
    """
    (first_file, first), *others = heads
    one, *rest = (
        {*(head.columns if isinstance(head, ResultSet) else head.further)}
        | (head.columns.keys() & MESH)
        for _, head in heads
    )
    for (file, head), other in zip(others, rest, strict=True):
        for has, names in (("has no", one - other), ("has the", other - one)):
            if names:
                found = f"{has} dataset {', '.join(sorted(names))}, unlike {first_file}"
                raise input_error(file, found, ALL_OR_NONE)
        for name in sorted(one):
            if not _agree(first, head, name):
                raise input_error(
                    file, f"its dataset {name} is not that of {first_file}", SEPARATELY
                )


def _agree(first: Any, head: Any, name: str) -> bool:
    """Whether a column of two files is per item in both, with rows of one shape, or the same."""
    if name in first.per_item or name in head.per_item:
        both = name in first.per_item and name in head.per_item
        return both and first.per_item[name].shape[1:] == head.per_item[name].shape[1:]
    one, other = first.whole[name], head.whole[name]
    return np.array_equal(one, other, equal_nan=one.dtype.kind == other.dtype.kind == "f")
