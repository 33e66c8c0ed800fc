"""The bound on all rotations: a tree of cells, and at its vertices multipliers that prove it.

A cell is the cone over four unit quaternions q_a; with mu >= 0, sum mu = 1 and q = sum mu_a q_a the
multiplier Y(mu) = sum mu_a Y_a has a value D of at least the least one of the vertices, for D is
concave. It bounds the objective at the rotation of q where it is feasible there:
<Y(mu) o Omega, Q(q, q) B_i> <= lambda |q|^2 for every atom, Q(q, q) = |q|^2 Rbar. In Bernstein form
it is feasible in the whole cell if for all a <= b <= c, with G_a = (Y_a o Omega) B_i^T,

    <G_a, Q(q_b, q_c)> + <G_b, Q(q_a, q_c)> + <G_c, Q(q_a, q_b)>
        <= lambda (q_b.q_c + q_a.q_c + q_a.q_b).

The cells begin as those of the 600-cell modulo sign, which hold all rotations, in the order of
their vertices; those that are split are cut in two, the half that keeps the first end of the edge
before the other.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.verification.checks import FLOOR, Checks
from shapefit.verification.fit import TREE, Images
from shapefit.verification.program import Atoms

Indices = NDArray[np.integer]

ROOTS = 60
"""Vertices of the 600-cell, one of each pair q, -q."""
PHI = (1 + np.sqrt(5)) / 2
BETWEEN = np.sort(np.repeat([0, 0.5 / PHI, 0.5, PHI / 2, 1], [15, 12, 20, 12, 1]))
"""|q.q'| of one of these with all: no other 120 points of the sphere are as far apart."""
EDGES = tuple(combinations(range(4), 2))
TRIPLES = tuple(combinations_with_replacement(range(4), 3))
ON_THE_PLACE = 1e-14
"""How far a vertex may be from where it belongs: rounding of one sum of unit quaternions."""
SLIVER = 1e-12
"""Share of a multiplier's products that is held back for what lies between cells by rounding."""
LEAVES = 256
"""Cells that are checked together."""


def check_tree(images: Images, atoms: Atoms, kept: Flags | None, checks: Checks) -> Flags:
    """Check the trees of the images that have one, and return which have (n,).

    kept (n, k): the atoms that each image could use, None for all.
    """
    images = replace(images, weights=images.inliers)
    stated = images.columns
    cells, vertices = stated["tree_cells"], stated["tree_vertices"]
    made = (cells > 0) & images.fitted
    complete = np.ones_like(made)
    low, over, unbalanced, allowed_low, allowed_over, allowed_balance = np.zeros((6, len(made)))
    hidden = np.zeros(len(made))
    bound = stated["objective"] * (1 - stated["relative_gap"])
    for i in np.flatnonzero(made).tolist():
        c, v = (slice(n[:i].sum(), n[: i + 1].sum()) for n in (cells, vertices))
        q, Y = stated["tree_rotations"][v], stated["tree_multipliers"][v]
        leaves = unfold(stated["tree_splits"][c], q)
        complete[i] = leaves is not None
        if leaves is None:
            continue
        V, lam, rounding = images.points[i], images.lam[i], images.rounding[i]
        weighted = Y * images.weights[i]
        hidden[i] = np.abs(Y * (images.weights[i] == 0)).max()
        along, square = (weighted * V).sum(axis=(1, 2)), (Y**2).sum(axis=(1, 2))
        sizes = np.abs(weighted).sum(axis=2)  # (v, 2)
        low[i] = bound[i] - (along - square / 2).min()
        terms = square + 4 * sizes.sum(axis=1) * (1 + np.abs(V).max())
        allowed_low[i] = rounding * terms.max() + FLOOR * abs(bound[i])
        unbalanced[i] = np.abs(weighted.sum(axis=2)).max()
        allowed_balance[i] = max(rounding, FLOOR) * sizes.max()
        own = slice(None) if kept is None else kept[i]
        over[i] = excess(weighted, q, leaves, atoms, lam, own)
        allowed_over[i] = max(6 * rounding, FLOOR) * (sizes.max() * atoms.reach + lam)
    checks.hold("the cells hold all rotations", complete, of=made)
    checks.add("the multipliers are 0 where nothing is seen", hidden, 0.0, of=made)
    checks.add("the multipliers are balanced", unbalanced, allowed_balance, of=made)
    checks.add("the multipliers have the value of the bound", low, allowed_low, of=made)
    checks.add("the multipliers are feasible in every cell", over, allowed_over, of=made)
    checks.settled.update(TREE.split() if made.any() else ())
    return made


