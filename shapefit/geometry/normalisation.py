"""Sizes: points in the unit in which lambda and beta are stated; units of length."""

from __future__ import annotations

from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats

# Coordinates and their distances are squared and summed, which must neither overflow
# nor vanish.

MAX_COORDINATE = 1e150
"""Largest coordinate that is taken."""

MIN_EXTENT = 1e-150
"""Smallest extent of points that is taken."""

_UNIT_NAMES = {
    1.0: "m meter meters metre metres",
    0.1: "dm decimeter decimeters decimetre decimetres",
    0.01: "cm centimeter centimeters centimetre centimetres",
    0.001: "mm millimeter millimeters millimetre millimetres",
    1e-6: "um µm micrometer micrometers micrometre micrometres micron microns",
    0.0254: "in inch inches",
    0.3048: "ft foot feet",
}

METRES = MappingProxyType(
    {name: size for size, names in _UNIT_NAMES.items() for name in names.split()}
)
"""Metres in one of each unit, by its names in small letters."""


class Normalised(NamedTuple):
    """Points centred and scaled, and what brings them back; hidden points are 0.

    points = (original - centroid) / scale. points (..., d, p), centroid (..., d), scale
    (...).
    """

    points: Floats
    centroid: Floats
    scale: Floats


def centroid(points: Floats, visible: NDArray[np.bool_] | None = None) -> Floats:
    """Return the mean (..., d) of the visible points; nan where none is visible."""
    middle: Floats
    if visible is None:
        middle = points.mean(axis=-1)
        return middle
    count = visible.sum(axis=-1)[..., None]
    total = np.where(visible[..., None, :], points, 0.0).sum(axis=-1)
    mean = np.full(total.shape, np.nan)
    np.divide(total, count, out=mean, where=count > 0)
    return mean


def std(points: Floats, visible: NDArray[np.bool_] | None = None) -> Floats:
    """Return the size (...) of point sets: their standard deviation about the centroid.

    Of the visible points (the population's), the mean over the d coordinates. Infinite
    where points are too far apart for their squares.
    """
    return _std(points - centroid(points, visible)[..., None], visible)


def normalise(points: Floats, visible: NDArray[np.bool_] | None = None) -> Normalised:
    """Centre points (..., d, p) and scale them to the standard deviation 1.

    (points - centroid) / std, see `std`. visible (..., p) bool or None for all. Where
    the visible points coincide the scale is 0 and the normalised points are not finite:
    the caller decides what that means. Source: released solver's convention, see
    docs/method.md, Conventions.
    """
    middle = centroid(points, visible)
    centred = points - middle[..., None]
    scale = _std(centred, visible)
    with np.errstate(divide="ignore", invalid="ignore"):
        out = centred / scale[..., None, None]
    if visible is not None:
        out = np.where(visible[..., None, :], out, 0.0)
    return Normalised(out, middle, scale)


def metres_in(unit: str) -> float | None:
    """Return the length in metres of a unit, such as "cm"; None if it is unknown."""
    return METRES.get(unit.strip().lower())


def as_metres(unit: str) -> tuple[float, str]:
    """Return the factor from a unit to metres, and "m"; 1 and the unit if unknown."""
    metres = metres_in(unit)
    return (1.0, unit.strip()) if metres is None else (metres, "m")


def _std(centred: Floats, visible: NDArray[np.bool_] | None) -> Floats:
    """Return the standard deviation, as `std` does, of points that are centred."""
    deviation: Floats
    with np.errstate(over="ignore"):
        if visible is None:
            deviation = np.sqrt((centred**2).mean(axis=-1)).mean(axis=-1)
            return deviation
        count = np.maximum(visible.sum(axis=-1), 1)[..., None]
        squares = np.where(visible[..., None, :], centred, 0.0) ** 2
        deviation = np.sqrt(squares.sum(axis=-1) / count).mean(axis=-1)
        return deviation
