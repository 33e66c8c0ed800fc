"""The items that images show, whose atoms `leave_out` takes from their fits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSet
from shapefit.pipelines.items import named_items

KEY = "leave_out"


def find_items(images: LandmarkSet, dataset: str) -> NDArray[np.str_]:
    """Return the item that the dataset names for each image (n,); raises as `named_items`."""
    return np.array(named_items(images.items, images.extras, dataset, KEY, KEY), dtype=str)


def find_left_out(images: LandmarkSet, dataset: str, dictionary: Dictionary) -> NDArray[np.str_]:
    """Return the item (n,) whose atoms the fit of each image does without, '' for none."""
    items = find_items(images, dataset)
    items[~find_known(items, dictionary)] = ""
    return items


def find_known(items: NDArray[np.str_], dictionary: Dictionary) -> NDArray[np.bool_]:
    """Return the mask (n,) of the items that atoms of the dictionary have."""
    return np.isin(items, np.array(dictionary.atom_items, dtype=str))
