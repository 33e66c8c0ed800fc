"""The mesh of a dictionary, and when it can follow the landmarks of a fit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import listed
from shapefit.lifting.methods import METHODS, those


class AtomMeshes(NamedTuple):
    """One mesh per atom: vertices (k, 3, q), faces (f, 3)."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


def find_meshes(dictionary: Dictionary) -> AtomMeshes | None:
    """Return the meshes of the atoms, None where the dictionary has none."""
    if dictionary.mesh_vertices is None or dictionary.mesh_faces is None:
        return None
    return AtomMeshes(dictionary.mesh_vertices, dictionary.mesh_faces)


def mixes_atoms(config: FitConfig) -> bool:
    """Whether shapes are sum_i c_i R_i B_i, so that what belongs to the atoms can be mixed alike.

    Refined under a perspective camera they always are.
    """
    method = METHODS[config.method]
    refined = config.camera.model == "perspective" and method.perspective == "refined"
    return method.mixes_atoms or refined


def find_obstacle(config: FitConfig) -> tuple[str, str] | None:
    """Say what keeps a mesh from following the landmarks, and the fix; None where nothing does."""
    if not mixes_atoms(config):
        found = f"`method: {config.method}` gives no coefficients to combine the atoms' meshes"
        return found, f"choose {listed(those(lambda method: method.mixes_atoms))}"
    return None
