"""What the files hold, in memory: shapes, landmarks and results, in the paper's orientation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any, ClassVar, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import input_error
from shapefit.io.extras import EDGES, LABELS, LANDMARK_COVARIANCE, Extras
from shapefit.io.landmark_names import match_landmarks, renamed
from shapefit.io.layout import LANDMARKS, RESULTS, SHAPES, UNKNOWN_UNIT, Format, fit_axes

Names = tuple[str, ...]
Attribute = str | float | int
Rows = NDArray[Any] | Sequence[int] | slice

_TYPES = {"number": np.float64, "index": np.int64}


class Records:
    """n items of one kind, with their names and those of p landmarks; one item takes one row.

    FORM lists the fields that files hold, and their axes.
    """

    FORM: ClassVar[Format]
    landmark_names: Names
    items: Names
    sequences: Names | None
    unit: str
    frame_rate: float | None
    extras: Mapping[str, NDArray[Any]]

    def __post_init__(self) -> None:
        """Bring the fields to their types; ValueError where axes disagree, a programmer's error."""
        sizes: dict[str, int] = {}
        for dataset in self.FORM.datasets:
            value = getattr(self, dataset.attribute)
            if value is None:
                continue
            text = dataset.kind == "text"
            value = tuple(value) if text else np.asarray(value, _TYPES.get(dataset.kind))
            object.__setattr__(self, dataset.attribute, value)
            shape = (len(value),) if text else np.shape(value)
            axes = dataset.memory_axes
            if not fit_axes(axes, shape, sizes):
                expected = tuple(sizes.get(str(axis), axis) for axis in axes)
                found = f"{dataset.attribute} has the shape {shape}"
                raise ValueError(f"{found}; expected {axes} = {expected}")
        object.__setattr__(self, "extras", Extras.of(self.extras, len(self)))

    def __len__(self) -> int:
        return len(self.items)

    def replaced(self, **fields: Any) -> Self:
        """Return the same with some fields replaced."""
        return replace(self, **fields)  # type: ignore[type-var]

    @property
    def datasets(self) -> frozenset[str]:
        """Names of the datasets of the layout that are known."""
        known = self.FORM.datasets
        return frozenset(each.name for each in known if getattr(self, each.attribute) is not None)

    def arrange(self, names: Sequence[str], place: str = "landmark_names") -> Self:
        """Return the same items with the landmarks `names`, in that order.

        Raises InputError at `place` for landmarks that do not fit.
        """
        if tuple(names) == self.landmark_names:
            return self
        raise ValueError(f"{type(self).__name__} cannot be arranged otherwise")

    @property
    def points(self) -> Floats:
        """The landmarks (n, 2, p), or the shapes (n, 3, p)."""
        points: Floats = getattr(self, self.FORM.points.attribute)
        return points

    @property
    def lines(self) -> Integers | None:
        """Pairs of landmarks (e, 2) that a line joins, as a field or among `extras`.

        Pairs of other numbers are left out; None where there is no dataset of pairs.
        """
        edges = getattr(self, EDGES, self.extras.get(EDGES))
        if edges is None or edges.ndim != 2 or edges.shape[1] != 2 or edges.dtype.kind not in "iu":
            return None
        return edges[((edges >= 0) & (edges < len(self.landmark_names))).all(axis=1)]

    def with_whole_points(self) -> Self:
        """Return the same items; a landmark with one unknown coordinate has none."""
        unknown = np.isnan(self.points).any(axis=1, keepdims=True)
        if not unknown.any():
            return self
        points = np.where(unknown, np.nan, self.points)
        return self.replaced(**{self.FORM.points.attribute: points})

    def take(self, indices: Rows) -> Self:
        """Return the items at these indices (numbers, a mask or a slice), in their order."""
        rows = np.arange(len(self))[indices]
        changes: dict[str, Any] = {}
        for dataset in self.FORM.growing:
            value = getattr(self, dataset.attribute)
            if value is None:
                continue
            if dataset.kind == "text":
                changes[dataset.attribute] = tuple(value[row] for row in rows)
            else:
                counts = getattr(self, dataset.counted_by) if dataset.counted_by else None
                changes[dataset.attribute] = value[
                    rows if counts is None else _pieces(counts, rows)
                ]
        extras = Extras.of(self.extras, len(self)).take(rows)
        return self.replaced(**changes, extras=extras)

    def renamed(self, rename: Mapping[str, str], place: str) -> Self:
        """Return the same items with the landmarks that `rename` (old name -> new) knows renamed.

        Raises InputError at `place` where two landmarks would have one name.
        """
        if not rename:
            return self
        return self.replaced(landmark_names=renamed(self.landmark_names, rename, place))


