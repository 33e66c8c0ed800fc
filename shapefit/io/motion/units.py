"""Units of length as files name them, in metres."""

from __future__ import annotations

from shapefit.io.layout import UNKNOWN_UNIT

_METRES = {
    1.0: "m meter meters metre metres",
    0.1: "dm",
    0.01: "cm centimeter centimeters centimetre centimetres",
    0.001: "mm millimeter millimeters millimetre millimetres",
    1e-6: "um micrometer micrometers micron microns",
    0.0254: "in inch inches",
    0.3048: "ft foot feet",
}
_BY_NAME = {name: metres for metres, names in _METRES.items() for name in names.split()}


def in_metres(name: str) -> tuple[float, str]:
    """Return the factor from a unit to the one that is given out, and the name of that one.

    Lengths are given out in metres; those of a unit that is not known keep it.
    """
    plain = name.strip().lower()
    if plain in _BY_NAME:
        return _BY_NAME[plain], "m"
    return 1.0, name.strip() or UNKNOWN_UNIT
