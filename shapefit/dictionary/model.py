"""The dictionary: the rotatable basis shapes and what is known about them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Dictionary:
    """k atoms B_i, each a centred (3, p) shape on the scale of normalised shapes.

    atoms (k, 3, p); mean_shape (3, p); edges (e, 2) pairs of landmark indices for drawing;
    mesh_vertices (k, 3, q) and mesh_faces (f, 3) travel with the atoms where the training shapes
    had a mesh; objective_trace is the training objective after every half-step; provenance holds
    text (version, resolved config, input digests).
    """

    atoms: NDArray[np.float64]
    landmark_names: tuple[str, ...]
    mean_shape: NDArray[np.float64]
    edges: NDArray[np.int64] | None = None
    mesh_vertices: NDArray[np.float64] | None = None
    mesh_faces: NDArray[np.int64] | None = None
    objective_trace: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    provenance: Mapping[str, str] = field(default_factory=dict)

    @property
    def k(self) -> int:
        """Return the number of atoms."""
        return len(self.atoms)