@dataclass(frozen=True)
class ShapeSet(Records):
    """n shapes of p landmarks: shapes (n, 3, p) in `unit`.

    items are unique; sequences (n) name the clip or group of each; edges (e, 2) and mesh_faces
    (f, 3) hold indices of landmarks and mesh vertices; mesh_vertices (n, 3, q). frame_rate, in
    Hz, is that of the items of a sequence, None where it is unknown. extras are further datasets
    as they stand in the file.
    """

    FORM = SHAPES

    shapes: Floats
    landmark_names: Names
    items: Names
    sequences: Names | None = None
    edges: Integers | None = None
    mesh_vertices: Floats | None = None
    mesh_faces: Integers | None = None
    unit: str = UNKNOWN_UNIT
    frame_rate: float | None = None
    extras: Mapping[str, NDArray[Any]] = field(default_factory=Extras)

    def arrange(self, names: Sequence[str], place: str = "landmark_names") -> ShapeSet:
        """Return the same shapes with the same landmarks, in the order of `names`.

        Raises InputError at `place` where the names are not those of this set.
        """
        names = tuple(names)
        if self.landmark_names == names:
            return self
        match_landmarks(names, self.landmark_names, place)
        columns = match_landmarks(self.landmark_names, names, place)
        position = np.argsort(columns)
        extras = Extras.of(self.extras, len(self))
        whole = dict(extras.whole)
        if "mirror_index" in whole:
            index = _mirror_index(whole["mirror_index"], len(names), place)
            whole["mirror_index"] = position[index[columns]]
        return replace(
            self,
            shapes=self.shapes[..., columns],
            landmark_names=names,
            edges=None if self.edges is None else position[self.edges],
            extras=Extras(extras.per_item, whole),
        )


@dataclass(frozen=True, kw_only=True)
class LandmarkSet(Records):
    """n images of p landmarks: landmarks (n, 2, p) in `unit`, NaN where unseen.

    confidence (n, p) >= 0 or None, which means 1 for all; y_axis is the direction of y; frame_rate
    as in a ShapeSet.
    """

    FORM = LANDMARKS

    landmarks: Floats
    confidence: Floats | None = None
    landmark_names: Names
    items: Names
    sequences: Names | None = None
    unit: str = UNKNOWN_UNIT
    y_axis: Literal["up", "down"] = "down"
    frame_rate: float | None = None
    extras: Mapping[str, NDArray[Any]] = field(default_factory=Extras)

    def weights(self) -> Floats:
        """Omega (n, p): the confidence, or 1, where a landmark has a place, and 0 elsewhere."""
        placed = np.isfinite(self.landmarks).all(axis=1)
        return np.where(placed, 1.0 if self.confidence is None else self.confidence, 0.0)

    def seen(self) -> NDArray[np.bool_]:
        """Omega > 0 (n, p): the landmarks that have a place and confidence."""
        return self.weights() > 0

    def arrange(
        self, names: Sequence[str], place: str = "landmark_names", *, leave_out: bool = False
    ) -> LandmarkSet:
        """Return the same images with the landmarks `names`, in that order.

        Landmarks that this set lacks are unseen (NaN, confidence 0) and have no label; edges
        join the landmarks that they joined; extras but these and `LABELS` stay as they are. Where
        this set has a landmark that `names` lacks, `leave_out` leaves it out; without, that is an
        InputError at `place`.
        """
        names = tuple(names)
        if names == self.landmark_names:
            return self
        own = np.arange(len(self.landmark_names))
        if leave_out:
            own = np.flatnonzero([name in set(names) for name in self.landmark_names])
        columns = match_landmarks(names, [self.landmark_names[j] for j in own], place)

        def arranged(values: NDArray[Any], absent: float) -> NDArray[Any]:
            every = np.full((*values.shape[:-1], len(names)), absent, values.dtype)
            every[..., columns] = values[..., own]
            return every

        extras = Extras.of(self.extras, len(self))
        labels = {
            name: arranged(values, 0)
            for name, values in extras.per_item.items()
            if name in LABELS and values.shape == (len(self), len(self.landmark_names))
        }
        covariance = extras.per_item.get(LANDMARK_COVARIANCE)
        if covariance is not None and covariance.shape[:2] == self.landmarks.shape[::2]:
            moved = arranged(np.moveaxis(covariance, 1, -1), 0)
            labels[LANDMARK_COVARIANCE] = np.moveaxis(moved, -1, 1)
        whole = dict(extras.whole)
        if self.lines is not None:
            position = np.full(len(self.landmark_names), -1)
            position[own] = columns
            moved = position[self.lines]
            whole[EDGES] = moved[(moved >= 0).all(axis=1)]
        return replace(
            self,
            landmarks=arranged(self.landmarks, np.nan),
            confidence=None if self.confidence is None else arranged(self.confidence, 0),
            landmark_names=names,
            extras=Extras({**extras.per_item, **labels}, whole),
        )


