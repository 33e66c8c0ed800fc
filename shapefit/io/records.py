"""Landmarks, shapes and results in memory: columns by name, in the paper's orientation."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from copy import copy
from itertools import chain
from typing import Any, ClassVar, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import input_error
from shapefit.io.layout import (
    EDGES,
    LABELS,
    LANDMARK_COVARIANCE,
    LANDMARKS,
    RESULTS,
    SHAPES,
    UNKNOWN_UNIT,
    Layout,
    fit_axes,
)
from shapefit.io.names import match_landmarks, renamed

Names = tuple[str, ...]
Attribute = str | float | int
Columns = Mapping[str, Any]
Direction = Literal["up", "down"]
Rows = NDArray[Any] | Sequence[int] | slice

_TYPES = {"number": np.float64, "index": np.int64}
_FIELDS = ("landmark_names", "items", "sequences", "unit", "frame_rate", "y_axis", "attributes")


class Records:
    """n items of one kind with p landmarks; LAYOUT lists the datasets and their axes.

    landmark_names (p,), items (n,) unique, sequences (n,) or None: tuples of texts. `per_item` and
    `whole` hold the other datasets by name: those with a row for each item (or, where the layout
    counts them, some rows), and those of the file. Columns of the layout stand as
    `Column.memory_axes` has them, others as in the file. What the layout lists is an attribute too,
    None where it is absent. unit is that of lengths; frame_rate in Hz; y_axis where y points, None
    for shapes; attributes are stored with the file.
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
        y_axis: Direction | None = None,
        frame_rate: float | None = None,
        attributes: Mapping[str, Attribute] | None = None,
        columns: Columns | None = None,
        whole: Columns | None = None,
        **named: Any,
    ) -> None:
        """Take the points (also by the name of their column) and other columns; None is absent.

        `columns` have a row for each item unless the layout says otherwise (`is_per_item`); `whole`
        belong to the file. Raises ValueError where axes disagree, and TypeError for a keyword that
        the layout does not list: a programmer's error.
        """
        self._require_listed(named)
        self.landmark_names, self.items = tuple(landmark_names), tuple(items)
        self.sequences = None if sequences is None else tuple(sequences)
        self.unit, self.frame_rate = unit, frame_rate
        self.y_axis = None if self.LAYOUT is SHAPES else y_axis or "down"
        self.attributes: Mapping[str, Attribute] = attributes or {}
        self.per_item: dict[str, NDArray[Any]] = {}
        self.whole = {name: self._as_array(name, value) for name, value in (whole or {}).items()}
        for name, value in {self.LAYOUT.points: points, **(columns or {}), **named}.items():
            if value is not None:
                array = self._as_array(name, value)
                per_item = self.LAYOUT.is_per_item(name, array.ndim)
                (self.per_item if per_item else self.whole).setdefault(name, array)
        self._check_axes()

    def _require_listed(self, names: Columns, *more: Collection[str]) -> None:
        if unknown := names.keys() - set(self.LAYOUT.all).union(*more):
            raise TypeError(f"{type(self).__name__} has no {', '.join(sorted(unknown))}")

    def _as_array(self, name: str, value: Any) -> NDArray[Any]:
        column = self.LAYOUT.datasets.get(name)
        return np.asarray(value, _TYPES.get(column.kind) if column else None)

    def _check_axes(self) -> None:
        n, sizes = len(self), {"n": len(self), "p": len(self.landmark_names)}
        if self.sequences is not None and len(self.sequences) != n:
            raise ValueError(f"there are {n} items and {len(self.sequences)} sequences")
        if self.LAYOUT.points not in self.per_item:
            raise TypeError(f"{type(self).__name__} needs {self.LAYOUT.points}")
        for name, values in self.columns.items():
            column = self.LAYOUT.datasets.get(name)
            axes = column.memory_axes if column else ("n", *values.shape[1:])
            if (column or name in self.per_item) and not fit_axes(axes, values.shape, sizes):
                expected = tuple(sizes.get(str(axis), axis) for axis in axes)
                found = f"{name} has the shape {values.shape}"
                raise ValueError(f"{found}; expected {axes} = {expected}")

    def __getattr__(self, name: str) -> Any:
        """Return a column that the layout lists; None where it is absent."""
        if name.startswith("_") or name not in type(self).LAYOUT.all:
            raise AttributeError(f"{type(self).__name__} has no {name}")
        return self.per_item.get(name, self.whole.get(name))

    def __len__(self) -> int:
        return len(self.items)

    def __repr__(self) -> str:
        counts = f"{len(self)} items, {len(self.landmark_names)} landmarks"
        return f"<{type(self).__name__} of {counts}: {', '.join(self.columns)}>"

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """All columns, per item and of the file."""
        return {**self.per_item, **self.whole}

    @property
    def further(self) -> dict[str, NDArray[Any]]:
        """The columns that the layout does not list, as they stand in the file."""
        return {n: values for n, values in self.columns.items() if n not in self.LAYOUT.names}

    @property
    def points(self) -> Floats:
        """The landmarks (n, 2, p), or the shapes (n, 3, p)."""
        return self.per_item[self.LAYOUT.points]

    @property
    def lines(self) -> Integers | None:
        """Pairs of landmarks (e, 2) that a line joins, as far as they are such; None without."""
        edges = self.whole.get(EDGES)
        if edges is None or edges.ndim != 2 or edges.shape[1] != 2 or edges.dtype.kind not in "iu":
            return None
        return edges[((edges >= 0) & (edges < len(self.landmark_names))).all(axis=1)]

    def replaced(self, **changes: Any) -> Self:
        """Return the same with other attributes and columns; None removes a column.

        A column that is there stays per item, or of the file. `per_item` and `whole` stand for all
        columns of either kind, `further` for all that the layout does not list.
        """
        fields = {name: changes.pop(name, getattr(self, name)) for name in _FIELDS}
        per_item = dict(changes.pop("per_item", self.per_item))
        whole = dict(changes.pop("whole", self.whole))
        if "further" in changes:
            further = dict.fromkeys(self.further) | dict(changes.pop("further"))
            listed = self.LAYOUT.names
            changes = {name: v for name, v in further.items() if name not in listed} | changes
        else:
            self._require_listed(changes, per_item, whole)
        whole |= {name: changes.pop(name) for name in changes.keys() & whole.keys()}
        whole = {name: values for name, values in whole.items() if values is not None}
        return type(self)(**fields, columns={**per_item, **changes}, whole=whole)

    def with_columns(self, columns: Columns | None = None, whole: Columns | None = None) -> Self:
        """Return the same with more columns, in place of those of the same names."""
        rest = self.without({**(columns or {}), **(whole or {})})
        return rest.replaced(
            per_item={**rest.per_item, **(columns or {})}, whole={**rest.whole, **(whole or {})}
        )

    def without(self, names: Collection[str]) -> Self:
        """Return the same without these columns."""
        return self.replaced(
            per_item={name: v for name, v in self.per_item.items() if name not in names},
            whole={name: v for name, v in self.whole.items() if name not in names},
        )

    def take(self, indices: Rows) -> Self:
        """Return the items at these indices (numbers, a mask or a slice), in their order."""
        rows = np.arange(len(self))[indices]
        taken = copy(self)
        taken.items = tuple(self.items[row] for row in rows.tolist())
        if self.sequences is not None:
            taken.sequences = tuple(self.sequences[row] for row in rows.tolist())
        own: Any = indices if isinstance(indices, slice) else rows  # a slice copies nothing
        counts = {n: c.counted_by for n, c in self.LAYOUT.datasets.items() if c.counted_by}
        taken.per_item = {
            name: values[_pieces(self.per_item[counts[name]], rows) if name in counts else own]
            for name, values in self.per_item.items()
        }
        return taken

    def with_whole_points(self) -> Self:
        """Return the same items; a landmark with one unknown coordinate has none."""
        unknown = np.isnan(self.points).any(axis=1, keepdims=True)
        if not unknown.any():
            return self
        return self.replaced(**{self.LAYOUT.points: np.where(unknown, np.nan, self.points)})

    def renamed(self, rename: Mapping[str, str], place: str = "rename") -> Self:
        """Return the same items, the landmarks renamed (old name -> new).

        Raises InputError at `place` where two landmarks would have one name.
        """
        if not rename:
            return self
        return self.replaced(landmark_names=renamed(self.landmark_names, rename, place))


