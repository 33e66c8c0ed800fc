"""A dictionary with one landmark per row, as in files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import overload

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.dictionary import model
from shapefit.dictionary.mixture import Mixture
from shapefit.errors import counted, input_error
from shapefit.io.layout import DICTIONARY_COLUMNS, DICTIONARY_POINTS
from shapefit.records.columns import Array, Column, Texts, as_kind, match_axes
from shapefit.records.items import UNKNOWN_UNIT
from shapefit.records.names import all_composed


@dataclass(frozen=True, repr=False, eq=False)
class Dictionary:
    """k atoms of p landmarks, which a fit mixes and turns.

    Attributes
    ----------
    atoms : array of shape (k, p, 3)
        Centred, with a mean standard deviation over x, y and z of about 1.
    landmark_names : tuple of str, of length p
        By default 0, 1, ...
    mean_shape : array of shape (p, 3)
        By default the mean of the atoms.
    edges : array of shape (e, 2)
        Landmarks that a line joins, by position.
    mesh_vertices, mesh_faces : arrays of shape (k, q, 3) and (f, 3)
        A mesh of each atom.
    atom_scale : array of shape (k,)
        Atom i measures `atom_scale[i] * atoms[i]` in `unit`.
    atom_items : tuple of str, of length k
        The training shape that each atom is.
    unit : str
        Unit of the training shapes.
    prior : Mixture
        The prior over shapes that `learn` or `read_dictionary` gives.
    learned : mapping
        What was learned besides, see the files of dictionaries.
    provenance : mapping of str to str
        How it was made.

    """

    atoms: Floats
    landmark_names: Texts = ()
    mean_shape: Floats = None  # type: ignore[assignment]  # the mean, once it is made
    edges: Integers | None = None
    mesh_vertices: Floats | None = None
    mesh_faces: Integers | None = None
    atom_scale: Floats | None = None
    atom_items: Sequence[str] | None = None
    unit: str = UNKNOWN_UNIT
    prior: Mixture | None = None
    learned: Mapping[str, object] = field(default_factory=dict)
    provenance: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        sizes: dict[str, int] = {}
        for column in _OWN_COLUMNS:
            value = getattr(self, column.field)
            if value is not None and not (column.is_text and not len(value)):
                set_field(self, column.field, _convert_field(column, value, sizes))
        if not self.landmark_names:
            names = tuple(map(str, range(self.atoms.shape[1])))
            set_field(self, "landmark_names", names)
        if self.mean_shape is None:
            set_field(self, "mean_shape", self.atoms.mean(axis=0))

    def __repr__(self) -> str:
        k, p, _ = self.atoms.shape
        parts = [counted(k, "atom"), counted(p, "landmark")]
        if self.prior is not None:
            components = counted(len(self.prior.weights), "component")
            parts.append(f"a prior of {components}")
        if self.mesh_faces is not None:
            parts.append("meshes")
        return f"<shapefit.Dictionary: {', '.join(parts)}, in {self.unit}>"

    @classmethod
    def of(cls, dictionary: model.Dictionary) -> Dictionary:
        """Return the internal `model.Dictionary` as one with a landmark per row."""
        return cls(
            atoms=_transpose_points(dictionary.atoms),
            landmark_names=dictionary.landmark_names,
            mean_shape=_transpose_points(dictionary.mean_shape),
            edges=dictionary.edges,
            mesh_vertices=_transpose_points(dictionary.mesh_vertices),
            mesh_faces=dictionary.mesh_faces,
            atom_scale=dictionary.atom_scale,
            atom_items=dictionary.atom_items,
            unit=dictionary.unit,
            prior=dictionary.prior,
            learned={name: getattr(dictionary, name) for name in _LEARNED},
            provenance=dictionary.provenance,
        )

    def model(self) -> model.Dictionary:
        """Return the internal `model.Dictionary`, with one landmark per column."""
        atom_items = self.atom_items
        return model.Dictionary(
            atoms=_transpose_points(self.atoms),
            landmark_names=all_composed(self.landmark_names),
            mean_shape=_transpose_points(self.mean_shape),
            edges=self.edges,
            mesh_vertices=_transpose_points(self.mesh_vertices),
            mesh_faces=self.mesh_faces,
            atom_scale=self.atom_scale,
            atom_items=None if atom_items is None else tuple(atom_items),
            unit=self.unit,
            prior=self.prior,
            provenance=self.provenance,
            **self.learned,  # type: ignore[arg-type]  # what `of` took from one
        )

    def replaced(self, **changes: object) -> Dictionary:
        """Return the dictionary with these fields changed."""
        return replace(self, **changes)  # type: ignore[arg-type]


_OWN = {own.name for own in fields(Dictionary)}

_LEARNED = tuple(one.name for one in fields(model.Dictionary) if one.name not in _OWN)
"""Fields of the internal Dictionary that are `learned`."""

_OWN_COLUMNS = sorted(
    (column for column in DICTIONARY_COLUMNS if column.field in _OWN),
    key=lambda column: column.name not in DICTIONARY_POINTS,
)
"""The atoms first: they say how many landmarks there are, and the rest must agree."""


@overload
def _transpose_points(points: Floats) -> Floats: ...
@overload
def _transpose_points(points: None) -> None: ...
def _transpose_points(points: Floats | None) -> Floats | None:
    """Return points with landmarks in rows instead of columns, or vice versa."""
    if points is None:
        return None
    return np.ascontiguousarray(np.swapaxes(points, -1, -2))


def _convert_field(
    column: Column, value: object, sizes: dict[str, int]
) -> Array | Texts:
    """Convert a field to the type of its column, and check its axes against `sizes`.

    The axes that are new are added to `sizes`. Raises InputError for arrays that are no
    numbers or whose axes disagree.
    """
    place = f"dictionary.{column.field}"
    try:
        converted = as_kind(column, value)
    except (TypeError, ValueError):
        raise input_error(place, "is no array of numbers", "give numbers") from None
    shape = np.shape(converted)
    expected = tuple(sizes.get(str(axis), axis) for axis in column.axes)
    if not match_axes(column.axes, shape, sizes):
        row = ", one landmark per row" if column.name in DICTIONARY_POINTS else ""
        fix = f"it must be {expected}".replace("'", "") + row
        raise input_error(place, f"has the shape {shape}", fix)
    return converted
