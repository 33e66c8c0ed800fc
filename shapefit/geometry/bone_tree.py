"""Edges between landmarks as one tree of bones, whose nodes can each turn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree, shortest_path
from scipy.spatial.distance import cdist

from shapefit.arrays import Floats, Integers

FRAMES = 200
"""Frames, spread over a motion, that say which landmarks keep their distance."""

BRANCHES = 3
"""Bones at a landmark whose directions make a frame."""


@dataclass(frozen=True)
class Node:
    """What turns at the landmark `joint`; `above` is its parent's number, -1 for the root.

    aims are the landmarks at the other ends of its bones. Where several bones leave a landmark,
    its first node turns with all of them, and one more node per bone turns with that alone, since
    the bones of a body do not keep their angles.
    """

    joint: int
    above: int
    aims: tuple[int, ...]


def find_tree(points: Floats, edges: Integers, root: int | None = None) -> tuple[Node, ...]:
    """Return the tree of those bones that keep their lengths best: parents first, limb by limb.

    points (f, 3, p), all known; edges (e, 2) come before other pairs of landmarks, which join only
    what edges leave apart. The root is by default the landmark from which the fewest bones lead to
    all others, of those where bones branch if there are any.
    """
    cost = 1 + _spread_of_distances(points)  # what is nearly 0 would be no edge to scipy
    apart = np.ones_like(cost)
    apart[edges[:, 0], edges[:, 1]] = apart[edges[:, 1], edges[:, 0]] = 0
    tree = minimum_spanning_tree(np.triu(cost + cost.max() * apart, 1))
    if root is None:
        hops = shortest_path(tree, directed=False, unweighted=True)
        branches = np.count_nonzero(hops == 1, axis=1) >= BRANCHES
        root = int(np.where(branches | ~branches.any(), hops.sum(axis=1), np.inf).argmin())
    order, above = breadth_first_order(tree, root, directed=False)
    children: list[list[int]] = [[] for _ in above]
    for landmark in sorted(order[1:].tolist()):
        children[above[landmark]].append(landmark)
    return tuple(_nodes(root, [tuple(each) for each in children]))


def _spread_of_distances(points: Floats) -> Floats:
    """Standard deviation (p, p) of the distance of two landmarks."""
    rows = np.linspace(0, len(points) - 1, min(len(points), FRAMES)).astype(int)
    distances = [cdist(each, each) for each in points[rows].swapaxes(1, 2)]
    mean = sum(distances) / len(rows)
    square = sum((each - mean) ** 2 for each in distances) / len(rows)
    spread: Floats = np.sqrt(square)
    return spread


def _nodes(root: int, children: Sequence[tuple[int, ...]]) -> Iterator[Node]:
    waiting = [Node(root, -1, children[root])]
    count = 0
    while waiting:
        node = waiting.pop()
        yield node
        for child in reversed(node.aims):
            alone = len(node.aims) == 1
            joint, aims = (child, children[child]) if alone else (node.joint, (child,))
            waiting.append(Node(joint, count, aims))
        count += 1


def find_bones(tree: Sequence[Node]) -> dict[int, int]:
    """Return the landmark where each bone ends -> the one where it begins."""
    ends = ((node.joint, tree[node.above].joint) for node in tree[1:])
    return {end: start for end, start in ends if end != start}
