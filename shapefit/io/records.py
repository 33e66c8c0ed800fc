"""Landmarks, shapes and results in memory: columns by name, in the paper's
orientation.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from copy import copy
from itertools import chain
from typing import Any, ClassVar, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.io.layout import (
    COUNTS,
    EDGES,
    LABELS,
    LANDMARKS,
    RESULTS,
    SHAPES,
    UNKNOWN_UNIT,
    Layout,
    fit_axes,
)
from shapefit.io.names import match_landmarks

Names = tuple[str, ...]
Attribute = str | float | int
Columns = Mapping[str, Any]
Rows = NDArray[Any] | Sequence[int] | slice

_TYPES = {
    "number": np.float64,
    "points": np.float64,
    "index": np.int64,
    "text": np.str_,
}
_FIELDS = (
    "landmark_names",
    "items",
    "sequences",
    "unit",
    "frame_rate",
    "y_axis",
    "attributes",
)


class Records:
    """n items of one kind with p landmarks; LAYOUT lists the datasets and their axes.

    landmark_names (p,), items (n,) unique, sequences (n,) or None: tuples of texts.
    `per_item` and `whole` hold the other datasets by name: those with a row for each
    item (some rows, where the layout counts them), and those of the file. Points of the
    layout stand in columns (..., 3, p), all else as in the file. What the layout lists
    is an attribute too, None where it is absent. unit is that of lengths; frame_rate in
    Hz; y_axis where y points, None for shapes; attributes are stored with the file.
    """

    LAYOUT: ClassVar[Layout]

    def __init__(
        self,
        points: Any = None,
        landmark_names: Sequence[str] = (),
        items: Sequence[str] = (),
        sequences: Sequence[str] | None = None,
        *,
        unit: str = UNKNOWN_UNIT,
        y_axis: Literal["up", "down"] | None = None,
        frame_rate: float | None = None,
        attributes: Mapping[str, Attribute] | None = None,
        columns: Columns | None = None,
        whole: Columns | None = None,
        **named: Any,
    ) -> None:
        """Take the points (also by the name of their column) and other columns; None is
        absent.

        `columns` have a row for each item unless the layout says otherwise
        (`is_per_item`); `whole` belong to the file. Raises ValueError where axes
        disagree, and TypeError for a keyword that the layout does not list.
        """
        if unlisted := named.keys() - self.LAYOUT.all.keys():
            raise TypeError(
                f"{type(self).__name__} has no {', '.join(sorted(unlisted))}"
            )
        self.landmark_names, self.items = tuple(landmark_names), tuple(items)
        self.sequences = None if sequences is None else tuple(sequences)
        self.unit, self.frame_rate = unit, frame_rate
        self.y_axis = None if self.LAYOUT is SHAPES else y_axis or "down"
        self.attributes: Mapping[str, Attribute] = attributes or {}
        self.per_item: dict[str, NDArray[Any]] = {}
        self.whole: dict[str, NDArray[Any]] = {}
        sizes = {"n": len(self), "p": len(self.landmark_names)}
        given = {
            self.LAYOUT.points: points,
            **(columns or {}),
            **named,
            **(whole or {}),
        }
        for name, value in given.items():
            if value is None:
                continue
            column = self.LAYOUT.datasets.get(name)
            values = np.asarray(value, _TYPES.get(column.kind) if column else None)
            per_item = name not in (whole or {}) and self.LAYOUT.is_per_item(
                name, values.ndim
            )
            (self.per_item if per_item else self.whole)[name] = values
            shape = values.shape
            if column and column.kind == "points":
                shape = values.swapaxes(-1, -2).shape
            axes = column.axes if column else ("n", *shape[1:]) if per_item else shape
            if not fit_axes(axes, shape, sizes):
                raise ValueError(
                    f"{name} has the shape {shape}; expected {axes} with {sizes}"
                )

    def __getattr__(self, name: str) -> Any:
        """Return a column that the layout lists; None where it is absent."""
        if name not in self.LAYOUT.datasets and name not in self.LAYOUT.further:
            raise AttributeError(f"{type(self).__name__} has no {name}")
        return self.per_item.get(name, self.whole.get(name))

    def __len__(self) -> int:
        return len(self.items)

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """All columns, per item and of the file."""
        return {**self.per_item, **self.whole}

    @property
    def further(self) -> dict[str, NDArray[Any]]:
        """The columns that stand in memory as in the file."""
        return {
            name: v
            for name, v in self.columns.items()
            if name not in self.LAYOUT.datasets
        }

    @property
    def points(self) -> Floats:
        """The landmarks (n, 2, p), or the shapes (n, 3, p)."""
        return self.per_item[self.LAYOUT.points]

    @property
    def lines(self) -> Integers | None:
        """Pairs of landmarks (e, 2) that a line joins, as far as they are such; None
        without.
        """
        edges = self.whole.get(EDGES)
        if edges is None or edges.shape[1:] != (2,) or edges.dtype.kind not in "iu":
            return None
        return edges[((edges >= 0) & (edges < len(self.landmark_names))).all(axis=1)]

    def replaced(self, **changes: Any) -> Self:
        """Return the same with other attributes and columns; None removes a column.

        A column that is there stays per item, or of the file. `further` stands for all
        of these.
        """
        fields = {name: changes.pop(name, getattr(self, name)) for name in _FIELDS}
        if "further" in changes:
            changes = (
                dict.fromkeys(self.further) | dict(changes.pop("further")) | changes
            )
        whole = {name: changes.pop(name, values) for name, values in self.whole.items()}
        return type(self)(**fields, columns={**self.per_item, **changes}, whole=whole)

    def with_columns(
        self, columns: Columns | None = None, whole: Columns | None = None
    ) -> Self:
        """Return the same with more columns, in place of those of the same names."""
        bare = self.without({**(columns or {}), **(whole or {})})
        bare.per_item |= columns or {}
        bare.whole |= whole or {}
        return bare.replaced()

    def without(self, names: Collection[str]) -> Self:
        """Return the same without these columns."""
        bare = copy(self)
        bare.per_item = {
            name: v for name, v in self.per_item.items() if name not in names
        }
        bare.whole = {name: v for name, v in self.whole.items() if name not in names}
        return bare

    def take(self, indices: Rows) -> Self:
        """Return the items at these indices (numbers, a mask or a slice), in their
        order.
        """
        rows = np.arange(len(self))[indices]
        taken = copy(self)
        taken.items = tuple(self.items[row] for row in rows.tolist())
        if self.sequences is not None:
            taken.sequences = tuple(self.sequences[row] for row in rows.tolist())
        pieces: Any = (
            indices if isinstance(indices, slice) else rows
        )  # a slice copies nothing
        counted = {
            name
            for name, column in self.LAYOUT.datasets.items()
            if column.axes[0] == "a"
        }
        taken.per_item = {
            n: v[pieces] for n, v in self.per_item.items() if n not in counted
        }
        if counted := counted & self.per_item.keys():
            counts = self.per_item[COUNTS]
            ends = np.cumsum(counts)
            ranges = [np.arange(ends[row] - counts[row], ends[row]) for row in rows]
            pieces = np.concatenate([np.empty(0, np.intp), *ranges])
            taken.per_item |= {name: self.per_item[name][pieces] for name in counted}
        return taken

    def arrange(
        self, names: Sequence[str], place: str = "landmark_names", *, omit: bool = False
    ) -> Self:
        """Return the same items with the landmarks `names`, in that order.

        Landmarks that images lack are unseen (NaN, confidence 0) and have no label;
        edges move with their landmarks. Landmarks that `names` lacks are left out with
        `omit`. Raises InputError at `place` for those otherwise, and for shapes that
        lack one.
        """
        names, p = tuple(names), len(self.landmark_names)
        if names == self.landmark_names:
            return self
        if not omit:
            match_landmarks(names, self.landmark_names, place)
        if self.LAYOUT is SHAPES:
            match_landmarks(self.landmark_names, names, place)
        column_of = {name: column for column, name in enumerate(self.landmark_names)}
        columns = np.array(
            [column_of.get(name, p) for name in names], np.intp
        )  # p: unseen
        position = np.full(p + 1, -1)
        position[columns] = np.arange(len(names))
        # sums round by the order in memory, and results with them
        padded = np.pad(self.points, [(0, 0), (0, 0), (0, 1)], constant_values=np.nan)
        changes = {self.LAYOUT.points: np.ascontiguousarray(padded[..., columns])}
        for name in ("confidence", *LABELS):
            values = self.per_item.get(name)
            if values is not None and values.shape[:2] == (len(self), p):
                changes[name] = np.pad(values, [(0, 0), (0, 1)])[:, columns]
        if (lines := self.lines) is not None:
            moved = position[lines]
            changes[EDGES] = moved[(moved >= 0).all(axis=1)]
        if (
            self.LAYOUT is SHAPES
            and (partners := self.whole.get("mirror_index")) is not None
        ):
            changes["mirror_index"] = position.take(partners[columns], mode="clip")
        return self.replaced(landmark_names=names, **changes)

    def with_whole_points(self) -> Self:
        """Return the same items; a landmark with one unknown coordinate has none."""
        unknown = np.isnan(self.points).any(axis=1, keepdims=True)
        return self.replaced(
            **{self.LAYOUT.points: np.where(unknown, np.nan, self.points)}
        )


class ShapeSet(Records):
    """n shapes of p landmarks: shapes (n, 3, p) in `unit`.

    edges (e, 2) and mesh_faces (f, 3) hold indices of landmarks and mesh vertices;
    mesh_vertices (n, 3, q).
    """

    LAYOUT = SHAPES

    shapes: Floats


class LandmarkSet(Records):
    """n images of p landmarks: landmarks (n, 2, p) in `unit`, NaN where unseen.

    confidence (n, p) >= 0 or None, which means 1 for all; y_axis is the direction of y.
    """

    LAYOUT = LANDMARKS

    landmarks: Floats
    confidence: Floats | None

    def weights(self) -> Floats:
        """Omega (n, p): the confidence, or 1, where a landmark has a place, and 0
        elsewhere.
        """
        placed = np.isfinite(self.landmarks).all(axis=1)
        return np.where(
            placed, 1.0 if self.confidence is None else self.confidence, 0.0
        )

    def visible(self) -> NDArray[np.bool_]:
        """Omega > 0 (n, p): the landmarks that have a place and confidence."""
        return self.weights() > 0


class ResultSet(Records):
    """The fit of n images: shapes (n, 3, p) in the camera frame and `unit`, NaN where
    it failed.

    landmarks_fitted (n, 2, p) of a perspective camera (of others they are shapes[:,
    :2]). All but the shapes may be None, as in a CSV file. What proves the optimum
    (`layout.PROOF`) is in normalised units; the transforms that are not 0 stand one
    image after the other: active_transforms (a, 2, 3) of the atoms transform_atom (a,),
    transform_count (n,) of each image. attributes are stored with the file (method,
    times, config, digests).
    """

    LAYOUT = RESULTS


KINDS: dict[str, type[Records]] = {
    kind.LAYOUT.kind: kind for kind in (LandmarkSet, ShapeSet, ResultSet)
}
"""What a file of each kind is in memory."""

Record = TypeVar("Record", bound=Records)


def order_by_frame(
    sequences: Sequence[str] | None, frames: NDArray[Any] | None
) -> NDArray[np.intp] | None:
    """Return the order (n,) in which frames rise, sequence by sequence; None where
    they rise as they stand.

    Items of no sequence, "", stay in their order.
    """
    if sequences is None or frames is None:
        return None
    number: dict[str, int] = {}
    which = np.array([number.setdefault(s, len(number)) for s in sequences], np.intp)
    places = np.where(which == number.get("", -1), 0, frames)
    together = np.argsort(which, kind="stable")
    same = np.diff(which[together]) == 0
    if not (same & (np.diff(places[together]) < 0)).any():
        return None
    return np.lexsort((places, which))


def concatenate(parts: Sequence[Record]) -> Record:
    """Join records of the same landmarks and columns; what is of the file comes from
    the first.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    joined = copy(first)
    joined.items = tuple(chain.from_iterable(part.items for part in parts))
    if first.sequences is not None:
        joined.sequences = tuple(
            chain.from_iterable(part.sequences or () for part in parts)
        )
    joined.per_item = {
        name: np.concatenate([part.per_item[name] for part in parts])
        for name in first.per_item
    }
    return joined
