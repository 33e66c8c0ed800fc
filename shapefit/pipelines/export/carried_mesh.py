"""The mesh of a dictionary, and when it can follow the landmarks of a fit."""

from __future__ import annotations

from typing import Literal, NamedTuple

from shapefit.arrays import Floats, Integers
from shapefit.dictionary.model import Dictionary
from shapefit.errors import listed
from shapefit.lifting.methods import METHODS, those


class AtomMeshes(NamedTuple):
    """One mesh per atom: vertices (k, 3, q), faces (f, 3)."""

    vertices: Floats
    faces: Integers


def find_meshes(dictionary: Dictionary) -> AtomMeshes | None:
    """Return the meshes of the atoms, None where the dictionary has none."""
    if dictionary.mesh_vertices is None or dictionary.mesh_faces is None:
        return None
    return AtomMeshes(dictionary.mesh_vertices, dictionary.mesh_faces)


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

    @property
    def one_rotation(self) -> bool:
        """Whether all atoms share one rotation."""
        return METHODS[self.method].one_rotation


def find_obstacle(pose: Pose) -> tuple[str, str] | None:
    """Say what keeps a mesh from following the landmarks, and the fix; None where nothing does."""
    if pose.mixes_atoms:
        return None
    found = f"`method: {pose.method}` gives no coefficients to combine the atoms' meshes"
    return found, f"choose {listed(those(lambda method: method.mixes_atoms))}"
