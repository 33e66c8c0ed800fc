"""Shapes, landmarks, dictionaries and fits with one landmark per row, as files have them.

Inside the package a point is a column, (..., 3, p); here and in files it is a row, (..., p, 3).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shapefit.arrays import Floats, Integers
from shapefit.dictionary import model
from shapefit.dictionary.mixture import Mixture
from shapefit.errors import input_error
from shapefit.face.shown import (
    as_dataset,
    as_table,
    describe,
    draw_shape,
    embedded_page,
    open_page,
)
from shapefit.io.layout import (
    DICTIONARY,
    LANDMARKS,
    PROOF,
    RESULTS,
    SHAPES,
    UNKNOWN_UNIT,
    Layout,
    fit_axes,
    free_names,
)
from shapefit.io.records import LandmarkSet, Records, ResultSet, ShapeSet

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Names = Sequence[str]
Kind = TypeVar("Kind", bound="DataclassInstance")


@dataclass(frozen=True)
class Shapes:
    """n shapes of p landmarks: shapes (n, p, 3) in `unit`.

    items name the shapes, by default 0, 1, ...; sequences (n) the clip or group of each; edges
    (e, 2) are pairs of landmarks; mesh_vertices (n, q, 3) and mesh_faces (f, 3) a mesh; frame_rate
    is that of a sequence, in Hz; extras are further datasets.
    """

    shapes: ArrayLike
    landmark_names: Names | None = None
    items: Names | None = None
    sequences: Names | None = None
    edges: ArrayLike | None = None
    mesh_vertices: ArrayLike | None = None
    mesh_faces: ArrayLike | None = None
    unit: str = UNKNOWN_UNIT
    frame_rate: float | None = None
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Landmarks:
    """n images of p landmarks: landmarks (n, p, 2) in `unit`, NaN where unseen.

    confidence (n, p) >= 0 weights the landmarks, 0 = hidden; None is 1 for all. items name the
    images, by default 0, 1, ...; sequences (n) the clip of each; y_axis is where y points, down as
    pixels are counted; extras are further datasets, such as `true_rotation` (n, 3, 3) or
    `camera_matrix` (3, 3).
    """

    landmarks: ArrayLike
    landmark_names: Names | None = None
    confidence: ArrayLike | None = None
    items: Names | None = None
    sequences: Names | None = None
    unit: str = UNKNOWN_UNIT
    y_axis: Literal["up", "down"] = "down"
    frame_rate: float | None = None
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Dictionary:
    """k atoms: atoms (k, p, 3), centred and on the scale of normalised shapes.

    mean_shape (p, 3); prior is the mixture over shapes that `learn` or `read_dictionary` gives; the
    other fields as in a dictionary file (README.md, Files).
    """

    atoms: Floats
    landmark_names: Names
    mean_shape: Floats
    edges: Integers | None = None
    mirror_index: Integers | None = None
    mesh_vertices: Floats | None = None
    mesh_faces: Integers | None = None
    atom_scale: Floats | None = None
    unit: str = UNKNOWN_UNIT
    atom_items: Names | None = None
    prior: Mixture | None = None
    acceleration: Floats | None = None
    edge_give: Floats | None = None
    edge_length: Floats | None = None
    edge_covariance: Floats | None = None
    frame_rate: float | None = None
    objective_trace: Floats = field(default_factory=lambda: np.empty(0))
    provenance: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, repr=False)
class Fit:
    """3D shapes of n images: shapes (n, p, 3) in the camera frame and the unit of the landmarks.

    NaN where an image failed; failures says why, by item. landmarks_fitted (n, p, 2);
    coefficients (n, k); rotation (n, 3, 3); translation (n, 2); scale, objective, relative_gap,
    iterations, status (n). None is what the method does not know: of these, and of shape_sd
    (n, p, 3), the standard deviation of each coordinate, plausibility (n,), trusted (n,) and
    doubt (n,), why not, "" where it is. proof holds what `shapefit verify` checks, and
    extras the further datasets of a result file, such as `outliers` (n, p) and the datasets of the
    landmarks. A slice or a mask gives the fit of some of the images, a number that of one.
    """

    shapes: Floats
    landmark_names: Names
    items: Names
    sequences: Names | None = None
    landmarks_fitted: Floats | None = None
    coefficients: Floats | None = None
    rotation: Floats | None = None
    translation: Floats | None = None
    scale: Floats | None = None
    objective: Floats | None = None
    relative_gap: Floats | None = None
    iterations: Integers | None = None
    status: NDArray[Any] | None = None
    transforms: Floats | None = None
    mesh_vertices: Floats | None = None
    shape_sd: Floats | None = None
    plausibility: Floats | None = None
    trusted: NDArray[np.bool_] | None = None
    doubt: NDArray[Any] | None = None
    proof: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    failures: Mapping[str, str] = field(default_factory=dict)
    unit: str = UNKNOWN_UNIT
    y_axis: Literal["up", "down"] = "down"
    frame_rate: float | None = None
    attributes: Mapping[str, str | float | int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, images: int | slice | ArrayLike) -> Fit:
        rows = np.atleast_1d(np.arange(len(self))[images])  # type: ignore[index]
        items = {self.items[row] for row in rows}
        failures = {item: text for item, text in self.failures.items() if item in items}
        return fit_of(result_set(self).take(rows), failures)

    def __repr__(self) -> str:
        return describe(self)

    def _repr_html_(self) -> str:
        return embedded_page(result_set(self))

    def view(self, path: str | PathLike[str] | None = None) -> Path:
        """Write the page of the shapes and open it in a browser; return its path."""
        return open_page(result_set(self), path)

    def plot(self, image: int = 0) -> Any:
        """Draw the shape of an image with matplotlib; return the axes."""
        return draw_shape(self, image)

    def to_pandas(self) -> Any:
        """Return a table with a row per landmark and image: item, landmark, x, y, z, and more."""
        return as_table(self)

    def to_xarray(self) -> Any:
        """Return a dataset of positions over (time, space, keypoints, individuals)."""
        return as_dataset(self)


OF_EXTRAS = ("plausibility", "trusted", "doubt")
"""Fields of a Fit that are further datasets of its file."""


def shape_set(given: Shapes | ArrayLike, names: Names | None = None) -> ShapeSet:
    """Return shapes as the package has them; `names` where the shapes do not name landmarks."""
    shapes = given if isinstance(given, Shapes) else Shapes(given)
    return ShapeSet(**_further(_named(_columns(shapes, SHAPES, "shapes"), names)))


def landmark_set(given: Landmarks | ArrayLike, names: Names | None = None) -> LandmarkSet:
    """Return landmarks as the package has them; `names` where they do not name landmarks.

    A landmark with one unknown coordinate is unseen.
    """
    landmarks = given if isinstance(given, Landmarks) else Landmarks(given)
    values = _named(_columns(landmarks, LANDMARKS, "landmarks"), names)
    unseen = np.isnan(values["landmarks"]).any(axis=1, keepdims=True)
    values["landmarks"] = np.where(unseen, np.nan, values["landmarks"])
    return LandmarkSet(**_further(values))


def dictionary_model(given: Dictionary) -> model.Dictionary:
    """Return a dictionary as the package has it."""
    values = _columns(given, DICTIONARY, "dictionary")
    for name in ("landmark_names", "atom_items"):
        values[name] = None if values[name] is None else tuple(values[name])
    return model.Dictionary(**values)


def result_set(given: Fit | Shapes | ArrayLike, names: Names | None = None) -> ResultSet:
    """Return a fit, or shapes that come from elsewhere, as the package has results."""
    if not isinstance(given, Fit):
        shapes = shape_set(given, names)
        own = ("landmark_names", "items", "sequences", "unit", "frame_rate", "of_file")
        columns = {"shapes": shapes.shapes, **shapes.further}
        return ResultSet(**{name: getattr(shapes, name) for name in own}, columns=columns)
    values = _columns(given, RESULTS, "result")
    proof, columns = values.pop("proof"), dict(values.pop("extras"))
    del values["failures"]
    apart = {name: values.pop(name) for name in OF_EXTRAS}
    columns |= {name: value for name, value in apart.items() if value is not None}
    for dataset in PROOF:
        if (value := proof.get(dataset.name)) is not None:
            values[dataset.attribute] = _turned(value) if dataset.points else value
    return ResultSet(**values, columns=columns)


def _further(values: dict[str, Any]) -> dict[str, Any]:
    """Return fields as records take them, the further datasets among the columns."""
    given = values.pop("extras")
    names = free_names(given, {"item", "sequence", "landmark_names", *values})
    return {**values, "columns": {names[name]: data for name, data in given.items()}}


def rows_of(
    record: ShapeSet | LandmarkSet | ResultSet | model.Dictionary,
    kind: type[Kind],
    form: Layout,
    **more: Any,
) -> Kind:
    """Return a record of the package with one landmark per row, as a `kind`, with `more` fields."""
    names = {entry.name for entry in fields(kind)}
    values = {name: getattr(record, name) for name in names if hasattr(record, name)}
    values |= {"extras": record.further} if isinstance(record, Records) else {}
    for dataset in form.datasets:
        if dataset.points and values.get(dataset.attribute) is not None:
            values[dataset.attribute] = _turned(values[dataset.attribute])
    return kind(**values | more)


def fit_of(record: ResultSet, failures: Mapping[str, str]) -> Fit:
    """Return a result as the caller gets it."""
    apart = {name: record.per_item(name) for name in OF_EXTRAS}
    kept = {name: values for name, values in record.further.items() if name not in apart}
    proof = {
        dataset.name: _turned(value) if dataset.points else value
        for dataset in PROOF
        if (value := getattr(record, dataset.attribute)) is not None
    }
    return rows_of(record, Fit, RESULTS, **apart, extras=kept, failures=dict(failures), proof=proof)


def _turned(values: NDArray[Any]) -> NDArray[Any]:
    """Exchange the last two axes, in the memory layout that files are read to."""
    return np.ascontiguousarray(np.swapaxes(values, -1, -2))


def _columns(given: Any, form: Layout, place: str) -> dict[str, Any]:
    """Return the fields of a record with one landmark per column.

    Raises InputError for arrays that are no numbers or whose axes disagree.
    """
    values = {entry.name: getattr(given, entry.name) for entry in fields(given)}
    sizes: dict[str, int] = {}
    # The points say how many items and landmarks there are, and the rest must agree.
    for dataset in sorted(form.datasets, key=lambda dataset: not dataset.points):
        value = values.get(dataset.attribute)
        if value is None or dataset.kind == "label":
            continue
        name = dataset.attribute
        where = name if name == place else f"{place}.{name}"
        if dataset.kind == "text":
            value = tuple(map(str, value))
            shape: tuple[int, ...] = (len(value),)
        else:
            value = _numbers(value, dataset.kind, where)
            shape = value.shape
        expected = tuple(sizes.get(str(axis), axis) for axis in dataset.axes)
        if not fit_axes(dataset.axes, shape, sizes):
            axes = f"({', '.join(map(str, expected))}{',' * (len(expected) == 1)})"
            row = ", one landmark per row" if dataset.points else ""
            raise input_error(where, f"has the shape {shape}", f"it must be {axes}{row}")
        values[name] = _turned(np.asarray(value)) if dataset.points else value
    return values


def _numbers(value: ArrayLike, kind: str, place: str) -> NDArray[Any]:
    try:
        return np.ascontiguousarray(value, np.int64 if kind == "index" else np.float64)
    except (TypeError, ValueError):
        raise input_error(place, "is no array of numbers", "give numbers") from None


def _named(values: dict[str, Any], names: Names | None) -> dict[str, Any]:
    """Fill in the names of landmarks and items where the caller gave none."""
    points = values["shapes"] if "shapes" in values else values["landmarks"]
    if values["landmark_names"] is None:
        place = "shapes" if "shapes" in values else "landmarks"
        found = tuple(names) if names is not None else tuple(map(str, range(points.shape[-1])))
        if len(found) != points.shape[-1]:
            raise input_error(
                place,
                f"has {points.shape[-1]} landmarks without names, not {len(found)}",
                f"name them: {place.title()}({place}, landmark_names=[...])",
            )
        values["landmark_names"] = found
    if values["items"] is None:
        values["items"] = tuple(map(str, range(len(points))))
    return values
