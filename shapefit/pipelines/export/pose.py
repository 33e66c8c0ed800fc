"""How the points of atoms become those of an image: what meshes and pictures follow."""

from __future__ import annotations

from typing import Literal, NamedTuple

from shapefit.lifting.methods import METHODS


class Pose(NamedTuple):
    """How the points of atoms become those of an image.

    method        of the fit
    rotations     of the landmarks: the transforms of the atoms, or orthogonal
    perspective   the camera is a perspective one
    """

    method: str
    rotations: Literal["shared", "orthogonal"] = "shared"
    perspective: bool = False

    @property
    def mixes_atoms(self) -> bool:
        """Whether shapes are sum_i c_i R_i B_i, so that what belongs to atoms can be mixed alike.

        Refined under a perspective camera they always are.
        """
        method = METHODS[self.method]
        return method.mixes_atoms or (self.perspective and method.perspective == "refined")
