"""Groups of images that were lifted apart, with fewer atoms or all, become one lifting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.convex.transforms import Transforms
from shapefit.lifting.lift import Lifting

Indices = NDArray[np.integer]

# What has an axis of atoms, after that of the images; an atom that a group lacked had no part: 0.
PER_ATOM = ("coefficients",)


@dataclass(frozen=True)
class Group:
    """The lifting of some of the images with some of the atoms.

    images (m,) and atoms (j,): which of all images and of all atoms its axes run over.
    """

    lifting: Lifting
    images: Indices
    atoms: Indices


def merge(groups: Sequence[Group], atoms: Floats) -> Lifting:
    """Join the liftings of groups of images, each image in one group, in the order of the images.

    atoms (k, 3, p) are those that the groups took theirs from; they become those of the problem,
    and coefficients and transforms get k columns. Every other array, and every tuple, of a lifting
    and the records in it has the images on its first axis; numbers and choices are the same in
    all groups. Raises ValueError where a field is otherwise.
    """
    merged: Lifting = _Merger(groups, len(atoms)).record([group.lifting for group in groups])
    return replace(merged, problem=replace(merged.problem, atoms=atoms))


class _Merger:
    """Joins the fields of records, one record per group."""

    def __init__(self, groups: Sequence[Group], k: int) -> None:
        self._groups = groups
        self._k = k
        order = np.concatenate([group.images for group in groups])
        if (np.sort(order) != np.arange(len(order))).any():
            raise ValueError("the groups do not have each image once")
        self._rank = np.argsort(order)

    def record(self, records: Sequence[Any]) -> Any:
        """Join records of one type, field by field."""
        changes = {}
        for field in fields(records[0]):
            values = [getattr(record, field.name) for record in records]
            try:
                changes[field.name] = self._field(field.name, values)
            except ValueError as error:
                raise ValueError(f"{field.name}: {error}") from error
        return type(records[0])(**changes)

    def _field(self, name: str, values: Sequence[Any]) -> Any:
        first = values[0]
        if len({type(value) for value in values}) > 1:
            raise ValueError("is not of one type in all groups")
        if name == "atoms":
            return first
        if isinstance(first, np.ndarray):
            if name in PER_ATOM:
                values = [
                    self._with_all_atoms(*pair) for pair in zip(values, self._groups, strict=True)
                ]
            return self._in_order(values)
        if isinstance(first, Transforms):
            of_all = [
                replace(value, atom=group.atoms[value.atom], k=self._k)
                for value, group in zip(values, self._groups, strict=True)
            ]
            return Transforms.joined(of_all).take(self._rank)
        if isinstance(first, tuple):
            joined = self._in_order([np.array(value, dtype=object) for value in values])
            return tuple(joined)
        if name == "further":
            return {key: self._in_order([value[key] for value in values]) for key in first}
        if isinstance(first, Mapping):
            return self._by_image(values)
        if is_dataclass(first):
            return self.record(values)
        if any(value != first for value in values):
            raise ValueError("differs between the groups")
        return first

    def _in_order(self, values: Sequence[NDArray[Any]]) -> NDArray[Any]:
        for value, group in zip(values, self._groups, strict=True):
            if value.shape[:1] != group.images.shape:
                raise ValueError(f"has the shape {value.shape} for {len(group.images)} images")
        return np.concatenate(values)[self._rank]

    def _with_all_atoms(self, values: Floats, group: Group) -> Floats:
        full = np.zeros((len(values), self._k, *values.shape[2:]))
        full[:, group.atoms] = values
        return full

    def _by_image(self, values: Sequence[Mapping[int, Any]]) -> dict[int, Any]:
        """Join what is known of some images, by their number."""
        found = {
            int(group.images[image]): value
            for group, known in zip(self._groups, values, strict=True)
            for image, value in known.items()
        }
        return dict(sorted(found.items()))