def unfold(splits: Indices, q: Floats) -> Indices | None:
    """Return the vertices (l, 4) of the cells that are not split; None where something is amiss.

    splits (c,): the edge that cuts each cell, -1 for none; q (v, 4).
    """
    inner = q[:ROOTS] @ q[:ROOTS].T
    if inner.shape != (ROOTS, ROOTS) or not _near(np.sort(np.abs(inner)), BETWEEN):
        return None
    waiting = root_cells(inner)[::-1]
    middles: dict[tuple[int, int], int] = {}
    leaves = []
    for split in splits.tolist():
        if not waiting or not -1 <= split < len(EDGES):
            return None
        cell = waiting.pop()
        if split == -1:
            leaves.append(cell)
            continue
        ends = [cell[end] for end in EDGES[split]]
        new = middles.setdefault((min(ends), max(ends)), ROOTS + len(middles))
        if new >= len(q) or not is_middle(q[new], *q[sorted(ends)]):
            return None
        waiting += [tuple(new if a == end else a for a in cell) for end in ends]
    return None if waiting else np.array(leaves)


def root_cells(inner: Floats) -> list[tuple[int, ...]]:
    """Return the 300 cells of four neighbours each, by products of the vertices (60, 60).

    The signs of four vertices can be chosen so that all are near each other.
    """
    sign = np.sign(inner) * (np.abs(inner) > 0.8) * ~np.eye(ROOTS, dtype=bool)
    cells: list[tuple[int, ...]] = []
    for a in range(ROOTS):
        near = [b for b in range(a + 1, ROOTS) if sign[a, b]]
        cells += [
            (a, *some)
            for some in combinations(near, 3)
            if all(sign[x, y] * sign[a, x] * sign[a, y] > 0 for x, y in combinations(some, 2))
        ]
    return cells


def is_middle(q: Floats, one: Floats, other: Floats) -> bool:
    """Whether q or -q is half-way between two unit quaternions, or one and the other's negative."""
    middle = one + np.sign(one @ other) * other
    return _near(q, middle * np.sign(q @ middle) / np.linalg.norm(middle))


def _near(found: Floats, expected: Floats) -> bool:
    return bool(np.abs(found - expected).max() <= ON_THE_PLACE)


def bilinear(p: Floats, q: Floats) -> Floats:
    """Q(p, q) (..., 2, 3), symmetric, with Q(q, q) = |q|^2 Rbar, for quaternions (..., 4)."""
    outer = p[..., :, None] * q[..., None, :]
    outer = (outer + outer.swapaxes(-1, -2)) / 2
    w, x, y, z = range(4)
    squares = [outer[..., e, e] for e in range(4)]
    rows = [
        squares[w] + squares[x] - squares[y] - squares[z],
        2 * (outer[..., x, y] - outer[..., w, z]),
        2 * (outer[..., x, z] + outer[..., w, y]),
        2 * (outer[..., x, y] + outer[..., w, z]),
        squares[w] - squares[x] + squares[y] - squares[z],
        2 * (outer[..., y, z] - outer[..., w, x]),
    ]
    return np.stack(rows, axis=-1).reshape(*outer.shape[:-2], 2, 3)


def excess(
    weighted: Floats, q: Floats, leaves: Indices, atoms: Atoms, lam: float, kept: Flags | slice
) -> float:
    """Largest excess over lambda of a coefficient of the Bernstein form in cells (l, 4).

    weighted Y o Omega (v, 2, p) at the vertices q (v, 4).
    """
    v, _, p = weighted.shape
    G = (weighted.reshape(2 * v, p) @ atoms.columns).reshape(v, 6, atoms.count)[..., kept]
    worst = -np.inf
    for start in range(0, len(leaves), LEAVES):
        cells = leaves[start : start + LEAVES]
        corners = q[cells]
        corners = corners * np.where((corners[:, :1] * corners).sum(2) < 0, -1.0, 1.0)[..., None]
        Q = bilinear(corners[:, :, None], corners[:, None]).reshape(*cells.shape, 4, 6)
        inner = np.einsum("lae,lbe->lab", corners, corners)
        for a, b, c in TRIPLES:
            left = np.einsum("le,lei->li", Q[:, b, c], G[cells[:, a]])
            left += np.einsum("le,lei->li", Q[:, a, c], G[cells[:, b]])
            left += np.einsum("le,lei->li", Q[:, a, b], G[cells[:, c]])
            right = lam * (inner[:, b, c] + inner[:, a, c] + inner[:, a, b])
            worst = max(worst, float((left - right[:, None]).max(initial=-np.inf)))
    size = np.sqrt((G**2).sum(axis=1)).max(initial=0.0)
    return worst + 3 * SLIVER * float(size)
