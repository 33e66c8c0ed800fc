"""Find items that occur twice, within a file or over several, without holding all their names."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from shapefit.io.problems import LIMIT, input_problems
from shapefit.io.spilled.name_index import index_of


@dataclass(frozen=True)
class ItemList:
    """The items of one file: `blocks` reads them anew from the start, `place` names a row."""

    blocks: Callable[[], Iterable[Sequence[str]]]
    place: Callable[[int], str]


def check_unique_items(files: Sequence[ItemList]) -> None:
    """Raise InputError for items that occur more than once, naming both places.

    Only where two hashes agree are the items read again and compared.
    """
    index = index_of(None, chain.from_iterable(file.blocks() for file in files))
    suspects = frozenset(chain.from_iterable(map(np.ndarray.tolist, index.repeated())))
    if suspects:
        _compare(files, suspects)


def _compare(files: Sequence[ItemList], suspects: frozenset[int]) -> None:
    first: dict[str, str] = {}
    told: list[str] = []
    count = 0
    for file in files:
        for row, item in enumerate(chain.from_iterable(file.blocks())):
            if hash(item) % (1 << 64) not in suspects:
                continue
            if item not in first:
                first[item] = file.place(row)
                continue
            count += 1
            if len(told) < LIMIT:
                found = f"item '{item}' is also at {first[item]}"
                told.append(f"{file.place(row)}: {found}; give every item a unique name")
    if count:
        raise input_problems(told, count)
