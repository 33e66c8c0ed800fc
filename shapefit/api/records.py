"""Shapes, landmarks, dictionaries and fits with one landmark per row, as files have them.

Inside the package a point is a column, (..., 3, p); here and in files it is a row, (..., p, 3).
Each of them is a view: it holds the package's own record and turns what it gives out.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import fields
from types import MappingProxyType
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shapefit.api import shown
from shapefit.dictionary import model
from shapefit.errors import InputError, counted, input_error, listed
from shapefit.io.layout import (
    DICTIONARY,
    FIELDS,
    LANDMARKS,
    UNKNOWN_UNIT,
    Layout,
    fit_axes,
    free_names,
)
from shapefit.io.records import LandmarkSet, Records, ResultSet, ShapeSet
from shapefit.io.skeletons import skeletons_of_size

Names = Sequence[str]
OF_RECORDS = ("landmark_names", "items", "sequences", "unit", "y_axis", "frame_rate", "attributes")


class _View:
    """What the package holds with one landmark per column, given out with one per row."""

    _LAYOUT: ClassVar[Layout]
    _FIELDS: ClassVar[Collection[str]]
    _inside: Any

    @classmethod
    def of(cls, inside: Any) -> Self:
        """Return the view of a record of the package."""
        view = cls.__new__(cls)
        view._inside = inside
        return view

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in self._FIELDS:
            raise AttributeError(f"{type(self).__name__} has no {name}")
        value = getattr(self._inside, name)
        dataset = self._LAYOUT.datasets.get(name)
        turned = dataset is not None and dataset.points and value is not None
        return np.swapaxes(value, -1, -2) if turned else value

    def __dir__(self) -> Iterable[str]:
        return {*super().__dir__(), *self._FIELDS}


class _Items(_View):
    """A view of n items."""

    _RECORD: ClassVar[type[Records]]
    _inside: Records
    _unnamed: bool = False
    _without_items: bool = False

    def __init_subclass__(cls) -> None:
        cls._LAYOUT = cls._RECORD.LAYOUT
        cls._FIELDS = (*cls._LAYOUT.all, *OF_RECORDS)

    def _take(self, given: Mapping[str, Any]) -> Self:
        """Take what a caller gives, names of landmarks and items filled in."""
        values = _in_columns(given, self._LAYOUT)
        place = self._LAYOUT.points
        extras = values.pop("extras", None) or {}
        names = free_names(extras, {"item", "sequence", "landmark_names", *values})
        columns = {names[name]: data for name, data in extras.items()}
        self._unnamed = values.get("landmark_names") is None
        self._without_items = values.get("items") is None
        for name, axis in (("landmark_names", -1), ("items", 0)):
            if values.get(name) is None:
                values[name] = tuple(map(str, range(values[place].shape[axis])))
        n = len(values["items"])
        whole = {name: v for name, v in columns.items() if np.shape(v)[:1] != (n,)}
        per_item = {name: v for name, v in columns.items() if name not in whole}
        self._inside = self._RECORD(**values, columns=per_item, whole=whole)
        return self

    def __len__(self) -> int:
        return len(self._inside)

    def __getitem__(self, rows: int | slice | ArrayLike) -> Self:
        numbers = np.atleast_1d(np.arange(len(self))[rows])  # type: ignore[index]
        part = self.of(self._inside.take(numbers))
        part.__dict__ = self.__dict__ | part.__dict__
        return part

    def __repr__(self) -> str:
        parts = (counted(len(self), "item"), counted(len(self.landmark_names), "landmark"))
        return f"<shapefit.{type(self).__name__}: {', '.join(parts)}, in {self.unit}>"

    @property
    def extras(self) -> dict[str, NDArray[Any]]:
        """Further datasets, as they stand in a file."""
        return self._inside.further

    def replaced(self, **changes: Any) -> Self:
        """Return the same with other fields, given as to the constructor; None leaves one out."""
        datasets = self._LAYOUT.names & self._inside.columns.keys()
        own = {name: getattr(self, name) for name in (*datasets, *OF_RECORDS)}
        own |= {"extras": self.extras} | ({"landmark_names": None} if self._unnamed else {})
        return type(self).__new__(type(self))._take(own | changes)


class Shapes(_Items):
    """n shapes of p landmarks: shapes (n, p, 3) in `unit`.

    items name the shapes, by default 0, 1, ...; sequences (n) the clip or group of each; edges
    (e, 2) are pairs of landmarks; mesh_vertices (n, q, 3) and mesh_faces (f, 3) a mesh; frame_rate
    is that of a sequence, in Hz; extras are further datasets. A slice or a mask gives some of them.
    """

    _RECORD = ShapeSet

    def __init__(
        self,
        shapes: ArrayLike,
        landmark_names: Names | None = None,
        items: Names | None = None,
        sequences: Names | None = None,
        edges: ArrayLike | None = None,
        mesh_vertices: ArrayLike | None = None,
        mesh_faces: ArrayLike | None = None,
        unit: str = UNKNOWN_UNIT,
        frame_rate: float | None = None,
        extras: Mapping[str, NDArray[Any]] | None = None,
    ) -> None:
        self._take({name: value for name, value in locals().items() if name != "self"})


class Landmarks(_Items):
    """n images of p landmarks: landmarks (n, p, 2) in `unit`, NaN where unseen.

    confidence (n, p) >= 0 weights the landmarks, 0 = hidden; None is 1 for all. items name the
    images, by default 0, 1, ...; sequences (n) the clip of each; y_axis is where y points, down as
    pixels are counted; extras are further datasets, such as `true_rotation` (n, 3, 3) or
    `camera_matrix` (3, 3). A slice or a mask gives some of them.
    """

    _RECORD = LandmarkSet

    def __init__(
        self,
        landmarks: ArrayLike,
        landmark_names: Names | None = None,
        confidence: ArrayLike | None = None,
        items: Names | None = None,
        sequences: Names | None = None,
        unit: str = UNKNOWN_UNIT,
        y_axis: Literal["up", "down"] = "down",
        frame_rate: float | None = None,
        extras: Mapping[str, NDArray[Any]] | None = None,
    ) -> None:
        self._take({name: value for name, value in locals().items() if name != "self"})


class Dictionary(_View):
    """k atoms: atoms (k, p, 3), centred and on the scale of normalised shapes.

    Fields: landmark_names, by default 0, 1, ...; mean_shape (p, 3), by default that of the atoms;
    others of a dictionary file (docs/files.md). prior is the mixture over shapes that `learn` or
    `read_dictionary` gives.
    """

    _LAYOUT = DICTIONARY
    _FIELDS = tuple(field.name for field in fields(model.Dictionary))
    _inside: model.Dictionary

    def __init__(
        self,
        *,
        atoms: ArrayLike,
        landmark_names: Names | None = None,
        mean_shape: ArrayLike | None = None,
        **further: Any,
    ) -> None:
        own = {"atoms": atoms, "landmark_names": landmark_names, "mean_shape": mean_shape}
        if unknown := further.keys() - set(self._FIELDS):
            raise TypeError(f"a dictionary has no {', '.join(sorted(unknown))}")
        values = _in_columns(own | further, DICTIONARY, "dictionary.")
        if landmark_names is None:
            values["landmark_names"] = tuple(map(str, range(values["atoms"].shape[2])))
        if mean_shape is None:
            values["mean_shape"] = values["atoms"].mean(axis=0)
        self._inside = model.Dictionary(**values)

    def __repr__(self) -> str:
        size = counted(self._inside.k, "atom"), counted(len(self.landmark_names), "landmark")
        return f"<shapefit.Dictionary: {', '.join(size)}, in {self.unit}>"

    def replaced(self, **changes: Any) -> Dictionary:
        """Return the same with other fields."""
        return Dictionary(**{name: getattr(self, name) for name in self._FIELDS} | changes)


class Fit(_Items):
    """3D shapes of n images: shapes (n, p, 3) in the camera frame and the unit of the landmarks.

    NaN where an image failed; failures says why, by item. landmarks_fitted (n, p, 2);
    coefficients (n, k); rotation (n, 3, 3); translation (n, 2); scale, objective, relative_gap,
    iterations, status (n). None is what the method does not know: of these, and of shape_sd
    (n, p, 3), the standard deviation of each coordinate, plausibility (n,), trusted (n,) and
    doubt (n,), why not, "" where it is. extras holds the further datasets of a result file, such as
    `outliers` (n, p) and the datasets of the landmarks. A slice or a mask gives the fit of some of
    the images, a number that of one.
    """

    _RECORD = ResultSet
    _inside: ResultSet
    _failures: Mapping[str, str] = MappingProxyType({})

    def __init__(self, **given: Any) -> None:
        self._take(given)

    @property
    def failures(self) -> dict[str, str]:
        """Why images have no shape, by item."""
        own = set(self.items)
        return {item: text for item, text in self._failures.items() if item in own}

    __repr__ = shown.describe
    _repr_html_ = shown.embedded_page
    view = shown.open_page
    plot = shown.draw_shape
    metres = property(shown.as_metres)
    to_metres = shown.as_metres
    to_pandas = shown.as_table


def fit_of(record: ResultSet, failures: Mapping[str, str]) -> Fit:
    """Return a result as the caller gets it."""
    found = Fit.of(record)
    found._failures = dict(failures)
    return found


def shape_set(given: Shapes | ArrayLike, names: Names | None = None) -> ShapeSet:
    """Return shapes as the package has them; `names` where the shapes do not name landmarks."""
    found: ShapeSet = _named(given if isinstance(given, Shapes) else Shapes(given), names)
    return found


def landmark_set(given: Landmarks | ArrayLike, names: Names | None = None) -> LandmarkSet:
    """Return landmarks as the package has them; `names` where they do not name landmarks.

    A landmark with one unknown coordinate is unseen.
    """
    landmarks = given if isinstance(given, Landmarks) else Landmarks(given)
    found: LandmarkSet = _named(landmarks, names).with_whole_points()
    return found


def result_set(given: Fit | Shapes | ArrayLike, names: Names | None = None) -> ResultSet:
    """Return a fit, or shapes that come from elsewhere, as the package has results."""
    if isinstance(given, Fit):
        return given._inside
    shapes = shape_set(given, names)
    own = ("landmark_names", "items", "sequences", "unit", "frame_rate", "whole")
    per_item = {name: v for name, v in shapes.per_item.items() if name != "mesh_vertices"}
    fields = {name: getattr(shapes, name) for name in own}
    fields["whole"] = {name: v for name, v in shapes.whole.items() if name in shapes.further}
    return ResultSet(**fields, columns=per_item)


def _named(view: _Items, names: Names | None) -> Any:
    """Return the record of a view, with these names of landmarks where the caller gave none."""
    if names is None or not view._unnamed:
        return view._inside
    place, p = view._LAYOUT.points, len(view.landmark_names)
    if len(names) != p:
        raise unnamed(place, p, names)
    return view._inside.replaced(landmark_names=tuple(names))


def unnamed(place: str, p: int, names: Names) -> InputError:
    """Return the error of p landmarks without names that are not as many as these."""
    skeletons = skeletons_of_size(p)
    fix = f"name them: {place.title()}({place}, landmark_names=[...])"
    if skeletons and place == LANDMARKS.points:
        fix = f"name them, as in {listed(f'`keypoints={name}`' for name in skeletons)}"
    return input_error(place, f"has {p} landmarks without names, not {len(names)}", fix)


def _in_columns(given: Mapping[str, Any], layout: Layout, place: str = "") -> dict[str, Any]:
    """Return fields with one landmark per column.

    Raises InputError for arrays that are no numbers or whose axes disagree.
    """
    values = dict(given)
    sizes: dict[str, int] = {}
    own = layout.points
    # The points say how many items and landmarks there are, and the rest must agree.
    for key, dataset in sorted(layout.datasets.items(), key=lambda item: not item[1].points):
        name = FIELDS.get(key, key)
        value = values.get(name)
        if value is None or dataset.kind == "label":
            continue
        where = f"{place}{name}" if place or name == own else f"{own}.{name}"
        if dataset.kind == "text":
            value = tuple(map(str, value))
            shape: tuple[int, ...] = (len(value),)
        else:
            try:
                kind = np.int64 if dataset.kind == "index" else np.float64
                value = np.asarray(value, kind)
            except (TypeError, ValueError):
                raise input_error(where, "is no array of numbers", "give numbers") from None
            shape = value.shape
        expected = tuple(sizes.get(str(axis), axis) for axis in dataset.axes)
        if not fit_axes(dataset.axes, shape, sizes):
            axes = f"({', '.join(map(str, expected))}{',' * (len(expected) == 1)})"
            row = ", one landmark per row" if dataset.points else ""
            raise input_error(where, f"has the shape {shape}", f"it must be {axes}{row}")
        turned = np.swapaxes(value, -1, -2) if dataset.points else value
        values[name] = value if dataset.kind == "text" else np.ascontiguousarray(turned)
    return values
