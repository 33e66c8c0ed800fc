"""Whether several files go together, and what their items have in common."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from shapefit.errors import input_error
from shapefit.io.layout import EDGES, UNKNOWN_UNIT
from shapefit.io.options import Direction
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet

SEPARATELY = "use files that agree, or process them separately"


def merge_heads(files: Sequence[Any], y_axis: Direction | None) -> Any:
    """Return what all items of files have in common: one head for all.

    The landmarks of images are those of all files in order of appearance, those of shapes and of
    results are the same in all. What differs between files of images, as cameras do, is of items.
    y points as files state it, or as `y_axis`, or down. Raises InputError where files do not go
    together, or state another direction than `y_axis`.
    """
    heads = [file.head for file in files]
    first = heads[0]
    if isinstance(first, LandmarkSet):
        names = tuple(dict.fromkeys(name for head in heads for name in head.landmark_names))
        edges = next((head.whole[EDGES] for head in heads if EDGES in head.whole), None)
        heads = [_as_images(head, names, edges, "") for head in heads]
        shared = set.intersection(*(set(head.whole) for head in heads))
        differing = {n for n in shared if not all(_agree(heads[0], head, n) for head in heads)}
        heads = [_per_item(head, differing) for head in heads]
    elif isinstance(first, ShapeSet):
        heads = [file.head.arrange(first.landmark_names, file.name) for file in files]
    for file, head in zip(files, heads, strict=True):
        if head.landmark_names != heads[0].landmark_names:
            fault = f"its landmarks are not those of {files[0].name}, in their order"
            raise input_error(file.name, fault, SEPARATELY)
        for name in sorted(_compared(head) | _compared(heads[0])):
            if not _agree(heads[0], head, name):
                fault = f"its dataset {name} is not that of {files[0].name}"
                raise input_error(file.name, fault, SEPARATELY)
    unit = _agreed(files, "unit", [h.unit if h.unit != UNKNOWN_UNIT else None for h in heads])
    changes: dict[str, Any] = {
        "unit": unit or UNKNOWN_UNIT,
        "frame_rate": _agreed(files, "frame_rate", [head.frame_rate for head in heads]),
    }
    if not isinstance(first, ShapeSet):
        stated = _agreed(files, "y_axis", [file.y_axis for file in files])
        changes["y_axis"] = stated or y_axis or "down"
        if y_axis is not None and stated not in (None, y_axis):
            file = next(file for file in files if file.y_axis is not None)
            fix = "leave the key out; if the file is wrong, correct its attribute y_axis"
            fault = f"states that y points {stated}, and `y_axis` is {y_axis}"
            raise input_error(file.name, fault, fix)
    for name in ("sequences", "confidence", "edges"):
        values = (getattr(head, name, None) for head in heads)
        if (value := next((v for v in values if v is not None), None)) is not None:
            changes[name] = value
    return heads[0].replaced(**changes)


def align_to(part: Any, head: Any, file: str) -> Any:
    """Return a part of one file with the landmarks and columns of the whole source."""
    part = _per_item(part, part.whole.keys() & head.per_item.keys())
    changes: dict[str, Any] = {"unit": head.unit, "frame_rate": head.frame_rate}
    if head.sequences is not None and part.sequences is None:
        changes["sequences"] = ("",) * len(part)
    if isinstance(part, ResultSet):
        return part.replaced(**changes, y_axis=head.y_axis, attributes=head.attributes)
    if isinstance(part, ShapeSet):
        return part.arrange(head.landmark_names, file).replaced(**changes, edges=head.edges)
    if head.confidence is not None and part.confidence is None:
        changes["confidence"] = np.ones((len(part), len(part.landmark_names)))
    part = part.replaced(**changes, y_axis=head.y_axis)
    return _as_images(part, head.landmark_names, head.whole.get(EDGES), file)


def _as_images(images: LandmarkSet, names: tuple[str, ...], edges: Any, file: str) -> LandmarkSet:
    """Return images with these landmarks, and with the edges of the first file that has any."""
    images = images.arrange(names, file)
    return images if edges is None else images.with_columns(whole={EDGES: edges})


def _per_item(records: Any, names: Collection[str]) -> Any:
    """Return records in which these columns of the file are columns of each item."""
    if not names:
        return records
    n = len(records)
    values = {name: records.whole[name] for name in names}
    return records.with_columns({k: np.broadcast_to(v, (n, *v.shape)) for k, v in values.items()})


def _compared(records: Any) -> set[str]:
    """Return columns that all files need: those that no layout lists, meshes, all of results."""
    columns = records.columns if isinstance(records, ResultSet) else records.further
    return {*columns, *(records.columns.keys() & {"mesh_vertices", "mesh_faces"})}


def _agree(first: Any, head: Any, name: str) -> bool:
    """Whether a column of two files is per item in both, with rows of one shape, or the same."""
    if name in first.per_item and name in head.per_item:
        return bool(first.per_item[name].shape[1:] == head.per_item[name].shape[1:])
    one, other = first.whole.get(name), head.whole.get(name)
    if one is None or other is None:
        return False
    return np.array_equal(one, other, equal_nan=one.dtype.kind == other.dtype.kind == "f")


def _agreed(files: Sequence[Any], what: str, stated: Sequence[Any]) -> Any:
    """Return what all files state, None if none does. Raises InputError where two differ."""
    pairs = [(f.name, value) for f, value in zip(files, stated, strict=True) if value is not None]
    for file, value in pairs:
        if value != pairs[0][1]:
            fault = f"its {what} is '{value}', that of {pairs[0][0]} is '{pairs[0][1]}'"
            raise input_error(file, fault, SEPARATELY)
    return pairs[0][1] if pairs else None
