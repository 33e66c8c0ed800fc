"""Whether several files go together, and what their items have in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error, listed
from shapefit.io.checks import Axis, check_magnitudes
from shapefit.io.layout import EDGES, UNKNOWN_UNIT
from shapefit.io.options import Direction
from shapefit.io.records import LandmarkSet, ResultSet, ShapeSet

Array = NDArray[Any]
Text = TypeVar("Text", bound=str)
APART = "use files that agree, or process them separately"
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
    if isinstance(first, LandmarkSet):
        names = tuple(dict.fromkeys(name for _, head in heads for name in head.landmark_names))
    if isinstance(first, ResultSet):
        _check_same_datasets(heads)
    else:
        heads = [(place, head.arrange(names, place)) for place, head in heads]
    if isinstance(first, LandmarkSet):
        stated = (_edges(head) for _, head in heads)
        lines = next((each for each in stated if each is not None), None)
        heads = [(place, _with_edges(head, lines)) for place, head in heads]
    if isinstance(first, ShapeSet):
        meshes = [(place, head.mesh_vertices) for place, head in heads]
        sizes = [(place, None if m is None else np.array(m.shape[1:])) for place, m in meshes]
        check_same_array("mesh", sizes)
        check_same_array("mesh_faces", [(place, head.mesh_faces) for place, head in heads])
    check_same_columns(heads)
    units = [(place, None if head.unit == UNKNOWN_UNIT else head.unit) for place, head in heads]
    changes: dict[str, Any] = {
        "unit": agreed("unit", units, UNKNOWN_UNIT),
        "frame_rate": agreed_rate([(place, head.frame_rate) for place, head in heads]),
    }
    if not isinstance(first, ShapeSet):
        changes["y_axis"] = found = agreed("y_axis", y_axes, y_axis or "down")
        if y_axis not in (None, found):
            place = next(place for place, stated in y_axes if stated == found)
            fix = "leave the key out; if the file is wrong, correct its attribute y_axis"
            raise input_error(place, f"states that y points {found}, and `y_axis` is {y_axis}", fix)
    for name in ("sequences", "confidence", "edges"):
        known = (getattr(head, name, None) for _, head in heads)
        if (value := next((each for each in known if each is not None), None)) is not None:
            changes[name] = value
    return heads[0][1].replaced(**changes)


def conform(part: Any, head: Any, place: str) -> Any:
    """Return a part of one file with the landmarks and fields of the whole source."""
    changes: dict[str, Any] = {"unit": head.unit, "frame_rate": head.frame_rate}
    if head.sequences is not None and part.sequences is None:
        changes["sequences"] = ("",) * len(part)
    if isinstance(part, ResultSet):
        items, landmarks = Axis("item", part.items), Axis("landmark", part.landmark_names)
        check_magnitudes(place, part.shapes, items, landmarks)
        return part.replaced(**changes, y_axis=head.y_axis, attributes=head.attributes)
    if isinstance(part, ShapeSet):
        return part.arrange(head.landmark_names, place).replaced(**changes, edges=head.edges)
    if head.confidence is not None and part.confidence is None:
        changes["confidence"] = np.ones((len(part), len(part.landmark_names)))
    part = part.replaced(**changes, y_axis=head.y_axis).arrange(head.landmark_names, place)
    return _with_edges(part, _edges(head))


def _edges(images: LandmarkSet) -> Array | None:
    return images.columns.get(EDGES)


def _with_edges(images: LandmarkSet, edges: Array | None) -> LandmarkSet:
    """Return images whose edges are those of the first file that has any."""
    if edges is None:
        return images
    return images.with_columns({EDGES: edges}, of_file=[EDGES])


def agreed(what: str, stated: Sequence[tuple[str, Text | None]], default: Text) -> Text:
    """Return what all files state, `default` if none does; each comes with its name.

    Raises InputError where two files differ.
    """
    first: tuple[str, Text] | None = None
    for place, value in stated:
        if value is None:
            continue
        if first is None:
            first = (place, value)
        elif value != first[1]:
            found = f"its {what} is '{value}', that of {first[0]} is '{first[1]}'"
            raise input_error(place, found, APART)
    return default if first is None else first[1]


def agreed_rate(stated: Sequence[tuple[str, float | None]]) -> float | None:
    """Return the frame rate that all files state, None if none does; raises as `agreed`."""
    texts = [(place, None if rate is None else f"{rate:.17g}") for place, rate in stated]
    text = agreed("frame_rate", texts, "")
    return float(text) if text else None


def check_same_array(what: str, files: Sequence[tuple[str, NDArray[np.int64] | None]]) -> None:
    """Raise InputError unless all files have the same array, or none has it."""
    for place, array in files[1:]:
        _compare(what, files[0], (place, array))


def check_same_columns(heads: Sequence[tuple[str, Any]]) -> None:
    """Raise InputError unless all files have the same columns beside those of the layout.

    Those per item must agree in the shape of a row, the others in their values.
    """
    (first_place, first), *others = heads
    for place, head in others:
        one, other = first.further.keys(), head.further.keys()
        for has, names in (("has no", one - other), ("has the", other - one)):
            if names:
                found = f"{has} dataset {', '.join(sorted(names))}, unlike {first_place}"
                raise input_error(place, found, ALL_OR_NONE)
        for name in one:
            arrays = _comparable(first, name), _comparable(head, name)
            _compare(f"dataset {name}", (first_place, arrays[0]), (place, arrays[1]))


def _check_same_datasets(heads: Sequence[tuple[str, ResultSet]]) -> None:
    """Raise InputError unless all results have the same landmarks and datasets."""
    (first_place, first), *others = heads
    for place, head in others:
        if head.landmark_names != first.landmark_names:
            found = f"its landmarks are not those of {first_place}, in their order"
            raise input_error(place, found, APART)
        if differing := sorted(head.datasets ^ first.datasets):
            found = f"only one of it and {first_place} has {listed(differing, 'and')}"
            raise input_error(place, found, APART)


def _comparable(head: Any, name: str) -> Array:
    if name in head.of_file:
        return np.asarray(head.columns[name])
    return np.array(["per item", *head.columns[name].shape[1:]], dtype=object)


def _compare(what: str, first: tuple[str, Array | None], file: tuple[str, Array | None]) -> None:
    place, array = file
    first_place, expected = first
    if array is None and expected is None:
        return
    if array is None:
        raise input_error(place, f"has no {what}, unlike {first_place}", APART)
    if expected is None:
        raise input_error(place, f"has a {what}, unlike {first_place}", APART)
    floats = array.dtype.kind == expected.dtype.kind == "f"
    if not np.array_equal(array, expected, equal_nan=floats):
        raise input_error(place, f"its {what} is not that of {first_place}", APART)
