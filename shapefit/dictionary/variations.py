"""Variations of training shapes: bodies with other bones, poses with limbs of other shapes.

A few subjects have few bodies and few combinations of what arms and legs do. Bones are the edges of
the shapes, which must form a tree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats

Indices = NDArray[np.integer]


@dataclass(frozen=True)
class Skeleton:
    """A tree of bones: order (p - 1,), the landmarks without the root, each after its parent (p,).

    limbs: for each chain of bones that ends in a leaf, the landmarks beyond its first bone; that
    bone, such as from the neck to a shoulder, belongs to the trunk.
    """

    order: tuple[int, ...]
    parent: tuple[int, ...]
    limbs: tuple[tuple[int, ...], ...]


def find_skeleton(edges: Indices, points: int) -> Skeleton:
    """Lay out the tree of edges (e, 2). Raises ValueError where they do not form one."""
    neighbours: list[list[int]] = [[] for _ in range(points)]
    for a, b in edges.tolist():
        neighbours[a].append(b)
        neighbours[b].append(a)
    if len(edges) != points - 1:
        raise ValueError(f"{len(edges)} edges of {points} landmarks are not a tree")
    root = max(range(points), key=lambda j: len(neighbours[j]))
    parent, order, todo = {root: root}, [], [root]
    while todo:
        at = todo.pop(0)
        for other in neighbours[at]:
            if other not in parent:
                parent[other] = at
                order.append(other)
                todo.append(other)
    if len(parent) != points:
        raise ValueError("the edges leave landmarks apart")
    limbs = []
    for leaf in range(points):
        if leaf == root or len(neighbours[leaf]) != 1:
            continue
        chain = [leaf]
        while parent[chain[-1]] != root and len(neighbours[parent[chain[-1]]]) == 2:
            chain.append(parent[chain[-1]])
        if len(chain) > 1:
            limbs.append(tuple(chain[-2::-1]))
    return Skeleton(tuple(order), tuple(parent[j] for j in range(points)), tuple(limbs))


def vary(
    shapes: Floats,
    skeleton: Skeleton,
    *,
    copies: int,
    stretch: float,
    exchange: float,
    partners: Indices | None = None,
) -> Floats:
    """(n, 3, p) -> (copies n, 3, p), aligned shapes varied at random, the same for equal shapes.

    exchange: share of the shapes each of whose limbs comes from another shape, drawn at random,
    bone by bone as it lies there. stretch: standard deviation of the logarithm of the length of a
    bone; landmarks and their partners (p,) stretch alike. The shapes are no longer normalised.
    """
    rng = np.random.default_rng(0)
    n, _, p = shapes.shape
    twin = np.arange(p) if partners is None else np.minimum(np.arange(p), partners)
    order, parent = list(skeleton.order), np.array(skeleton.parent)
    given = shapes - shapes[:, :, parent]  # the bone that ends in each landmark
    varied = []
    for _ in range(copies):
        bones = given.copy()
        exchanged = rng.random(n) < exchange
        for limb in skeleton.limbs:
            donors = rng.permutation(n)
            rows = np.flatnonzero(exchanged)
            for j in limb:
                bones[rows, :, j] = given[donors[rows], :, j]
        lengths = np.exp(stretch * rng.standard_normal((n, p)))[:, twin]
        bones *= lengths[:, None]
        built = shapes.copy()
        for j in order:
            built[:, :, j] = built[:, :, parent[j]] + bones[:, :, j]
        varied.append(built)
    return np.concatenate(varied)
