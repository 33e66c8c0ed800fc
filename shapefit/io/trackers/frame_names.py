"""What frames are called in items: numbers, times, and the names of images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error

IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


def image_labels(paths: Sequence[str]) -> tuple[str, ...]:
    """Return names of images: without folder and suffix where that tells them apart."""
    stems = [_without_suffix(name_of(path)) for path in paths]
    if len(set(stems)) == len(stems):
        return tuple(stems)
    return tuple(_without_suffix(path) for path in paths)


def number_label(value: float) -> str:
    """Return a frame's number or time in seconds as text, to the microsecond."""
    return str(int(value)) if value == int(value) else f"{value:.6f}".rstrip("0")


def number_labels(place: str, values: NDArray[Any]) -> list[str]:
    """Return the numbers or times of frames as text; InputError where one is no number."""
    wrong = ~np.isfinite(values)
    if wrong.any():
        found = f"entry {int(np.argmax(wrong))} is {values[wrong][0]}, which is no frame"
        raise input_error(place, found, "number the frames")
    return [number_label(value) for value in values.tolist()]


def name_of(path: str) -> str:
    """Return the last part of a path, whichever system wrote it."""
    return PureWindowsPath(path).name if "\\" in path else PurePosixPath(path).name


def apart(names: Sequence[str]) -> tuple[str, ...]:
    """Return names, those that repeat an earlier one with a number after them."""
    taken: set[str] = set()
    found = []
    for name in names:
        free, number = name, 2
        while free in taken:
            free, number = f"{name} ({number})", number + 1
        taken.add(free)
        found.append(free)
    return tuple(found)


def _without_suffix(path: str) -> str:
    ending = next((ending for ending in IMAGES if path.lower().endswith(ending)), "")
    return path[: len(path) - len(ending)]
