"""Shapes: measured in 3D, in any frame."""

# No `from __future__ import annotations` here: `columns_of` reads what stands beside
# the fields.

from dataclasses import KW_ONLY, dataclass
from typing import Annotated, ClassVar

from shapefit.arrays import Floats, Integers
from shapefit.records.columns import LENGTH
from shapefit.records.items import Items


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Shapes(Items):
    """n shapes of p landmarks."""

    POINTS: ClassVar[str] = "shapes"

    shapes: Annotated[Floats, "n p 3", LENGTH]
    """Positions, NaN where unknown."""
    _: KW_ONLY
    mirror_index: Annotated[Integers | None, "p"] = None
    """Landmark of each in a mirror, by position."""
    mesh_vertices: Annotated[Floats | None, "n q 3", LENGTH] = None
    """Vertices of a mesh."""
    mesh_faces: Annotated[Integers | None, "f 3"] = None
    """Vertices of each triangle, by position."""
