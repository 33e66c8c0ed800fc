"""The one rule of the units that people read: on the terminal, the page and figures."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from shapefit.errors import printable

MILLIMETRES_IN_A_METRE = 1000.0


class ShownUnit(NamedTuple):
    """How numbers of a unit are shown: times `factor`, in the unit `name`."""

    name: str
    factor: float


def shown_unit(unit: str, errors: Iterable[float]) -> ShownUnit:
    """Return the unit in which people read errors: metres below one as millimetres.

    errors are all those that are shown in the unit, so that one report has one unit.
    Tables for programs stay in the unit of the truth.
    """
    if unit == "m" and all(error < 1 for error in errors if np.isfinite(error)):
        return ShownUnit("mm", MILLIMETRES_IN_A_METRE)
    return ShownUnit(printable(unit), 1.0)
