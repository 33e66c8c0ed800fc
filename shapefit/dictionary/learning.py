"""Dictionary learning: alternate sparse coding and atom update (paper, eq. dl)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.dictionary.atoms import Products, update_atoms
from shapefit.dictionary.coding import objectives, sparse_code

BOUND = 1.0  # the largest norm of an atom
REACH = 0.5  # how far beyond its end the atom update is followed, in lengths of the update


@dataclass(frozen=True)
class Learned:
    """The state after a round.

    atoms (k, 3, p); coefficients (n, k), optimal for these atoms; trace (1 + 2 rounds,) the
    objective after the first coding and after every half-step since: atom update, coding, ...
    """

    atoms: Floats
    coefficients: Floats
    trace: Floats


def learn(
    shapes: Floats,
    k: int,
    beta: float,
    *,
    iterations: int,
) -> Iterator[Learned]:
    """min sum_j 1/2 ||S_j - sum_i C_ji B_i||_F^2 + beta sum C  over C >= 0, ||B_i||_F <= 1.

    shapes (n, 3, p), normalised, aligned, centred, none of them 0; k <= n atoms. The start
    is k shapes at even distances in the order given, scaled to norm 1, and their coding. Each of
    the `iterations` rounds updates the atoms, replaces dead ones, codes again, and yields its
    state; they end early where a round does not lower the objective.

    To need fewer rounds, the shapes are also coded with atoms that lie beyond the update, on the
    line from the old ones, and the better of the two is kept. So no half-step raises the
    objective. Nothing is random: equal shapes give equal atoms, and turning all shapes turns the
    atoms. Source: paper, eq. dl; the overrelaxation is our own.
    """
    n = len(shapes)
    if not 1 <= k <= n:
        raise ValueError(f"k must be within 1..{n} (the number of shapes), is {k}")
    chosen = shapes[evenly(n, k)]

    def total(B: Floats, C: Floats) -> float:
        return float(objectives(shapes, B, beta, C).sum())

    def recode(B: Floats, C: Floats | None) -> tuple[float, Floats, Floats]:
        if C is not None:
            B = replace_dead_atoms(shapes, C, B)
        C = sparse_code(shapes, B, beta, start=C)
        return total(B, C), B, C

    objective, B, C = recode(of_norm_one(chosen), None)
    trace = [objective]
    for _ in range(iterations):
        updated = update_atoms(Products.zero(B).add(shapes, C), B, BOUND)
        trace.append(total(updated, C))
        beyond = reach_beyond(B, updated)
        coded = recode(updated, C), recode(beyond, C)
        objective, B, C = min(coded, key=lambda state: state[0])
        trace.append(objective)
        yield Learned(B, C, np.array(trace))
        if trace[-1] >= trace[-3]:
            return


def replace_dead_atoms(shapes: Floats, coefficients: Floats, atoms: Floats) -> Floats:
    """Put the worst reconstructed training shape, scaled to norm 1, in place of a dead atom.

    An atom is dead if no shape uses it. Its coefficients are 0, so the objective stays. Of
    several dead atoms each later one gets the shape that is worst after the earlier ones have
    taken up their part of the residuals, so that neighbouring frames do not fill them all.
    """
    dead = np.flatnonzero(~coefficients.any(axis=0))
    if not len(dead):
        return atoms
    B = atoms.copy()
    worst = find_worst(shapes, coefficients, atoms, len(dead))
    for i, row in zip(dead, worst, strict=True):
        B[i] = of_norm_one(shapes[row])
    return B


def find_worst(shapes: Floats, coefficients: Floats, atoms: Floats, number: int) -> list[int]:
    """Return rows of the shapes that new atoms serve best, each after the earlier ones."""
    residual = shapes - np.tensordot(coefficients, atoms, axes=1)
    found = []
    for _ in range(number):
        found.append(int(np.linalg.norm(residual, axis=(1, 2)).argmax()))
        taken = of_norm_one(shapes[found[-1]])
        part = np.tensordot(residual, taken, axes=2)
        residual -= np.maximum(part, 0.0)[:, None, None] * taken
    return found


def evenly(n: int, number: int) -> NDArray[np.intp]:
    """Return `number` rows of n at even distances, the first and the last among them."""
    return np.linspace(0, n - 1, number).round().astype(np.intp)


def of_norm_one(shapes: Floats) -> Floats:
    """Return shapes (..., 3, p), none of them 0, scaled to the bound of atoms."""
    return shapes * (BOUND / np.linalg.norm(shapes, axis=(-2, -1), keepdims=True))


def reach_beyond(atoms: Floats, updated: Floats) -> Floats:
    """Return atoms (k, 3, p) beyond an update, on the line from the old ones, within the bound."""
    B = updated + REACH * (updated - atoms)
    return B * (BOUND / np.linalg.norm(B, axis=(1, 2), keepdims=True).clip(min=BOUND))
