"""Dense vertices of shapes, which are transformed as the landmarks are."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats
from shapefit.geometry.normalisation import Normalised
from shapefit.lifting.reconstruction import combine


def transform_mesh(
    mesh_vertices: Floats, normalised: Normalised, rotations: Floats
) -> Floats:
    """Return mesh vertices (n, 3, q), normalised and rotated as their landmarks were.

    R_j (V_j - centroid_j 1^T) / scale_j. mesh_vertices V (n, 3, q) in the frame and
    unit of the landmarks that gave `normalised`; rotations R (n, 3, 3), those of their
    alignment.
    """
    centred = mesh_vertices - normalised.centroid[..., None]
    return rotations @ (centred / normalised.scale[..., None, None])


def metric_scale(atoms: Floats, coefficients: Floats, atom_scale: Floats) -> Floats:
    """Return factors (n,) that make mixtures as large as their atoms are on average.

    (sum_i w_i s_i ||B_i||_F) / ||sum_i c_i B_i||_F with w_i = c_i ||B_i||_F, sum_i w_i
    = 1, so that the shape of an image is as large as its atoms are on average: an image
    does not determine whether a car is small or far away. atoms B (k, 3, p), the
    landmarks; coefficients (n, k); atom_scale s (k,): atom i measures s_i B_i in the
    unit wanted. nan where all coefficients are 0.
    """
    size = np.linalg.norm(atoms, axis=(1, 2))
    share = coefficients * size
    shapes = combine(coefficients, atoms)
    total = share.sum(axis=1) * np.linalg.norm(shapes, axis=(1, 2))
    # no product of matrices, whose rounding depends on how many images there are
    lengths = (share * (atom_scale * size)).sum(axis=1)
    unknown = np.full_like(total, np.nan)
    scale: Floats = np.divide(lengths, total, out=unknown, where=total > 0)
    return scale
