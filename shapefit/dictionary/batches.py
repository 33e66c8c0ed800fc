"""Dictionary learning from more shapes than fit in memory: rounds that code them batch by batch.

An atom update needs sums over the shapes only (`Products`), so neither shapes nor coefficients are
kept: a round gives all shapes the same atoms as one in memory would from the same start.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from shapefit.arrays import Floats
from shapefit.dictionary.atoms import Products, update_atoms
from shapefit.dictionary.coding import sparse_code
from shapefit.dictionary.learning import BOUND, find_worst, of_norm_one, reach_beyond

SETTLED = 0.001
"""Rounds end after one that lowers the objective by a smaller share."""


@dataclass(frozen=True)
class Improved:
    """The state after a round: atoms (k, 3, p) and the trace, which grows as that of `Learned`."""

    atoms: Floats
    trace: Floats


@dataclass
class Coded:
    """Sums over shapes S and their coefficients C: products, sum ||S_j||_F^2 and sum C."""

    products: Products
    energy: float = 0.0
    cost: float = 0.0

    def add(self, shapes: Floats, coefficients: Floats) -> None:
        """Add shapes (n, 3, p) with coefficients (n, k)."""
        self.products.add(shapes, coefficients)
        self.energy += float((shapes**2).sum())
        self.cost += float(coefficients.sum())

    def objective(self, atoms: Floats, beta: float) -> float:
        """sum_j 1/2 ||S_j - sum_i C_ji B_i||_F^2 + beta sum C  for any atoms B (k, 3, p)."""
        overlap = np.tensordot(atoms, atoms, axes=([1, 2], [1, 2]))
        fitted = 2 * (self.products.pulls * atoms).sum() - (self.products.overlaps * overlap).sum()
        return float(0.5 * (self.energy - fitted) + beta * self.cost)


def improve(
    batches: Iterable[Floats], atoms: Floats, beta: float, *, iterations: int
) -> Iterator[Improved]:
    """Lower the objective of `learn` over all shapes, from atoms (k, 3, p) of a sample of them.

    batches give the shapes (n, 3, p), as `learn` takes them, in the same order whenever they are
    asked. They are read once to code the start, once a round, and once more in a round that
    replaces atoms which no shape uses. Ends after `iterations` rounds or a round that hardly
    lowered the objective (`SETTLED`); no half-step raises it. As in `learn`, atoms beyond each
    update are tried, too, and nothing is random.
    """
    B = atoms
    coded = code_all(batches, [B], beta)[0]
    trace = [coded.objective(B, beta)]
    for _ in range(iterations):
        dead = np.flatnonzero(np.diag(coded.products.overlaps) == 0)
        if len(dead):
            B = B.copy()
            B[dead] = worst_of_all(batches, B, beta, len(dead))
        updated = update_atoms(coded.products, B, BOUND)
        trace.append(coded.objective(updated, beta))
        tried = [updated, reach_beyond(B, updated)]
        found = code_all(batches, tried, beta)
        values = [each.objective(at, beta) for each, at in zip(found, tried, strict=True)]
        best = int(np.argmin(values))
        B, coded = tried[best], found[best]
        trace.append(values[best])
        yield Improved(B, np.array(trace))
        if trace[-1] > (1 - SETTLED) * trace[-3]:
            return


def code_all(batches: Iterable[Floats], tried: Sequence[Floats], beta: float) -> list[Coded]:
    """Code all shapes with each of several dictionaries (k, 3, p) and return the sums.

    The dictionaries should be near each other: each starts from the coefficients of the one before.
    """
    found = [Coded(Products.zero(atoms)) for atoms in tried]
    for shapes in batches:
        C = None
        for atoms, coded in zip(tried, found, strict=True):
            C = sparse_code(shapes, atoms, beta, start=C)
            coded.add(shapes, C)
    return found


def worst_of_all(batches: Iterable[Floats], atoms: Floats, beta: float, number: int) -> Floats:
    """Return new atoms (number, 3, p): shapes of norm 1 that the atoms reconstruct worst.

    From each batch and the best found before it, the best are kept, as `replace_dead_atoms` ranks
    them; the first is the worst of all shapes.
    """
    kept = np.empty((0, *atoms.shape[1:]))
    for shapes in batches:
        both = np.concatenate([kept, shapes])
        kept = both[find_worst(both, sparse_code(both, atoms, beta), atoms, number)]
    return of_norm_one(kept)
