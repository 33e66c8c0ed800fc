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

from dataclasses import dataclass
from itertools import combinations, combinations_with_replacement, permutations

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.verification.checks import FLOOR, Checks
from shapefit.verification.fit import OPTIMAL, Images
from shapefit.verification.program import Atoms

Indices = NDArray[np.integer]

ROOTS = 60
EDGES = tuple(combinations(range(4), 2))
TRIPLES = tuple(combinations_with_replacement(range(4), 3))
ON_THE_PLACE = 1e-14
"""How far a vertex may be from where it belongs: rounding of one sum of unit quaternions."""
SLIVER = 1e-12
"""Share of a multiplier's products that is held back for what lies between cells by rounding."""
LEAVES = 256
"""Cells that are checked together."""


@dataclass(frozen=True)
class Tree:
    """splits (c,), unit quaternions (v, 4) and multipliers (v, 2, p) of the tree of an image."""

    splits: Indices
    rotations: Floats
    multipliers: Floats


def check_certificate(images: Images, atoms: Atoms, kept: Flags | None, checks: Checks) -> Flags:
    """Check the trees that there are, and that an optimal image is within the tolerance.

    Returns the images (n,) that have a tree.
    """
    stated, n = images.columns, len(images.fitted)
    gap, objective = stated["relative_gap"], stated["objective"]
    whole = (images.inliers[:, None] ** 2 * images.points**2).sum(axis=(1, 2))
    allowed = images.allow(1 + whole / objective, 1.0)
    claim = "an optimal image is within the tolerance"
    optimal = stated["status"].astype(str) == OPTIMAL
    checks.add(claim, gap - images.fit.tolerance, allowed, of=optimal)
    trees, complete = read_trees(images), np.ones(n, dtype=bool)
    low, low_error, over, over_error, unbalanced, balance = np.zeros((6, n))
    bound = objective * (1 - gap)
    for image, tree in trees.items():
        leaves = unfold(tree)
        complete[image] = leaves is not None
        if leaves is None:
            continue
        one = SingleImage.of(images, image)
        value, low_error[image] = one.least_value(tree.multipliers)
        low[image] = bound[image] - value
        low_error[image] += FLOOR * abs(bound[image])
        unbalanced[image], balance[image] = one.imbalance(tree.multipliers)
        own = None if kept is None else kept[image]
        over[image], over_error[image] = one.excess(tree, leaves, atoms, own)
    made = np.isin(np.arange(n), list(trees))
    checks.hold("the cells hold all rotations", complete, of=made)
    checks.add("the multipliers are balanced", unbalanced, balance, of=made)
    checks.add("the multipliers have the value of the bound", low, low_error, of=made)
    checks.add("the multipliers are feasible in every cell", over, over_error, of=made)
    if made.any():
        checks.settled.update(name for name in stated if name.startswith("tree_"))
    return made


def read_trees(images: Images) -> dict[int, Tree]:
    """Return the trees of the images that have one."""
    stated = images.columns
    if "tree_cells" not in stated:
        return {}
    cells, vertices = stated["tree_cells"], stated["tree_vertices"]
    end_of_cells, end_of_vertices = np.cumsum(cells), np.cumsum(vertices)
    trees = {}
    for image in np.flatnonzero((cells > 0) & images.fitted).tolist():
        c = slice(end_of_cells[image] - cells[image], end_of_cells[image])
        v = slice(end_of_vertices[image] - vertices[image], end_of_vertices[image])
        parts = stated["tree_rotations"][v], stated["tree_multipliers"][v]
        trees[image] = Tree(stated["tree_splits"][c], *parts)
    return trees


def unfold(tree: Tree) -> Indices | None:
    """Return the vertices (l, 4) of the cells that are not split; None where something is amiss."""
    q = tree.rotations
    if len(q) < ROOTS or not is_600_cell(q[:ROOTS]):
        return None
    waiting = root_cells(q[:ROOTS])[::-1]
    middles: dict[tuple[int, int], int] = {}
    leaves = []
    for split in tree.splits.tolist():
        if not waiting or not -1 <= split < len(EDGES):
            return None
        cell = waiting.pop()
        if split == -1:
            leaves.append(cell)
            continue
        a, b = EDGES[split]
        edge = (min(cell[a], cell[b]), max(cell[a], cell[b]))
        if edge not in middles:
            middles[edge] = ROOTS + len(middles)
            if middles[edge] >= len(q) or not is_middle(q[middles[edge]], q[edge[0]], q[edge[1]]):
                return None
        middle = middles[edge]
        for end in (a, b):
            half = list(cell)
            half[end] = middle
            waiting.append(tuple(half))
    return None if waiting else np.array(leaves)


