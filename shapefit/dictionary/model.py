"""The dictionary: the rotatable basis shapes and what is known about them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from shapefit.dictionary.mixture import Mixture
from shapefit.geometry.normalisation import normalise

LEARNED_FROM = "learned_from"
"""Of the provenance: what a dictionary was learned from where it was no 3D shapes."""

SUITS = "suits"
"""Provenance: names of the configs of `fit` that suit the dictionary, with spaces between."""


@dataclass(frozen=True)
class Dictionary:
    """k atoms B_i, each a centred (3, p) shape on the scale of normalised shapes.

    atoms (k, 3, p); mean_shape (3, p); edges (e, 2) pairs of landmark indices for drawing;
    mirror_index (p,) the landmark that a reflection makes of each;
    mesh_vertices (k, 3, q) and mesh_faces (f, 3) travel with the atoms where the training shapes
    had a mesh; atom_scale (k,): atom i measures atom_scale[i] * B_i in `unit`; atom_items (k,):
    the training shape that each atom is, where the atoms are exemplars; prior is that over shapes,
    misfit (1,) the variance of a normalised coordinate that it cannot place;
    acceleration (p,): how much the training shapes move, see `find_acceleration`, and their
    frame_rate in Hz; edge_give (e,), how far edges are from rigid, see `find_give`; edge_length
    (e,), the mean lengths of the edges in `unit`, and edge_covariance (e, e), how their logarithms
    differ between bodies, see `find_edge_covariance`; each where it is known;
    objective_trace is the
    training objective after every half-step; provenance holds text (version, resolved config,
    input digests).
    """

    atoms: NDArray[np.float64]
    landmark_names: tuple[str, ...]
    mean_shape: NDArray[np.float64]
    edges: NDArray[np.int64] | None = None
    mirror_index: NDArray[np.int64] | None = None
    mesh_vertices: NDArray[np.float64] | None = None
    mesh_faces: NDArray[np.int64] | None = None
    atom_scale: NDArray[np.float64] | None = None
    unit: str = "unknown"
    atom_items: tuple[str, ...] | None = None
    prior: Mixture | None = None
    misfit: NDArray[np.float64] | None = None
    acceleration: NDArray[np.float64] | None = None
    edge_give: NDArray[np.float64] | None = None
    edge_length: NDArray[np.float64] | None = None
    edge_covariance: NDArray[np.float64] | None = None
    frame_rate: float | None = None
    objective_trace: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    provenance: Mapping[str, str] = field(default_factory=dict)

    @property
    def prior_weights(self) -> NDArray[np.float64] | None:
        """Return pi (K,) of the prior, None without one."""
        return None if self.prior is None else self.prior.weights

    @property
    def prior_means(self) -> NDArray[np.float64] | None:
        """Return mu (K, 3, p) of the prior, None without one."""
        return None if self.prior is None else self.prior.means

    @property
    def prior_covariances(self) -> NDArray[np.float64] | None:
        """Return C (K, p, 3, p, 3) of the prior, the covariance of each coordinate with each."""
        return None if self.prior is None else self.prior.by_landmark

    @property
    def k(self) -> int:
        """Return the number of atoms."""
        return len(self.atoms)

    def without(self, item: str) -> Dictionary:
        """Return the dictionary of the atoms that are not the training shape `item`.

        Its mean shape is the normalised mean of the atoms that are left. Raises ValueError where
        the atoms have no items, and where none is left.
        """
        kept = self.atoms_without(item)
        if not kept.any():
            raise ValueError(f"every atom is the item {item!r}")
        atoms = self.atoms[kept]
        return replace(
            self,
            atoms=atoms,
            mean_shape=normalise(atoms.mean(axis=0)).points,
            mesh_vertices=None if self.mesh_vertices is None else self.mesh_vertices[kept],
            atom_scale=None if self.atom_scale is None else self.atom_scale[kept],
            atom_items=tuple(name for name in self.atom_items or () if name != item),
        )

    def atoms_without(self, item: str) -> NDArray[np.bool_]:
        """Return the mask (k,) of the atoms that are not the training shape `item`.

        Raises ValueError where the atoms have no items.
        """
        if self.atom_items is None:
            raise ValueError("the atoms have no items: they are not exemplars")
        return np.array([name != item for name in self.atom_items], dtype=bool)
