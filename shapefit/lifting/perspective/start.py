"""Where the refinement under perspective starts: place in depth, and coefficients."""

from __future__ import annotations

import numpy as np

from shapefit import core
from shapefit.arrays import Floats
from shapefit.geometry.pinhole import Camera


def place_in_depth(
    landmarks: Floats, weights: Floats, shape: Floats, camera: Camera, rotation: Floats
) -> Floats:
    """t (n, 3) at which R S, seen by weak perspective, has the size and place of the landmarks.

    The depth is that of the visible landmarks' middle; S (3, p), the rest as above.
    """
    omega = np.where(weights > 0, weights, 0.0) ** 2
    share = omega / omega.sum(axis=1, keepdims=True)
    X = rotation @ shape
    W = np.where(weights[:, None] > 0, landmarks, 0.0)
    middle, seen = np.einsum("nap,np->na", X, share), np.einsum("nap,np->na", W, share)
    rays = (W - camera.centre[..., None]) / camera.focal[..., None]
    ray = (seen - camera.centre) / camera.focal
    flat = X[:, :2] - middle[:, :2, None]
    spread = np.einsum("nap,nap,np->n", flat, flat, share)
    overlap = np.einsum("nap,nap,np->n", flat, rays - ray[..., None], share)
    # a rotation that fits not at all must not put the shape at infinity
    least = 0.1 * np.sqrt(
        spread * np.einsum("nap,nap,np->n", *(2 * (rays - ray[..., None],)), share)
    )
    with np.errstate(divide="ignore", invalid="ignore"):  # landmarks that are all in one place
        depth = spread / np.maximum(overlap, least)
    t = np.empty((len(W), 3))
    t[:, :2] = ray * depth[:, None] - middle[:, :2]
    t[:, 2] = camera.sign * depth - middle[:, 2]
    return t


def mean_coefficients(atoms: Floats, mean_shape: Floats) -> Floats:
    """argmin_{c >= 0} |sum_i c_i B_i - mean_shape|^2 + a little |c|^2: (k,).

    For exemplars all are alike, 1/k over the spread of their mean.
    """
    k = len(atoms)
    A = atoms.reshape(k, -1).T
    little = 1e-3 * np.linalg.norm(A, axis=0).max()
    c = np.zeros((1, k))
    core.code(
        gram=A.T @ A + little**2 * np.eye(k),
        pulls=np.reshape(mean_shape.ravel() @ A, (1, k)),
        smallest_moves=np.array([1e-12 * np.linalg.norm(mean_shape)]),
        coefficients=c,
        unsettled=np.zeros(1, dtype=bool),
        threads=1,
    )
    return c[0]
