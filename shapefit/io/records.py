"""What the files hold, in memory: shapes, landmarks and results, in the paper's orientation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from itertools import chain
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io.extras import LABELS, LANDMARK_COVARIANCE, Extras
from shapefit.io.layout import LANDMARKS, RESULTS, SHAPES, UNKNOWN_UNIT, Dataset, Format
from shapefit.io.problems import input_problems

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Names = tuple[str, ...]
Attribute = str | float | int
Rows = NDArray[Any] | Sequence[int] | slice


@dataclass(frozen=True)
class ShapeSet:
    """n shapes of p landmarks: shapes (n, 3, p) in `unit`.

    items are unique; sequences (n) name the clip or group of each; edges (e, 2) and mesh_faces
    (f, 3) hold indices of landmarks and mesh vertices; mesh_vertices (n, 3, q). frame_rate, in
    Hz, is that of the items of a sequence, None where it is unknown. extras are further datasets
    as they stand in the file.
    """

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

    def __post_init__(self) -> None:
        _complete(self)

    def __len__(self) -> int:
        return len(self.items)

    def take(self, indices: Rows) -> ShapeSet:
        """Return the shapes at these indices (numbers, a mask or a slice), in their order."""
        return _take(self, indices)


@dataclass(frozen=True, kw_only=True)
class LandmarkSet:
    """n images of p landmarks: landmarks (n, 2, p) in `unit`, NaN where unseen.

    confidence (n, p) >= 0 or None, which means 1 for all; y_axis is the direction of y; frame_rate
    as in a ShapeSet.
    """

    landmarks: Floats
    confidence: Floats | None = None
    landmark_names: Names
    items: Names
    sequences: Names | None = None
    unit: str = UNKNOWN_UNIT
    y_axis: Literal["up", "down"] = "down"
    frame_rate: float | None = None
    extras: Mapping[str, NDArray[Any]] = field(default_factory=Extras)

    def __post_init__(self) -> None:
        _complete(self)

    def __len__(self) -> int:
        return len(self.items)

    def take(self, indices: Rows) -> LandmarkSet:
        """Return the images at these indices (numbers, a mask or a slice), in their order."""
        return _take(self, indices)

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

        Landmarks that this set lacks are unseen (NaN, confidence 0) and have no label; extras but
        `LABELS` stay as they are. Where this set has a landmark that `names` lacks, `leave_out`
        leaves it out; without, that is an InputError at `place`.
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
        return replace(
            self,
            landmarks=arranged(self.landmarks, np.nan),
            confidence=None if self.confidence is None else arranged(self.confidence, 0),
            landmark_names=names,
            extras=extras | labels,
        )


@dataclass(frozen=True, kw_only=True)
class ResultSet:
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

    def __post_init__(self) -> None:
        _complete(self)

    def __len__(self) -> int:
        return len(self.items)

    def take(self, indices: Rows) -> ResultSet:
        """Return the results at these indices (numbers, a mask or a slice), in their order."""
        return _take(self, indices)


Record = TypeVar("Record", ShapeSet, LandmarkSet, ResultSet)

_FORMATS: Mapping[type, Format] = {
    ShapeSet: SHAPES,
    LandmarkSet: LANDMARKS,
    ResultSet: RESULTS,
}


def match_landmarks(
    have: Sequence[str], want: Sequence[str], place: str = "landmark_names"
) -> NDArray[np.intp]:
    """Return i with have[i[j]] == want[j] for every j.

    Raises InputError at `place` with the nearest names for every wanted name that is not there.
    """
    index = {name: number for number, name in enumerate(have)}
    strange = [name for name in want if name not in index]
    stripped = {name.strip() for name in have}
    if spaced := [repr(name) for name in strange if name.strip() in stripped]:
        found = f"names of landmarks differ from the known ones in spaces ({_some(spaced)})"
        raise input_error(place, found, "remove the spaces around names")
    if len(strange) == len(want) > 1:
        found = (
            f"none of the {len(want)} landmarks ({_some(want)}) is known; known are {_some(have)}"
        )
        raise input_error(place, found, "give files with the same landmark names")
    if strange:
        raise input_problems([_strange_landmark(place, name, have) for name in strange])
    return np.array([index[name] for name in want], dtype=np.intp)


def concatenate(parts: Sequence[Record]) -> Record:
    """Join records of the same landmarks, optional fields and extras, in their order.

    What is not per item is taken from the first part.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    changes: dict[str, Any] = {}
    for dataset in _FORMATS[type(first)].growing:
        values = [getattr(part, dataset.attribute) for part in parts]
        if values[0] is None:
            continue
        text = dataset.kind == "text"
        changes[dataset.attribute] = tuple(chain(*values)) if text else np.concatenate(values)
    extras = [Extras.of(part.extras, len(part)) for part in parts]
    per_item = {
        name: np.concatenate([e.per_item[name] for e in extras]) for name in extras[0].per_item
    }
    return replace(first, **changes, extras=Extras(per_item, extras[0].whole))


def nearest_names(name: str, known: Sequence[str]) -> list[str]:
    """Return the up to three known names that look most like a name."""
    return get_close_matches(name, known, n=3, cutoff=0.5)


def _strange_landmark(place: str, name: str, known: Sequence[str]) -> str:
    nearest = nearest_names(name, known)
    if nearest:
        fix = "did you mean " + " or ".join(f"'{near}'" for near in nearest) + "?"
    else:
        fix = f"use one of: {_some(known)}"
    return f"{place}: there is no landmark '{name}'; {fix}"


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")


def _take(records: Record, indices: Rows) -> Record:
    rows = np.arange(len(records))[indices]
    changes: dict[str, Any] = {}
    for dataset in _FORMATS[type(records)].growing:
        value = getattr(records, dataset.attribute)
        if value is None:
            continue
        if dataset.kind == "text":
            changes[dataset.attribute] = tuple(value[row] for row in rows)
        else:
            counts = getattr(records, dataset.counted_by) if dataset.counted_by else None
            changes[dataset.attribute] = value[rows if counts is None else _pieces(counts, rows)]
    extras = Extras.of(records.extras, len(records))
    return replace(records, **changes, extras=extras.take(rows))


def _pieces(counts: Integers, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the rows of what is counted by `counts` (n,) that belong to these items."""
    ends = np.cumsum(counts)
    pieces = [np.arange(ends[row] - counts[row], ends[row]) for row in rows]
    return np.concatenate([np.empty(0, dtype=np.intp), *pieces])


def _complete(records: ShapeSet | LandmarkSet | ResultSet) -> None:
    """Bring the fields to their types; ValueError where axes disagree (a programmer's error)."""
    sizes: dict[str, int] = {}
    for dataset in _FORMATS[type(records)].datasets:
        value = getattr(records, dataset.attribute)
        if value is None:
            continue
        value = tuple(value) if dataset.kind == "text" else np.asarray(value, _dtype(dataset))
        object.__setattr__(records, dataset.attribute, value)
        shape = np.shape(value) if dataset.kind != "text" else (len(value),)
        expected = tuple(
            sizes.setdefault(axis, size) if isinstance(axis, str) else axis
            for axis, size in zip(dataset.memory_axes, shape, strict=False)
        )
        if shape != expected or len(shape) != len(dataset.axes):
            raise ValueError(
                f"{dataset.attribute} has the shape {shape}; "
                f"expected {dataset.memory_axes} = {expected}"
            )
    object.__setattr__(records, "extras", Extras.of(records.extras, len(records)))


def _dtype(dataset: Dataset) -> type | None:
    return {"number": np.float64, "index": np.int64}.get(dataset.kind)
