"""Combinations of atoms, the same to the last bit however many images are done at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def combine(coefficients: Floats, atoms: Floats) -> Floats:
    """sum_i c_i B_i for each image; c (n, k), atoms B (k, 3, p) -> (n, 3, p).

    One product an image: a single one for all would round by how many there are, and results
    would depend on how the images are divided.
    """
    n, (k, three, p) = len(coefficients), atoms.shape
    shapes: Floats = (coefficients[:, None, :] @ atoms.reshape(k, three * p)).reshape(n, three, p)
    return shapes
