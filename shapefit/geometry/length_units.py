"""Units of length by the names that files give them."""

from __future__ import annotations

from types import MappingProxyType

_NAMES = {
    1.0: "m meter meters metre metres",
    0.1: "dm decimeter decimeters decimetre decimetres",
    0.01: "cm centimeter centimeters centimetre centimetres",
    0.001: "mm millimeter millimeters millimetre millimetres",
    1e-6: "um µm micrometer micrometers micrometre micrometres micron microns",
    0.0254: "in inch inches",
    0.3048: "ft foot feet",
}

METRES = MappingProxyType({name: size for size, names in _NAMES.items() for name in names.split()})
"""Metres in one of each unit, by its names in small letters."""


def metres_in(unit: str) -> float | None:
    """Return the metres in a unit, whatever its letters' case; None where it is no known length."""
    return METRES.get(unit.strip().lower())


def as_metres(unit: str) -> tuple[float, str]:
    """Return the factor to the unit in which lengths are given out, and the name of that one.

    It is the metre; lengths of a unit that is not known keep it.
    """
    metres = metres_in(unit)
    return (1.0, unit.strip()) if metres is None else (metres, "m")
