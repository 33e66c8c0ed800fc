"""Datasets that a format does not know, carried along beside the ones that it knows."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

# Datasets that belong to the file when they have so many axes, however many items there are.
OF_THE_FILE = {
    "camera_matrix": 2,
    "distortion": 1,
    "edges": 2,
    "extrinsic_rotation": 2,
    "extrinsic_translation": 1,
    "image_size": 1,
    "input_landmark_names": 1,
    "landmark_map": 2,
    "mirror_index": 1,
    "removed_distortion": 1,
}

EDGES = "edges"
"""Dataset (e, 2) of landmarks and of results: pairs of landmarks that a line joins."""

OUTLIERS, CORRUPTED = "outliers", "corrupted"
"""Datasets (n, p) of the landmarks that a fit judged wrong, and of those that were made wrong."""
LABELS = (OUTLIERS, CORRUPTED)

LANDMARK_COVARIANCE = "landmark_covariance"
"""Covariance (n, p, 2, 2) of each landmark, in the unit of the landmarks squared."""

METRES_PER_UNIT = "metres_per_unit"
"""Dataset (n,) of results: metres in one unit of the shape of each image."""

METRES_FROM = "metres_from"
"""Attribute of results that have it: by what the size was found, edges or spread."""


def is_per_item(name: str, shape: tuple[int, ...], count: int) -> bool:
    """Whether a dataset of this shape has a row for each of `count` items."""
    return shape[:1] == (count,) and OF_THE_FILE.get(name) != len(shape)


def names_apart(names: Iterable[str], taken: Collection[str]) -> dict[str, str]:
    """Return the name under which each dataset can stand in a file that has those in `taken`.

    `input_` is put before a name that is taken until it is free. In HDF5 the dataset `a/b` lies in
    the group `a`, for which there is no room where `a` is a dataset.
    """
    names = list(names)
    groups = {_group(name) for name in names}

    def apart(name: str) -> str:
        free = name
        while _group(free) in taken or (free != name and _group(free) in groups):
            free = f"input_{free}"
        return free

    return {name: apart(name) for name in names}


def _group(name: str) -> str:
    return name.partition("/")[0]


class Extras(Mapping[str, Array]):
    """Further datasets by name, as they stand in the file: `per_item` and `whole` ones.

    The first axis of a `per_item` dataset runs over the items, and is sliced with them; a `whole`
    one (a camera matrix, a list of colours) belongs to the file.
    """

    def __init__(
        self,
        per_item: Mapping[str, Array] | None = None,
        whole: Mapping[str, Array] | None = None,
    ) -> None:
        self.per_item = dict(per_item or {})
        self.whole = dict(whole or {})

    @classmethod
    def of(cls, datasets: Mapping[str, Array], count: int) -> Extras:
        """Sort datasets by `is_per_item`.

        What is already sorted is returned as it is. Raises ValueError where a dataset per item
        has not `count` rows.
        """
        if not isinstance(datasets, Extras):
            per_item: dict[str, Array] = {}
            whole: dict[str, Array] = {}
            for name, values in datasets.items():
                array = np.asarray(values)
                kind = per_item if is_per_item(name, array.shape, count) else whole
                kind[name] = array
            return cls(per_item, whole)
        for name, array in datasets.per_item.items():
            if len(array) != count:
                raise ValueError(f"extras[{name!r}] has {len(array)} rows for {count} items")
        return datasets

    def take(self, rows: NDArray[np.intp]) -> Extras:
        """Return the extras of these items."""
        return Extras({name: array[rows] for name, array in self.per_item.items()}, self.whole)

    def apart_from(self, taken: Collection[str]) -> Extras:
        """Return these extras under names that are not in `taken`, as `names_apart` gives them."""
        names = names_apart(self, taken)
        return Extras(
            {names[name]: array for name, array in self.per_item.items()},
            {names[name]: array for name, array in self.whole.items()},
        )

    def __or__(self, per_item: Mapping[str, Array]) -> Extras:
        """Return these extras and more datasets per item (over those of the same name)."""
        return Extras({**self.per_item, **per_item}, self.whole)

    def __getitem__(self, name: str) -> Array:
        return self.per_item[name] if name in self.per_item else self.whole[name]

    def __iter__(self) -> Iterator[str]:
        yield from self.per_item
        yield from self.whole

    def __len__(self) -> int:
        return len(self.per_item) + len(self.whole)
