"""Whether several input files go together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io.extras import Array, Extras

Text = TypeVar("Text", bound=str)
APART = "use files that agree, or process them separately"
ALL_OR_NONE = "give it to all files (CSV cannot hold it) or to none, or process them separately"


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


def agreed_rate(stated: Sequence[tuple[str, float | None]]) -> float | None:
    """Return the frame rate that all files state, None if none does; raises as `agreed`."""
    texts = [(place, None if rate is None else f"{rate:.17g}") for place, rate in stated]
    text = agreed("frame_rate", texts, "")
    return float(text) if text else None


def check_same_array(what: str, files: Sequence[tuple[str, NDArray[np.int64] | None]]) -> None:
    """Raise InputError unless all files have the same array, or none has it."""
    for place, array in files[1:]:
        _compare(what, files[0], (place, array))


def check_same_extras(files: Sequence[tuple[str, Extras]]) -> None:
    """Raise InputError unless all files carry the same further datasets.

    Those per item must agree in the shape of a row, the others in their values.
    """
    first_place, first = files[0]
    for place, extras in files[1:]:
        for has, names in (("has no", first.keys() - extras), ("has the", extras.keys() - first)):
            if names:
                found = f"{has} dataset {', '.join(sorted(names))}, unlike {first_place}"
                raise input_error(place, found, ALL_OR_NONE)
        for name in first:
            one, other = _comparable(first, name), _comparable(extras, name)
            _compare(f"dataset {name}", (first_place, one), (place, other))


def _comparable(extras: Extras, name: str) -> Array | None:
    if name in extras.per_item:
        return np.array(["per item", *extras.per_item[name].shape[1:]], dtype=object)
    return extras.whole.get(name)


def _compare(what: str, first: tuple[str, Array | None], file: tuple[str, Array | None]) -> None:
    place, array = file
    first_place, expected = first
    if array is None and expected is None:
        return
    if array is None:
        raise input_error(place, f"has no {what}, unlike {first_place}", APART)
    if expected is None:
        raise input_error(place, f"has a {what}, unlike {first_place}", APART)
    floats = array.dtype.kind == expected.dtype.kind == "f"
    if not np.array_equal(array, expected, equal_nan=floats):
        raise input_error(place, f"its {what} is not that of {first_place}", APART)
