"""`leave_out` of `fit`: no image is lifted with the atoms of the model that it shows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from shapefit.core import STRETCH
from shapefit.core.stretches import on_threads
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import LandmarkSet
from shapefit.lifting.lift import Lifting
from shapefit.lifting.merging import Group, merge
from shapefit.pipelines.items import named_items

if TYPE_CHECKING:
    from shapefit.pipelines.fit.chain import Lifter


KEY = "leave_out"


def check_items(dictionary: Dictionary) -> None:
    """Raise InputError where the atoms of a dictionary have no items, or but one."""
    if dictionary.atom_items is None:
        found = "the atoms of the dictionary have no items"
        raise input_error(KEY, found, f"learn it with `method: exemplars`, or remove `{KEY}`")
    if len(set(dictionary.atom_items)) == 1:
        found = f"every atom of the dictionary is the item '{dictionary.atom_items[0]}'"
        raise input_error(KEY, found, "learn the dictionary from more models")


def lift_left_out(
    images: LandmarkSet, whole: Dictionary, lifter: Lifter, *, dataset: str, threads: int
) -> Lifting:
    """Lift each image with the dictionary without the item that `dataset` names.

    Images of an item that the dictionary does not have are lifted with all atoms. The lifting has
    the columns of the whole dictionary, 0 for atoms left out. `threads` = 0 means one per core.
    Raises InputError where the images lack the dataset.
    """
    items = find_left_out(images, dataset, whole)

    def lift_group(rows: NDArray[np.intp]) -> Group:
        item = str(items[rows[0]])
        lifting = lifter(images.take(rows), whole.without(item) if item else whole)
        return Group(lifting, rows, np.flatnonzero(whole.atoms_without(item)))

    parts = [np.flatnonzero(items == item) for item in dict.fromkeys(items.tolist())]
    # A lifter has work for several threads where there is more than a stretch of images.
    groups = [lift_group(rows) for rows in parts if len(rows) > STRETCH]
    groups += on_threads([rows for rows in parts if len(rows) <= STRETCH], lift_group, threads)
    return merge(groups, whole.atoms) if groups else lifter(images, whole)


class UnknownItems:
    """Counts the images that show no item of the dictionary, and so were lifted with all atoms."""

    def __init__(self, dataset: str, dictionary: Dictionary) -> None:
        self._dataset = dataset
        self._dictionary = dictionary
        self._images = 0
        self._first: list[str] = []
        self._count = 0

    def add(self, images: LandmarkSet) -> None:
        """Count those among more images. Raises InputError where they lack the dataset."""
        items = find_items(images, self._dataset)
        strange = items[~find_known(items, self._dictionary)]
        self._images += len(images)
        self._count += len(strange)
        self._first = self._first or strange[:1].tolist()

    @property
    def warnings(self) -> tuple[str, ...]:
        """How many there were. Raises InputError where there was nobody else."""
        if not self._count:
            return ()
        found = (
            f"{self._count} of {self._images} images show items that are not in the "
            f"dictionary, the first '{self._first[0]}'"
        )
        if self._count == self._images:
            items = ", ".join(f"'{item}'" for item in list(self._dictionary.atom_items or ())[:3])
            fix = f"name the dataset that holds items of the dictionary, such as {items}"
            raise input_error(KEY, found, fix)
        return (f"{KEY}: {found}; they were fitted with all atoms",)


def find_items(images: LandmarkSet, dataset: str) -> NDArray[np.str_]:
    """Return the item that the dataset names for each image (n,); raises as `named_items`."""
    return np.array(named_items(images, dataset, KEY, KEY), dtype=str)


def find_left_out(images: LandmarkSet, dataset: str, dictionary: Dictionary) -> NDArray[np.str_]:
    """Return the item (n,) whose atoms the fit of each image does without, '' for none."""
    items = find_items(images, dataset)
    items[~find_known(items, dictionary)] = ""
    return items


def find_known(items: NDArray[np.str_], dictionary: Dictionary) -> NDArray[np.bool_]:
    """Return the mask (n,) of the items that atoms of the dictionary have."""
    return np.isin(items, np.array(dictionary.atom_items, dtype=str))
