"""Stacks of points (..., d, p), a landmark a column: arithmetic and draws of tests."""

import numpy as np
from numpy.testing import assert_allclose

from shapefit.arrays import Floats, Integers
from shapefit.geometry.rotations import random_rotations


def transpose(matrices: Floats) -> Floats:
    """Return each matrix of a stack (..., a, b) transposed: (..., b, a)."""
    return np.swapaxes(matrices, -2, -1)


def flatten(shapes: Floats) -> Floats:
    """Return shapes (n, 3, p) as rows (n, 3p)."""
    return shapes.reshape(len(shapes), -1)


def norms(shapes: Floats) -> Floats:
    """Return the Frobenius norm (...) of each shape."""
    return np.linalg.norm(shapes, axis=(-2, -1))


def centred(points: Floats) -> Floats:
    """Return points less the centroid of each set."""
    return points - points.mean(axis=-1, keepdims=True)


def mix(coefficients: Floats, atoms: Floats) -> Floats:
    """Return sum_i c_i B_i (n, 3, p) of coefficients (n, k) and atoms (k, 3, p)."""
    return np.tensordot(coefficients, atoms, axes=1)


def transform(transforms: Floats, atoms: Floats) -> Floats:
    """Return sum_i M_i B_i (n, 2, p) of transforms (n, k, 2, 3)."""
    return np.einsum("nkab,kbp->nap", transforms, atoms)


def edge_vectors(shapes: Floats, edges: Integers) -> Floats:
    """Return the vectors (n, 3, e) from the first end of each edge to the second."""
    start, end = np.transpose(edges)
    return shapes[:, :, end] - shapes[:, :, start]


def edge_lengths(shapes: Floats, edges: Integers) -> Floats:
    """Return the lengths (n, e) of edges."""
    return np.linalg.norm(edge_vectors(shapes, edges), axis=1)


def resized(shapes: Floats, sizes: Floats) -> Floats:
    """Return shapes (n, d, p), each times its size (n,)."""
    return sizes[:, None, None] * shapes


def unit_norm(atoms: Floats) -> Floats:
    """Return atoms (k, 3, p), each scaled to the norm 1."""
    return resized(atoms, 1 / norms(atoms))


def without_mean_depth(shapes: Floats) -> Floats:
    """Return shapes (n, 3, p) whose mean depth is 0."""
    shift = np.zeros_like(shapes)
    shift[:, 2] = shapes[:, 2].mean(axis=1, keepdims=True)
    return shapes - shift


def assert_rotations(R: Floats, atol: float = 1e-12) -> None:
    """Assert that matrices (..., 3, 3) are orthogonal, and that none mirrors."""
    identity = np.broadcast_to(np.eye(3), R.shape)
    assert_allclose(R @ transpose(R), identity, atol=atol)
    assert_allclose(np.linalg.det(R), 1)


def draw_rotations(n: int, k: int, rng: np.random.Generator) -> Floats:
    """Draw k rotations for each of n images (n, k, 3, 3)."""
    return random_rotations(n * k, rng).reshape(n, k, 3, 3)


def with_noise(points: Floats, sd: Floats | float, rng: np.random.Generator) -> Floats:
    """Return points, each coordinate moved by an error of a standard deviation."""
    return points + sd * rng.standard_normal(points.shape)


def chain(p: int) -> Integers:
    """Return the edges (p - 1, 2) of landmarks that follow one another."""
    return np.stack([np.arange(p - 1), np.arange(1, p)], axis=1)


def binary_tree(p: int) -> Integers:
    """Return the edges (p - 1, 2) from each landmark to the one halfway before it."""
    ends = np.arange(1, p)
    return np.stack([(ends - 1) // 2, ends], axis=1)
