"""Whether several input files go together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import InputError, input_error
from shapefit.io.extras import Array, Extras

Text = TypeVar("Text", bound=str)
APART = "give files that agree, or run them apart"


def agreed(what: str, stated: Sequence[tuple[str, Text | None]], default: Text) -> Text:
    """Return what all files state, `default` if none does; each comes with its name.

    Raises InputError where two files differ.
    """
    first: tuple[str, Text] | None = None
    for place, value in stated:
        if value is None:
            continue
        if first is None:
            first = (place, value)
        elif value != first[1]:
            found = f"its {what} is '{value}', that of {first[0]} is '{first[1]}'"
            raise input_error(place, found, APART)
    return default if first is None else first[1]


def check_same_array(what: str, files: Sequence[tuple[str, NDArray[np.int64] | None]]) -> None:
    """Raise InputError unless all files have the same array, or none has it."""
    for place, array in files[1:]:
        if not _same(array, files[0][1]):
            raise _differs(what, place, files[0][0])


def check_same_extras(files: Sequence[tuple[str, Extras]]) -> None:
    """Raise InputError unless all files carry the same further datasets.

    Those per item must agree in the shape of a row, the others in their values.
    """
    for place, extras in files[1:]:
        first_place, first = files[0]
        for name in {**first, **extras}:
            if name in first.per_item and name in extras.per_item:
                same = first.per_item[name].shape[1:] == extras.per_item[name].shape[1:]
            else:
                same = _same(first.whole.get(name), extras.whole.get(name))
                same = same and name not in {**first.per_item, **extras.per_item}
            if not same:
                raise _differs(f"dataset {name}", place, first_place)


def _same(one: Array | None, other: Array | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other, equal_nan=one.dtype.kind == other.dtype.kind == "f")


def _differs(what: str, place: str, first: str) -> InputError:
    return input_error(place, f"its {what} is not that of {first}", APART)
