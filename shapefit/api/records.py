"""Shapes, landmarks, dictionaries and fits: dataclasses with one landmark per row, as
in files.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
from shapefit.io.options import OutputOptions
from shapefit.io.records import LandmarkSet, Records, ResultSet, ShapeSet
from shapefit.io.skeletons import skeletons_of_size
from shapefit.io.writers.motion import find_motions
from shapefit.io.writers.tables import metres_columns
from shapefit.pipelines.result import Note
from shapefit.timeline import JITTER

if TYPE_CHECKING:
    from shapefit.geometry.cameras import Up

Names = Sequence[str]
NOT_COLUMNS = (
    "landmark_names",
    "items",
    "sequences",
    "unit",
    "y_axis",
    "frame_rate",
    "attributes",
)


class _Items:
    """What sets of n items have in common; RECORD is how the package holds them."""

    RECORD: ClassVar[type[Records]]
    landmark_names: Any
    items: Any
    unit: str
    extras: Any

    def __post_init__(self) -> None:
        self.__dict__.update(_checked(vars(self), self.RECORD.LAYOUT))

    @classmethod
    def of(cls, record: Any, **further: Any) -> Self:
        """Return a record of the package with one landmark per row."""
        names = {field.name for field in fields(cls)}  # type: ignore[arg-type]
        columns = _transposed(record.columns, record.LAYOUT)
        values = {
            name: getattr(record, name) for name in names.intersection(NOT_COLUMNS)
        }
        values |= {name: columns.pop(name) for name in names & columns.keys()}
        return cls(**values, **further, extras=columns)  # type: ignore[call-arg]

    def record(self, names: Names | None = None) -> Any:
        """Return the record of the package; `names` where the landmarks have none.

        Items without names are numbered. Raises InputError where the names are too few
        or many.
        """
        layout, given = (
            self.RECORD.LAYOUT,
            {k: v for k, v in vars(self).items() if v is not None},
        )
        n, p = given[layout.points].shape[:2]
        plain: dict[str, Any] = {"items": tuple(map(str, range(n)))}
        plain["landmark_names"] = names or tuple(map(str, range(p)))
        plain |= {name: given[name] for name in NOT_COLUMNS if name in given}
        if len(plain["landmark_names"]) != p:
            raise unnamed(layout.points, p, plain["landmark_names"])
        columns = {
            k: v for k, v in given.items() if k in layout.all and k not in NOT_COLUMNS
        }
        free = free_names(self.extras, {"item", "sequence", "landmark_names", *columns})
        extras = {free[name]: np.asarray(value) for name, value in self.extras.items()}
        whole = {
            name: v
            for name, v in extras.items()
            if v.shape[:1] != (n,) and name not in layout.datasets
        }
        columns = {k: v for k, v in extras.items() if k not in whole} | columns
        columns, whole = _transposed(columns, layout), _transposed(whole, layout)
        return self.RECORD(**plain, columns=columns, whole=whole)

    def __len__(self) -> int:
        return len(getattr(self, self.RECORD.LAYOUT.points))

    def __getitem__(self, rows: int | slice | ArrayLike) -> Self:
        numbers = np.atleast_1d(np.arange(len(self))[rows])  # type: ignore[index]
        part = self.of(self.record().take(numbers))
        return (
            part
            if self.landmark_names is not None
            else part.replaced(landmark_names=None)
        )

    def __repr__(self) -> str:
        parts = [counted(len(self), "item")]
        parts.append(
            counted(getattr(self, self.RECORD.LAYOUT.points).shape[1], "landmark")
        )
        return f"<shapefit.{type(self).__name__}: {', '.join(parts)}, in {self.unit}>"

    def replaced(self, **changes: Any) -> Self:
        """Return the same with other fields; None leaves one out."""
        return replace(self, **changes)  # type: ignore[type-var]


@dataclass(frozen=True, repr=False, eq=False)
class Shapes(_Items):
    """n shapes of p landmarks: shapes (n, p, 3) in `unit`.

    items name the shapes, by default 0, 1, ...; sequences (n) the clip or group of
    each; edges (e, 2) are pairs of landmarks; mesh_vertices (n, q, 3) and mesh_faces
    (f, 3) a mesh; frame_rate of the sequences in Hz; extras are further datasets. A
    slice or a mask gives some of them.
    """

    RECORD = ShapeSet

    shapes: Any
    landmark_names: Names | None = None
    items: Names | None = None
    sequences: Names | None = None
    edges: Any = None
    mesh_vertices: Any = None
    mesh_faces: Any = None
    unit: str = UNKNOWN_UNIT
    frame_rate: float | None = None
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, repr=False, eq=False)
class Landmarks(_Items):
    """n images of p landmarks: landmarks (n, p, 2) in `unit`, NaN where unseen.

    confidence (n, p) >= 0 weights the landmarks, 0 = hidden; None is 1 for all. items
    name the images, by default 0, 1, ...; sequences (n) the clip of each; y_axis is
    where y points, down as pixels are counted; extras are further datasets, such as
    `true_rotation` (n, 3, 3) or `camera_matrix` (3, 3). A slice or a mask gives some of
    them.
    """

    RECORD = LandmarkSet

    landmarks: Any
    landmark_names: Names | None = None
    confidence: Any = None
    items: Names | None = None
    sequences: Names | None = None
    unit: str = UNKNOWN_UNIT
    y_axis: Literal["up", "down"] = "down"
    frame_rate: float | None = None
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)


def to_metres(
    fit: Fit,
    *,
    height: float | None = None,
    unit: str | None = None,
    up: Up | None = None,
) -> np.recarray[Any, Any]:
    """Return joints in metres: a row per frame and landmark, as `convert -o
    x.metres.csv` writes.

    Columns: frame, time (s, or frames without a frame rate), landmark, x, y, z, sd of
    the distance to the point, trusted, sequence; nan in gaps. height of the body in
    metres, by default that of the fit; unit and up as of `convert`. Raises InputError
    where nothing says how large the shapes are.
    """
    height = stated_height(fit) if height is None else height
    options = OutputOptions(height=height, unit=unit, up=up)
    motions = find_motions(fit.record(), options, "Fit.to_metres")
    warn(dict.fromkeys(text for motion in motions for text in motion.warnings))
    parts = []
    for motion in motions:
        columns = metres_columns(motion)
        columns["trusted"] = [answer == "true" for answer in columns["trusted"]]
        parts.append(columns | {"sequence": [motion.name] * len(columns["x"])})
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    kinds = [(name, array.dtype) for name, array in arrays.items()]
    return np.rec.fromarrays([*arrays.values()], dtype=kinds)


def stated_height(fit: Fit) -> float | None:
    """Return the height in metres that a fit was given."""
    height: float | None = json.loads(str(fit.attributes.get("config", "{}"))).get(
        "height"
    )
    return height


def to_pandas(fit: Fit) -> Any:
    """Return a pandas.DataFrame with a row per landmark and image: item, landmark, x,
    y, z, more.

    time is in s where the frame rate is known or times are, else in frames.
    """
    import pandas  # type: ignore[import-untyped]

    n, p = len(fit), fit.shapes.shape[1]
    columns: dict[str, Any] = {
        "item": np.repeat(np.array(fit.items, dtype=object), p),
        "landmark": np.tile(np.array(fit.landmark_names, dtype=object), n),
    }
    columns |= dict(zip("xyz", fit.shapes.reshape(n * p, 3).T, strict=True))
    if fit.shape_sd is not None:
        deviations = fit.shape_sd.reshape(n * p, 3).T
        columns |= dict(zip(("sd_x", "sd_y", "sd_z"), deviations, strict=True))
    frames, stated = fit.extras.get("frame"), fit.extras.get("time")
    times = stated
    if frames is not None:
        rate = fit.frame_rate or 1.0
        times = np.asarray(frames) / rate
        if stated is not None:
            times = np.where(np.abs(stated - times) * rate > JITTER, stated, times)
    per_image = {
        "frame": frames,
        "time": times,
        "sequence": fit.sequences,
        "trusted": fit.trusted,
        "reasons": fit.reasons,
    }
    columns |= {name: np.repeat(v, p) for name, v in per_image.items() if v is not None}
    return pandas.DataFrame(columns)


def warn(messages: Iterable[object], level: int = 3) -> None:
    """Issue a Python warning for each message, at the caller of the function; notes are
    none.
    """
    for message in messages:
        if not isinstance(message, Note):
            warnings.warn(str(message), stacklevel=level)


@dataclass(frozen=True, repr=False, eq=False)
class Fit(_Items):
    """3D shapes of n images: shapes (n, p, 3) in the camera frame and the unit of the
    landmarks.

    NaN where an image failed; failures says why, by item. landmarks_fitted (n, p, 2)
    under perspective; coefficients (n, k); rotation (n, 3, 3); translation (n, 2);
    scale, objective, relative_gap, iterations, status (n); shape_sd (n, p, 3), the
    standard deviation of each coordinate; p_value (n,); trusted (n,), and reasons (n,)
    why not, "" where it is. None is what the method does not know. extras holds the
    further datasets of a result file, such as `outliers` (n, p) and the datasets of the
    landmarks; attributes, how it was made. A slice or a mask gives the fit of some of
    the images, a number that of one.
    """

    RECORD = ResultSet

    shapes: Any
    landmark_names: Names | None = None
    items: Names | None = None
    sequences: Names | None = None
    unit: str = UNKNOWN_UNIT
    y_axis: Literal["up", "down"] = "down"
    frame_rate: float | None = None
    landmarks_fitted: Any = None
    coefficients: Any = None
    rotation: Any = None
    translation: Any = None
    scale: Any = None
    objective: Any = None
    relative_gap: Any = None
    iterations: Any = None
    status: Any = None
    shape_sd: Any = None
    p_value: Any = None
    trusted: Any = None
    reasons: Any = None
    failures: Mapping[str, str] = field(default_factory=dict)
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    attributes: Mapping[str, Any] = field(default_factory=dict)

    to_metres = to_metres
    to_pandas = to_pandas
    metres = property(to_metres)

    def __getitem__(self, rows: int | slice | ArrayLike) -> Fit:
        part = super().__getitem__(rows)
        failures = {
            item: self.failures[item]
            for item in part.items or ()
            if item in self.failures
        }
        return part.replaced(failures=failures)

    def __repr__(self) -> str:
        parts = [counted(len(self), "image"), counted(self.shapes.shape[1], "landmark")]
        parts += (
            [f"method {self.attributes['method']}"]
            if "method" in self.attributes
            else []
        )
        parts += [f"{len(self.failures)} failed"] if self.failures else []
        parts += (
            [] if self.trusted is None else [f"{int(np.sum(self.trusted))} trusted"]
        )
        return f"<shapefit.Fit: {', '.join(parts)}, in {self.unit}>"


@dataclass(frozen=True, repr=False, eq=False)
class Dictionary:
    """k atoms: atoms (k, p, 3), centred and on the scale of normalised shapes.

    landmark_names are by default 0, 1, ..., mean_shape (p, 3) is the mean of the atoms.
    prior is the mixture over shapes that `learn` or `read_dictionary` gives, learned
    what was learned besides (docs/files.md), provenance how it was made.
    """

    atoms: Any
    landmark_names: Names | None = None
    mean_shape: Any = None
    edges: Any = None
    mesh_vertices: Any = None
    mesh_faces: Any = None
    atom_scale: Any = None
    atom_items: Names | None = None
    unit: str = UNKNOWN_UNIT
    prior: Any = None
    learned: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        values = _checked(vars(self), DICTIONARY, "dictionary.")
        if values["landmark_names"] is None:
            values["landmark_names"] = tuple(map(str, range(values["atoms"].shape[1])))
        if values["mean_shape"] is None:
            values["mean_shape"] = values["atoms"].mean(axis=0)
        self.__dict__.update(values)

    @classmethod
    def of(cls, dictionary: model.Dictionary) -> Dictionary:
        """Return a dictionary of the package with one landmark per row."""
        values = {
            field.name: getattr(dictionary, field.name) for field in fields(dictionary)
        }
        learned = _transposed(values, DICTIONARY)
        names = {field.name for field in fields(cls)}
        return cls(
            **{name: learned.pop(name) for name in names & learned.keys()},
            learned=learned,
        )

    def model(self) -> model.Dictionary:
        """Return the dictionary of the package."""
        values = {
            name: value for name, value in vars(self).items() if name != "learned"
        }
        return model.Dictionary(**_transposed(values, DICTIONARY), **self.learned)

    def replaced(self, **changes: Any) -> Dictionary:
        """Return the same with other fields."""
        return replace(self, **changes)


def unnamed(dataset: str, p: int, names: Names) -> InputError:
    """Return the error of p landmarks without names that are not as many as these."""
    skeletons = skeletons_of_size(p) if dataset == LANDMARKS.points else ()
    fix = f"name them: {dataset.title()}({dataset}, landmark_names=[...])"
    if skeletons:
        fix = f"name them, as in {listed(f'`keypoints={name}`' for name in skeletons)}"
    return input_error(
        dataset, f"has {p} landmarks without names, not {len(names)}", fix
    )


def _transposed(columns: Mapping[str, Any], layout: Layout) -> dict[str, Any]:
    """Return columns with one landmark per row for one per column, and the other way
    round.
    """
    points = {
        name for name, column in layout.datasets.items() if column.kind == "points"
    }
    return {
        name: (
            np.ascontiguousarray(np.swapaxes(values, -1, -2))
            if name in points and values is not None
            else values
        )
        for name, values in columns.items()
    }


def _checked(
    given: Mapping[str, Any], layout: Layout, prefix: str = ""
) -> dict[str, Any]:
    """Return fields as arrays, and names as tuples.

    Raises InputError for arrays that are no numbers or whose axes disagree.
    """
    values, sizes = dict(given), dict[str, int]()
    # The points say how many items and landmarks there are, and the rest must agree.
    for key, column in sorted(
        layout.datasets.items(), key=lambda item: item[1].kind != "points"
    ):
        name = FIELDS.get(key, key)
        if values.get(name) is None or key == "status":
            continue
        where = (
            f"{prefix}{name}"
            if prefix or name == layout.points
            else f"{layout.points}.{name}"
        )
        try:
            if column.kind == "text":
                values[name] = tuple(map(str, values[name]))
            else:
                kind = np.int64 if column.kind == "index" else np.float64
                values[name] = np.asarray(values[name], kind)
        except (TypeError, ValueError):
            raise input_error(where, "is no array of numbers", "give numbers") from None
        shape, expected = (
            np.shape(values[name]),
            tuple(sizes.get(str(a), a) for a in column.axes),
        )
        if not fit_axes(column.axes, shape, sizes):
            axes = str(expected).replace("'", "")
            row = ", one landmark per row" if column.kind == "points" else ""
            raise input_error(
                where, f"has the shape {shape}", f"it must be {axes}{row}"
            )
    return values