class ShapeSet(Records):
    """n shapes of p landmarks: shapes (n, 3, p) in `unit`.

    edges (e, 2) and mesh_faces (f, 3) hold indices of landmarks and mesh vertices; mesh_vertices
    (n, 3, q).
    """

    LAYOUT = SHAPES

    shapes: Floats
    edges: Integers | None
    mesh_vertices: Floats | None
    mesh_faces: Integers | None

    def arrange(self, names: Sequence[str], place: str = "landmark_names") -> Self:
        """Return the same shapes with the same landmarks, in the order of `names`.

        Raises InputError at `place` where the names are not those of this set.
        """
        names = tuple(names)
        if self.landmark_names == names:
            return self
        match_landmarks(names, self.landmark_names, place)
        columns = match_landmarks(self.landmark_names, names, place)
        position = np.argsort(columns)
        changes: dict[str, Any] = {"shapes": self.shapes[..., columns]}
        if self.edges is not None:
            changes["edges"] = position[self.edges]
        if (index := self.whole.get("mirror_index")) is not None:
            whole_numbers = index.dtype.kind in "iu" and index.shape == (len(names),)
            if not whole_numbers or ((index < 0) | (index >= len(names))).any():
                found = "does not pair the landmarks"
                fix = "store the index of each landmark's mirror image, or remove it"
                raise input_error(f"{place}:/mirror_index", found, fix)
            changes["mirror_index"] = position[index[columns]]
        return self.replaced(landmark_names=names, **changes)