@dataclass(frozen=True, kw_only=True)
class ResultSet(Records):
    """What a fit found for n images: shapes (n, 3, p) in the camera frame and `unit`.

    NaN where an item failed. landmarks_fitted (n, 2, p); coefficients (n, k); rotation (n, 3, 3);
    translation (n, 2); scale, objective, relative_gap, iterations, status (n); shape_sd
    (n, 3, p), standard deviations of the shapes; transforms (n, k, 2, 3); mesh_vertices
    (n, 3, q). All but the shapes are None where they are not known, as in a CSV file.

    What proves the optimum of the convex program, in normalised units: dual (n, 2, p), feasible;
    convex_translation (n, 2), convex_objective and convex_relative_gap (n,), the last two where
    objective and relative_gap are not those of the program; the transforms that are not 0, one
    image after the other: active_transforms (a, 2, 3) of the atoms transform_atom (a,), and
    transform_count (n,) of them for each image.

    All readings, one image after the other and the best first: modes (n,) of each image, their
    mode_objective (m,), mode_rotation (m, 3, 3) and mode_shapes (m, 3, p). What proves the bound
    on all rotations: tree_cells (n,), 0 where the tree of an image was not kept, tree_splits (l,);
    tree_vertices (n,), tree_rotations (v, 4), tree_multipliers (v, 2, p).

    frame_rate as in a ShapeSet. attributes are stored with the file (method, times, config,
    digests).
    """

    FORM = RESULTS

    shapes: Floats
    landmarks_fitted: Floats | None = None
    coefficients: Floats | None = None
    rotation: Floats | None = None
    translation: Floats | None = None
    scale: Floats | None = None
    objective: Floats | None = None
    relative_gap: Floats | None = None
    iterations: Integers | None = None
    status: NDArray[Any] | None = None
    landmark_names: Names
    items: Names
    sequences: Names | None = None
    shape_sd: Floats | None = None
    transforms: Floats | None = None
    mesh_vertices: Floats | None = None
    dual: Floats | None = None
    convex_translation: Floats | None = None
    convex_objective: Floats | None = None
    convex_relative_gap: Floats | None = None
    transform_count: Integers | None = None
    transform_atom: Integers | None = None
    active_transforms: Floats | None = None
    modes: Integers | None = None
    mode_objective: Floats | None = None
    mode_rotation: Floats | None = None
    mode_shapes: Floats | None = None
    tree_cells: Integers | None = None
    tree_splits: Integers | None = None
    tree_vertices: Integers | None = None
    tree_rotations: Floats | None = None
    tree_multipliers: Floats | None = None
    extras: Mapping[str, NDArray[Any]] = field(default_factory=Extras)
    unit: str = UNKNOWN_UNIT
    y_axis: Literal["up", "down"] = "down"
    frame_rate: float | None = None
    attributes: Mapping[str, Attribute] = field(default_factory=dict)


Record = TypeVar("Record", bound=Records)


def concatenate(parts: Sequence[Record]) -> Record:
    """Join records of the same landmarks, optional fields and extras, in their order.

    What is not per item is taken from the first part.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    changes: dict[str, Any] = {}
    for dataset in first.FORM.growing:
        values = [getattr(part, dataset.attribute) for part in parts]
        if values[0] is None:
            continue
        text = dataset.kind == "text"
        changes[dataset.attribute] = tuple(chain(*values)) if text else np.concatenate(values)
    extras = [Extras.of(part.extras, len(part)) for part in parts]
    per_item = {
        name: np.concatenate([e.per_item[name] for e in extras]) for name in extras[0].per_item
    }
    return first.replaced(**changes, extras=Extras(per_item, extras[0].whole))


def _pieces(counts: Integers, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the rows of what is counted by `counts` (n,) that belong to these items."""
    ends = np.cumsum(counts)
    pieces = [np.arange(ends[row] - counts[row], ends[row]) for row in rows]
    return np.concatenate([np.empty(0, dtype=np.intp), *pieces])


def _mirror_index(index: NDArray[Any], p: int, place: str) -> NDArray[Any]:
    """Return the index of each landmark's mirror image; InputError where it is none."""
    whole_numbers = index.dtype.kind in "iu" and index.shape == (p,)
    if not whole_numbers or ((index < 0) | (index >= p)).any():
        found = "does not pair the landmarks"
        fix = "store the index of each landmark's mirror image, or remove it"
        raise input_error(f"{place}:/mirror_index", found, fix)
    return index
