"""How large learned atoms are in the unit of the training shapes."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats
from shapefit.geometry.normalisation import spread


def scale_of_atoms(atoms: Floats, use: Floats, measured: Floats, mean: float) -> Floats:
    """(sum_j C_ji s_j / sum_j C_ji) / spread(B_i): as large as the shapes that use the atom.

    A linear estimate from the sizes s: a learned atom has no size of its own, so that one alone
    is, grown to the spread 1 of a normalised shape, as large as the training shapes are on
    average, each by its share in the atom's use. Where all s are equal, so are the sizes of the
    grown atoms. An atom that no shape uses is as large as all shapes are on average.

    atoms B (k, 3, p), none 0; use sum_j C_ji and measured sum_j C_ji s_j (k,), sums over the
    training shapes: coefficients C >= 0 of the normalised ones, shape j measures s_j times its
    normalised form; mean of all s -> (k,) > 0: atom i measures that times B_i.
    """
    size = np.full(len(atoms), mean)
    np.divide(measured, use, out=size, where=use > 0)
    sizes: Floats = size / spread(atoms)
    return sizes
