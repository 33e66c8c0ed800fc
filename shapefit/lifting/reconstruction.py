"""From the transforms of the convex program to coefficients, rotations and the 3D shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.convex.spectral_norm import spectral_norm
from shapefit.geometry.rotations import complete_rotation, nearest_rotation

# An atom is active where its coefficient is more than this share of the largest one.
ACTIVE = 1e-6
# A transform is orthogonal where ||M M^T / c^2 - I||_F is at most this.
ORTHOGONAL = 1e-3


@dataclass(frozen=True)
class Reconstruction:
    """S = sum_i c_i R_i B_i and its parts, for n images.

    shapes (n, 3, p); coefficients c (n, k); rotation (n, 3, 3), the rotation nearest to
    sum_i c_i R_i, nan where all coefficients are 0; active_atoms (n,); tight (n,): are all active
    transforms orthogonal, so that the optimum solves the per-atom nonconvex model too?
    """

    shapes: Floats
    coefficients: Floats
    rotation: Floats
    active_atoms: NDArray[np.int64]
    tight: NDArray[np.bool_]


def complete_transforms(M: Floats) -> Floats:
    """[M; m_1 x m_2 / c]: c_i R_i from M_i = c_i times two rows of R_i.

    M (..., 2, 3) -> (..., 3, 3); the third row is c_i times the cross product of the two rows of
    R_i = M_i / c_i with c_i = ||M_i||_2 (paper, section Reconstruction), 0 where M_i is 0.
    """
    c = spectral_norm(M)[..., None]
    third = np.cross(M[..., 0, :], M[..., 1, :])
    third = np.divide(third, c, out=np.zeros_like(third), where=c > 0)
    return np.concatenate([M, third[..., None, :]], axis=-2)


def orthogonal_transforms(M: Floats) -> Floats:
    """c_i R_i with c_i = ||M_i||_2 and R_i the rotation nearest to M_i / c_i.

    M (..., 2, 3) -> (..., 3, 3). The projection to SO(3) of the paper's Discussion: unlike
    complete_transforms it also makes the first two rows orthonormal.
    """
    return spectral_norm(M)[..., None, None] * complete_rotation(M)


def is_active(coefficients: Floats) -> NDArray[np.bool_]:
    """Atoms whose coefficient (n, k) is not negligible beside the largest of the image."""
    size = np.abs(coefficients)
    active: NDArray[np.bool_] = size > ACTIVE * size.max(axis=1, keepdims=True)
    return active


def reconstruct(M: Floats, atoms: Floats, *, orthogonal: bool = False) -> Reconstruction:
    """S = sum_i c_i R_i B_i (paper, eq. new3dmodel); M (n, k, 2, 3), atoms B (k, 3, p).

    R_i completes M_i / c_i, or is the rotation nearest to it where `orthogonal`. Most transforms
    are 0, so the work is done on the list of the others.
    """
    n, k = M.shape[:2]
    flat = M.reshape(n, k, 6)
    image, atom = np.nonzero(np.einsum("nke,nke->nk", flat, flat))
    blocks = M[image, atom]
    c = spectral_norm(blocks)
    coefficients = np.zeros((n, k))
    coefficients[image, atom] = c
    turned = np.zeros((n, 3, k, 3))
    turned[image, :, atom] = (orthogonal_transforms if orthogonal else complete_transforms)(blocks)
    shapes = turned.reshape(n, 3, 3 * k) @ atoms.reshape(3 * k, -1)

    active = is_active(coefficients)
    total = turned.sum(axis=2)
    rotation = np.full((n, 3, 3), np.nan)
    known = np.isfinite(total).all(axis=(1, 2)) & active.any(axis=1)
    rotation[known] = nearest_rotation(total[known])

    gram = blocks @ blocks.swapaxes(-1, -2) / (c**2)[:, None, None]
    skewed = np.linalg.norm(gram - np.eye(2), axis=(-2, -1)) > ORTHOGONAL
    tight = np.asarray(active.any(axis=1))
    tight[image[skewed & active[image, atom]]] = False
    return Reconstruction(shapes, coefficients, rotation, active.sum(axis=1), tight)


def combine(coefficients: Floats, atoms: Floats) -> Floats:
    """sum_i c_i B_i for each image; c (n, k), atoms B (k, 3, p) -> (n, 3, p).

    One product per image: a single one for all would round by how many there are, and results
    would depend on how the images are divided.
    """
    n, (k, three, p) = len(coefficients), atoms.shape
    shapes: Floats = (coefficients[:, None, :] @ atoms.reshape(k, three * p)).reshape(n, three, p)
    return shapes
