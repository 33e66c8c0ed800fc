"""The item that each image names: itself, or what a dataset says that it shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io.extras import Extras

BY_ITEM = "item"
"""Stands for the items of the images themselves."""


def named_items(
    items: Sequence[str],
    extras: Mapping[str, NDArray[Any]],
    dataset: str,
    place: str | Path,
    key: str,
) -> tuple[str, ...]:
    """Return what a dataset of the extras names, one an image; BY_ITEM names the items.

    `key` of the config chose the dataset. Raises InputError at `place` where the extras have no
    such dataset with one name an image.
    """
    if dataset == BY_ITEM:
        return tuple(items)
    per_item = Extras.of(extras, len(items)).per_item
    named = {name: values for name, values in per_item.items() if values.ndim == 1}
    if dataset not in named:
        found = f"there is no dataset '{dataset}' with one name an image"
        texts = (name for name, values in named.items() if values.dtype.kind in "OSU")
        others = ", ".join([BY_ITEM, *sorted(texts)])
        raise input_error(place, found, f"set `{key}` to one of: {others}")
    return tuple(map(str, named[dataset]))
