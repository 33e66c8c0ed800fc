"""Dictionary learning: alternate sparse coding and atom update; PCA bases.

min sum_j 1/2 ||S_j - sum_i C_ji B_i||_F^2 + beta sum C  over C >= 0, ||B_i||_F <= 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from shapefit.arrays import Floats
from shapefit.dictionary.coding import flatten_shapes, objectives, sparse_code
from shapefit.geometry.normalisation import std

MAX_ATOM_NORM = 1.0
"""The largest norm of an atom."""

OVERRELAXATION = 0.5
"""How far beyond its end the atom update is followed, in lengths of the update."""


@dataclass(frozen=True, eq=False)
class Learned:
    """Atoms and coefficients after a round of dictionary learning.

    atoms (k, 3, p); coefficients (n, k), optimal for these atoms; trace (1 + 2 rounds,)
    the objective after the first coding and after every half-step since: atom update,
    coding, ...
    """

    atoms: Floats
    coefficients: Floats
    trace: Floats


def learn_atoms(
    shapes: Floats,
    k: int,
    beta: float,
    *,
    iterations: int,
) -> Iterator[Learned]:
    """Learn k atoms of which shapes are sparse mixtures; yield the state of each round.

    min sum_j 1/2 ||S_j - sum_i C_ji B_i||_F^2 + beta sum C over C >= 0 and ||B_i||_F <=
    1. Raises ValueError unless 1 <= k <= n.

    shapes (n, 3, p), normalised, aligned, centred, none of them 0; k <= n atoms. The
    start is k shapes at even distances in the order given, scaled to norm 1, and their
    coding. Each of the `iterations` rounds updates the atoms, replaces dead ones, codes
    again, and yields its state; they end early where a round does not lower the
    objective.

    To need fewer rounds, the shapes are also coded with atoms that lie beyond the
    update, on the line from the old ones, and the better of the two is kept. So no
    half-step raises the objective. Nothing is random: equal shapes give equal atoms,
    and turning all shapes turns the atoms. Source: paper, eq. dl; the overrelaxation is
    our own.
    """
    n = len(shapes)
    if not 1 <= k <= n:
        raise ValueError(f"k must be within 1..{n} (the number of shapes), is {k}")
    chosen = shapes[np.linspace(0, n - 1, k).round().astype(np.intp)]

    def total(B: Floats, C: Floats) -> float:
        """Return the objective of atoms B and coefficients C over all shapes."""
        return float(objectives(shapes, B, beta, C).sum())

    def recode(B: Floats, C: Floats | None) -> tuple[float, Floats, Floats]:
        """Replace dead atoms and code; return objective, atoms and coefficients."""
        if C is not None:
            B = replace_dead_atoms(shapes, C, B)
        C = sparse_code(shapes, B, beta, start=C)
        return total(B, C), B, C

    objective, B, C = recode(scale_to_norm_one(chosen), None)
    trace = [objective]
    for _ in range(iterations):
        updated = update_atoms(shapes, C, B)
        trace.append(total(updated, C))
        beyond = updated + OVERRELAXATION * (updated - B)
        norm = np.linalg.norm(beyond, axis=(1, 2), keepdims=True)
        beyond *= MAX_ATOM_NORM / norm.clip(min=MAX_ATOM_NORM)
        coded = [recode(updated, C), recode(beyond, C)]
        objective, B, C = min(coded, key=lambda state: state[0])
        trace.append(objective)
        yield Learned(B, C, np.array(trace))
        if trace[-1] >= trace[-3]:
            return


def update_atoms(
    shapes: Floats,
    coefficients: Floats,
    atoms: Floats,
    bound: float = MAX_ATOM_NORM,
    sweeps: int = 5,
) -> Floats:
    """Return atoms that reconstruct the shapes better, with the coefficients fixed.

    Lowers 1/2 sum_j ||S_j - sum_i C_ji B_i||_F^2 over ||B_i||_F <= bound. shapes S (n,
    3, p), coefficients C (n, k); atoms (k, 3, p) within the bound, the place to start.
    Block coordinate descent: with the other atoms fixed, the best B_i is the projection
    of its unconstrained minimum on the ball, so no step raises the objective. Atoms
    that no shape uses stay as they are. Source: Mairal et al. 2010, algorithm 2.
    """
    A = coefficients.T @ coefficients
    D = coefficients.T @ flatten_shapes(shapes)
    B = np.array(flatten_shapes(atoms))
    used = np.flatnonzero(A.diagonal() > 0)
    for _ in range(sweeps):
        for i in used:
            one = B[i] + (D[i] - A[i] @ B) / A[i, i]
            B[i] = one * (bound / max(float(np.linalg.norm(one)), bound))
    return B.reshape(atoms.shape)


def replace_dead_atoms(shapes: Floats, coefficients: Floats, atoms: Floats) -> Floats:
    """Put the worst reconstructed training shapes in place of dead atoms.

    An atom is dead if no shape uses it. Its coefficients are 0, so the objective stays;
    the shape is scaled to norm 1. Of several dead atoms each later one gets the shape
    that is worst after the earlier ones have taken up their part of the residuals, so
    that neighbouring frames do not fill them all.
    """
    dead = np.flatnonzero(~coefficients.any(axis=0))
    if not len(dead):
        return atoms
    B = atoms.copy()
    residual = shapes - np.tensordot(coefficients, atoms, axes=1)
    for i in dead:
        worst = np.linalg.norm(residual, axis=(1, 2)).argmax()
        B[i] = scale_to_norm_one(shapes[worst])
        part = np.maximum(np.tensordot(residual, B[i], axes=2), 0.0)
        residual -= part[:, None, None] * B[i]
    return B


def scale_to_norm_one(shapes: Floats) -> Floats:
    """Return shapes (..., 3, p), none of them 0, scaled to the norm 1 of an atom."""
    norm = np.linalg.norm(shapes, axis=(-2, -1), keepdims=True)
    bounded: Floats = shapes * (MAX_ATOM_NORM / norm)
    return bounded


def scale_of_atoms(atoms: Floats, coefficients: Floats, scale: Floats) -> Floats:
    """Return the factors (k,) from atoms to the mean size of the shapes that use them.

    (sum_j C_ji s_j / sum_j C_ji) / std(B_i). A learned atom has no size: grown to the
    standard deviation 1 of a normalised shape it is as large as the training shapes are
    on average, each by its share in the atom's use. One that no shape uses is as large
    as all shapes are on average.

    atoms B (k, 3, p), none 0; coefficients C (n, k); scale s (n,), by which shapes were
    normalised. All are > 0.
    """
    use = coefficients.sum(axis=0)
    size = np.full(len(atoms), float(scale.sum()) / len(scale))
    np.divide(scale @ coefficients, use, out=size, where=use > 0)
    sizes: Floats = size / std(atoms)
    return sizes


def principal_components(shapes: Floats, bases: float = 0.99) -> Floats:
    """Return the directions (m, 3, p) in which shapes differ most from their mean.

    shapes (n, 3, p), n >= 1, normalised, aligned, centred. The directions are
    orthonormal, the strongest first, each with its largest entry positive. m is
    `bases`, or, where that is below 1, the least number that holds this share of the
    summed squared distances from the mean; at most the rank, and so 0 for shapes that
    are all alike. The dictionary of matching pursuit concatenates those of all
    activities. Source: Ramakrishna, Kanade and Sheikh 2012.
    """
    X = (shapes - shapes.mean(axis=0)).reshape(len(shapes), -1)
    _, s, directions = np.linalg.svd(X, full_matrices=False)
    # Shapes come from files in single precision, and what aligns them rounds them
    # differently.
    largest_coordinate = np.abs(shapes).max(initial=0.0)
    rounding = np.finfo(np.float32).eps * np.sqrt(X.size) * largest_coordinate
    rank = int((s > rounding).sum())
    if rank == 0 or bases >= 1:
        number = int(bases)
    else:
        explained = np.cumsum(s[:rank] ** 2)
        number = int((explained < bases * explained[-1]).sum()) + 1
    retained = directions[: min(number, rank)]
    place = np.abs(retained).argmax(axis=1)[:, None]
    largest = np.take_along_axis(retained, place, axis=1)
    components: Floats = retained * np.sign(largest)
    return components.reshape(-1, *shapes.shape[1:])
