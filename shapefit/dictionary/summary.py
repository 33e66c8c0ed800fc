"""How well a dictionary codes its training shapes, in one pass over them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from shapefit.arrays import Floats
from shapefit.dictionary.atom_scale import scale_of_atoms
from shapefit.dictionary.coding import duality_gaps, objectives


@dataclass(frozen=True)
class Summary:
    """Figures over n training shapes S with coefficients C for k atoms B.

    objective: that of dictionary learning, their sum. relative_error: ||S - C B||_F / ||S||_F over
    all shapes together. largest_gap: how far the coding of any shape can be from its optimum, as a
    share of its objective; unknown (None) where beta is 0. active_atoms: the mean number with a
    positive coefficient; dead_atoms: the number that no shape uses. atom_scale (k,): how large
    atoms are, by `scale_of_atoms`.
    """

    objective: float
    relative_error: float
    largest_gap: float | None
    active_atoms: float
    dead_atoms: int
    atom_scale: Floats


def summarise(
    parts: Iterable[tuple[Floats, Floats, Floats]], atoms: Floats, beta: float
) -> Summary:
    """Sum up shapes part by part: shapes (m, 3, p), coefficients (m, k) and sizes (m,) of each.

    atoms (k, 3, p), none 0; at least one shape.
    """
    n, active, objective, gap = 0, 0, 0.0, 0.0
    missed, energy, size = 0.0, 0.0, 0.0
    use, measured = np.zeros(len(atoms)), np.zeros(len(atoms))
    for shapes, coefficients, scale in parts:
        values = objectives(shapes, atoms, beta, coefficients)
        if beta:
            gaps = duality_gaps(shapes, atoms, beta, coefficients)
            relative = np.divide(gaps, values, out=np.zeros_like(gaps), where=values > 0)
            gap = max(gap, float(relative.max()))
        objective += float(values.sum())
        missed += float(((shapes - np.tensordot(coefficients, atoms, axes=1)) ** 2).sum())
        energy += float((shapes**2).sum())
        active += int((coefficients > 0).sum())
        use += coefficients.sum(axis=0)
        measured += scale @ coefficients
        size += float(scale.sum())
        n += len(shapes)
    return Summary(
        objective=objective,
        relative_error=float(np.sqrt(missed / energy)),
        largest_gap=gap if beta else None,
        active_atoms=active / n,
        dead_atoms=int((use == 0).sum()),
        atom_scale=scale_of_atoms(atoms, use, measured, size / n),
    )
