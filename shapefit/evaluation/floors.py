"""What a dictionary leaves of the truth at best: floors and ceilings of the errors of any fit."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats
from shapefit.dictionary.coding import sparse_code
from shapefit.evaluation.metrics import FEWEST_LANDMARKS, similarity
from shapefit.geometry.procrustes import rotation_onto

STILL = 1e-9
"""Fall of the squared residual, as a share of the shape's square, that ends the alternation."""
MAX_ROUNDS = 200


def nearest_atom(shapes: Floats, atoms: Floats) -> Floats:
    """Return min over i of similarity(B_i, S) for each shape; (n, 3, p), (k, 3, p) -> (n,)."""
    errors = [similarity(np.broadcast_to(atom, shapes.shape), shapes) for atom in atoms]
    return np.min(errors, axis=0)


def best_combination(shapes: Floats, atoms: Floats) -> Floats:
    """argmin over E = sum_i c_i B_i, c >= 0 of min over R, t of ||E - R S - t 1^T||_F^2.

    shapes (n, 3, p) with nan where a landmark is unknown, atoms (k, 3, p); returns E (n, 3, p) in
    the frame of the atoms, nan at unknown landmarks and where fewer than three are known. R and c
    take turns, once from the rotation onto the mean of the atoms and once from that onto the
    nearest atom, and the better end counts: it is never worse than any single atom, but may be a
    local minimum.
    """
    known = np.isfinite(shapes).all(axis=-2)
    best = np.full(shapes.shape, np.nan)
    for pattern in np.unique(known, axis=0):
        if pattern.sum() >= FEWEST_LANDMARKS:
            rows = np.flatnonzero((known == pattern).all(axis=-1))
            place = np.ix_(rows, np.arange(3), np.flatnonzero(pattern))
            best[place] = _combine(_centred(shapes[place]), _centred(atoms[..., pattern]))
    return best


def _combine(shapes: Floats, atoms: Floats) -> Floats:
    """Return the better of the two ends; all centred, none hidden."""
    sizes = np.linalg.norm(atoms, axis=(-2, -1), keepdims=True)
    directions = atoms / np.maximum(sizes, np.finfo(np.float64).tiny)  # an atom may be 0
    overlap = [((rotation_onto(shapes, B) @ shapes) * B).sum(axis=(-2, -1)) for B in directions]
    nearest = atoms[np.argmax(overlap, axis=0)]
    mean = np.broadcast_to(atoms.mean(axis=0), shapes.shape)
    (first, remains), (second, leaves) = (_alternate(shapes, atoms, at) for at in (mean, nearest))
    return np.where((leaves < remains)[:, None, None], second, first)


def _alternate(shapes: Floats, atoms: Floats, start: Floats) -> tuple[Floats, Floats]:
    """Take turns between rotations and non-negative least squares, from the rotations onto start.

    Returns the combinations (n, 3, p) and their squared residuals (n,).
    """
    size = (shapes**2).sum(axis=(-2, -1))
    combined, coefficients = start, None
    before = np.full(len(shapes), np.inf)
    for _ in range(MAX_ROUNDS):
        targets = rotation_onto(shapes, combined) @ shapes
        coefficients = sparse_code(targets, atoms, beta=0.0, start=coefficients)
        combined = np.tensordot(coefficients, atoms, axes=1)
        residual = ((combined - targets) ** 2).sum(axis=(-2, -1))
        if (before - residual <= STILL * size).all():
            break
        before = residual
    return combined, residual


def _centred(points: Floats) -> Floats:
    return points - points.mean(axis=-1, keepdims=True)