class LandmarkSet(Records):
    """n images of p landmarks: landmarks (n, 2, p) in `unit`, NaN where unseen.

    confidence (n, p) >= 0 or None, which means 1 for all; y_axis is the direction of y.
    """

    LAYOUT = LANDMARKS

    landmarks: Floats
    confidence: Floats | None

    def weights(self) -> Floats:
        """Omega (n, p): the confidence, or 1, where a landmark has a place, and 0 elsewhere."""
        placed = np.isfinite(self.landmarks).all(axis=1)
        return np.where(placed, 1.0 if self.confidence is None else self.confidence, 0.0)

    def visible(self) -> NDArray[np.bool_]:
        """Omega > 0 (n, p): the landmarks that have a place and confidence."""
        return self.weights() > 0

    def arrange(
        self, names: Sequence[str], place: str = "landmark_names", *, omit: bool = False
    ) -> Self:
        """Return the same images with the landmarks `names`, in that order.

        Landmarks that this set lacks are unseen (NaN, confidence 0) and have no label; edges
        join the landmarks that they joined; other columns stay as they are. Where this set has a
        landmark that `names` lacks, `omit` leaves it out; without, that is an InputError at
        `place`.
        """
        names = tuple(names)
        if names == self.landmark_names:
            return self
        p, wanted = len(self.landmark_names), set(names)
        retained = [j for j in range(p) if not omit or self.landmark_names[j] in wanted]
        places = match_landmarks(names, [self.landmark_names[j] for j in retained], place)

        def arranged(values: NDArray[Any], absent: float, axis: int = -1) -> NDArray[Any]:
            every = np.moveaxis(values, axis, -1)
            wider = np.full((*every.shape[:-1], len(names)), absent, values.dtype)
            wider[..., places] = every[..., retained]
            return np.moveaxis(wider, -1, axis)

        changes: dict[str, Any] = {"landmarks": arranged(self.landmarks, np.nan)}
        for name in ("confidence", *LABELS, LANDMARK_COVARIANCE):
            values = self.per_item.get(name)
            if values is not None and values.shape[:2] == (len(self), p):
                changes[name] = arranged(values, 0, axis=1)
        if (lines := self.lines) is not None:
            position = np.full(p, -1)
            position[retained] = places
            moved = position[lines]
            changes[EDGES] = moved[(moved >= 0).all(axis=1)]
        return self.replaced(landmark_names=names, **changes)


class ResultSet(Records):
    """The fit of n images: shapes (n, 3, p) in the camera frame and `unit`, NaN where it failed.

    landmarks_fitted (n, 2, p) of a perspective camera (of others they are shapes[:, :2]);
    coefficients (n, k); rotation (n, 3, 3); translation (n, 2); scale, objective, relative_gap,
    iterations, status (n); shape_sd (n, 3, p), standard deviations of the shapes; transforms
    (n, k, 2, 3); mesh_vertices (n, 3, q). All but the shapes may be None, as in a CSV file.

    What proves the optimum of the convex program, in normalised units: dual (n, 2, p), feasible;
    convex_translation (n, 2), convex_objective and convex_relative_gap (n,), the last two where
    objective and relative_gap are not those of the program; the transforms that are not 0, one
    image after the other: active_transforms (a, 2, 3) of the atoms transform_atom (a,), and
    transform_count (n,) of them for each image.

    attributes are stored with the file (method, times, config, digests). What else a fit writes is
    listed in `layout.RESULTS`.
    """

    LAYOUT = RESULTS


KINDS: dict[str, type[Records]] = {
    kind.LAYOUT.kind: kind for kind in (LandmarkSet, ShapeSet, ResultSet)
}
"""What a file of each kind is in memory."""

Record = TypeVar("Record", bound=Records)


def concatenate(parts: Sequence[Record]) -> Record:
    """Join records of the same landmarks and columns, in their order.

    What is not per item is taken from the first part.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    joined = copy(first)
    joined.items = tuple(chain.from_iterable(part.items for part in parts))
    if first.sequences is not None:
        joined.sequences = tuple(chain.from_iterable(part.sequences or () for part in parts))
    joined.per_item = {
        name: np.concatenate([part.per_item[name] for part in parts]) for name in first.per_item
    }
    return joined


def _pieces(counts: Integers, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the rows of what is counted by `counts` (n,) that belong to these items."""
    ends = np.cumsum(counts)
    pieces = [np.arange(ends[row] - counts[row], ends[row]) for row in rows]
    return np.concatenate([np.empty(0, dtype=np.intp), *pieces])