def is_600_cell(q: Floats) -> bool:
    """Whether quaternions (60, 4) are those of the 600-cell, one of each pair q, -q."""
    golden = (1 + np.sqrt(5)) / 2
    units = [tuple(row) for row in np.eye(4)]
    halves = [(0.5, *signs) for signs in np.array(np.meshgrid(*[[0.5, -0.5]] * 3)).reshape(3, -1).T]
    turned = []
    for order in permutations(range(4)):
        if np.linalg.det(np.eye(4)[list(order)]) > 0:
            for x in (0.5, -0.5):
                for y in (0.5 / golden, -0.5 / golden):
                    vertex = np.zeros(4)
                    vertex[list(order)] = golden / 2, x, y, 0
                    turned.append(tuple(vertex))
    known = np.array([*units, *halves, *turned])
    near = np.abs(q @ known.T) >= 1 - ON_THE_PLACE
    exact = np.abs(np.linalg.norm(q, axis=1) - 1) <= ON_THE_PLACE
    return bool(exact.all() and (near.sum(axis=0) == 1).all() and (near.sum(axis=1) == 1).all())


def root_cells(q: Floats) -> list[tuple[int, ...]]:
    """Return the 300 cells of four neighbours each, in the order of their vertices."""
    inner = q @ q.T
    sign = np.where(np.abs(inner) > 0.8, np.sign(inner), 0.0)
    np.fill_diagonal(sign, 0)
    cells: list[tuple[int, ...]] = []
    for a in range(ROOTS):
        near = [b for b in range(a + 1, ROOTS) if sign[a, b]]
        for b, c, d in combinations(near, 3):
            pairs = ((b, c), (b, d), (c, d))
            if all(sign[x, y] * sign[a, x] * sign[a, y] > 0 for x, y in pairs):
                cells.append((a, b, c, d))
    return cells


def is_middle(q: Floats, one: Floats, other: Floats) -> bool:
    """Whether q or -q is half-way between two unit quaternions, or one and the other's negative."""
    middle = one + np.sign(one @ other) * other
    middle *= np.sign(q @ middle) / np.linalg.norm(middle)
    return bool(np.abs(q - middle).max() <= ON_THE_PLACE)


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


@dataclass(frozen=True)
class SingleImage:
    """What a proof rests on: points V (2, p), weights omega (p,), lambda, bounds on rounding."""

    points: Floats
    omega: Floats
    lam: float
    factor: float
    points_error: float

    @classmethod
    def of(cls, images: Images, image: int) -> SingleImage:
        """Return one of the images, with the weights of the squared loss."""
        return cls(
            images.points[image],
            images.inliers[image],
            float(images.lam[image]),
            float(images.factor[image]),
            float(images.points_error[image]),
        )

    def least_value(self, Y: Floats) -> tuple[float, float]:
        """Least D = <Y, Omega o V> - 1/2 ||Y||^2 of Y (v, 2, p), and a bound on its rounding."""
        weighted = Y * self.omega
        along = (weighted * self.points).sum(axis=(1, 2))
        square = (Y**2).sum(axis=(1, 2))
        size = (np.abs(weighted) * np.abs(self.points)).sum(axis=(1, 2)) + square
        error = self.factor * size + np.abs(weighted).sum(axis=(1, 2)) * self.points_error
        error += self.factor * np.abs(weighted).sum(axis=(1, 2)) * np.abs(self.points).max()
        return float((along - square / 2).min()), float(error.max())

    def imbalance(self, Y: Floats) -> tuple[float, float]:
        """Largest |Y omega| of Y (v, 2, p), and what rounding allows."""
        weighted = Y * self.omega
        size = np.abs(weighted).sum(axis=2).max()
        return float(np.abs(weighted.sum(axis=2)).max()), max(self.factor, FLOOR) * float(size)

    def excess(
        self, tree: Tree, leaves: Indices, atoms: Atoms, kept: Flags | None
    ) -> tuple[float, float]:
        """Largest excess of a coefficient in cells (l, 4), and what rounding allows."""
        v, _, p = tree.multipliers.shape
        weighted = (tree.multipliers * self.omega).reshape(2 * v, p)
        G = (weighted @ atoms.columns).reshape(v, 2, 3, atoms.count)
        if kept is not None:
            G = G[..., kept]
        size = np.sqrt((G**2).sum(axis=(1, 2))).max(initial=0.0)
        products = G.reshape(v, 6, -1)
        worst = -np.inf
        for start in range(0, len(leaves), LEAVES):
            some = leaves[start : start + LEAVES]
            worst = max(worst, self._excess_in(products, tree, some))
        entries = np.abs(weighted).sum(axis=1).max() * atoms.reach
        return worst + 3 * SLIVER * size, 6 * max(self.factor, FLOOR / 6) * (
            float(entries) + self.lam
        )

    def _excess_in(self, G: Floats, tree: Tree, leaves: Indices) -> float:
        q = tree.rotations[leaves]
        q = q * np.where((q[:, :1] * q).sum(axis=2) < 0, -1.0, 1.0)[..., None]
        Q = bilinear(q[:, :, None], q[:, None]).reshape(*leaves.shape, 4, 6)
        inner = np.einsum("lae,lbe->lab", q, q)
        worst = -np.inf
        for a, b, c in TRIPLES:
            left = np.einsum("le,lei->li", Q[:, b, c], G[leaves[:, a]])
            left += np.einsum("le,lei->li", Q[:, a, c], G[leaves[:, b]])
            left += np.einsum("le,lei->li", Q[:, a, b], G[leaves[:, c]])
            right = self.lam * (inner[:, b, c] + inner[:, a, c] + inner[:, a, b])
            worst = max(worst, float((left - right[:, None]).max(initial=-np.inf)))
        return worst
