"""The atom update: the best atoms within a ball for fixed coefficients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from shapefit import core
from shapefit.arrays import Floats
from shapefit.dictionary.coding import flat


@dataclass(frozen=True)
class Products:
    """A = C^T C and D = C^T S, the sums over shapes S_j that the best atoms depend on.

    overlaps A (k, k), pulls D (k, 3, p).
    """

    overlaps: Floats
    pulls: Floats

    @classmethod
    def zero(cls, atoms: Floats) -> Self:
        """Return the products of no shapes, for atoms (k, 3, p)."""
        return cls(np.zeros((len(atoms), len(atoms))), np.zeros(atoms.shape))

    def add(self, shapes: Floats, coefficients: Floats) -> Self:
        """Add those of shapes (n, 3, p) with coefficients (n, k), one shape after the other."""
        core.add_products(
            shapes=flat(shapes),
            coefficients=np.ascontiguousarray(coefficients, dtype=np.float64),
            overlaps=self.overlaps,
            pulls=flat(self.pulls),
        )
        return self


def update_atoms(products: Products, atoms: Floats, bound: float, sweeps: int = 5) -> Floats:
    """Lower 1/2 sum_j ||S_j - sum_i C_ji B_i||_F^2 over atoms with ||B_i||_F <= bound.

    products of the shapes S and their coefficients C; atoms (k, 3, p) within the bound, the place
    to start; returns the new atoms. Block coordinate descent: with the other atoms fixed, the best
    B_i is the projection of its unconstrained minimum on the ball, so no step raises the objective.
    Atoms that no shape uses stay as they are. Source: Mairal et al. 2010, algorithm 2.
    """
    B = np.array(atoms, dtype=np.float64, order="C")
    core.update_atoms(
        overlaps=products.overlaps,
        pulls=flat(products.pulls),
        atoms=flat(B),
        bound=bound,
        sweeps=sweeps,
    )
    return B
