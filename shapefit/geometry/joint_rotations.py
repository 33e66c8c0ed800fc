"""Rotations of a tree of bones that carry its pose at rest through a motion.

    x_child = x + G (l r),    G = P L

where r is the direction of a bone at rest and l its length, G the rotation of a node in
space, P the rotation of its parent and L its own, which files of animation hold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import (
    breadth_first_order,
    minimum_spanning_tree,
    shortest_path,
)
from scipy.spatial.distance import cdist

from shapefit.arrays import Floats, Integers
from shapefit.geometry.rotations import (
    nearest_rotation,
    rotation_about,
    shortest_rotations,
)

FRAMES_COMPARED = 200
"""Frames, evenly over a motion, that say which landmarks keep their distance."""

PARENT_WEIGHT = 0.02
"""Of the parent's rotation beside bones, of 1 each, that may all lie in one line."""

RestPose = Mapping[int, Sequence[float]]
"""Landmark where a bone ends -> the direction (3,) of the bone."""


class Node(NamedTuple):
    """A joint of the tree at the landmark `joint`.

    `above` is the number of its parent, or -1; aims are the landmarks at the other ends
    of its bones. Where several bones leave a landmark, its first node turns with all of
    them, and one more node per bone turns with that alone.
    """

    joint: int
    above: int
    aims: tuple[int, ...]


class Rig(NamedTuple):
    """A tree of m nodes in motion.

    Offsets (m, 3) at rest and rotations L (m, f, 3, 3) are in the frame of the parent;
    root (f, 3) is where the first node is; rest, the frame that the pose is made of.
    """

    tree: tuple[Node, ...]
    offsets: Floats
    rotations: Floats
    root: Floats
    rest: int


def find_rig(
    points: Floats,
    edges: Integers,
    root: int | None = None,
    pose: RestPose | None = None,
) -> Rig:
    """Fit a rig, a tree of bones with rotations, to the motion of points (f, 3, p).

    All points are known. The tree is that of `find_tree`. At rest bones have their
    median lengths and the directions of `pose`. Bones without one turn with their
    parent, from the pose of a usual frame.
    """
    tree = find_tree(points, edges, root)
    rest = _find_rest_frame(points, tree)
    starts = points[:, :, [tree[node.above].joint for node in tree]]
    ends = points[:, :, [node.joint for node in tree]]
    bones = np.moveaxis(ends - starts, -1, 0)
    bones[0] = 0
    lengths = np.median(np.linalg.norm(bones, axis=2), axis=1)
    at_rest = _unit(bones[:, rest])
    G = _find_rotations(points, tree, rest)
    directions = {
        node.joint: direction
        for node, length, direction in zip(tree, lengths, at_rest, strict=True)
        if length
    }
    T = _find_pose_rotations(tree, directions, pose or {})
    above = [node.above for node in tree[1:]]
    relative = G[above].swapaxes(-1, -2) @ G[1:]
    L = np.concatenate([G[:1], relative])
    P = np.concatenate([np.eye(3)[None], T[above]])
    offsets = (P @ (lengths[:, None] * at_rest)[..., None])[..., 0]
    rotations = P[:, None] @ L @ T[:, None].swapaxes(-1, -2)
    return Rig(tree, offsets, rotations, points[:, :, tree[0].joint], rest)


def place_nodes(rig: Rig) -> Floats:
    """Return the positions (m, f, 3) of the nodes of a rig in each frame."""
    places = [rig.root]
    G = [rig.rotations[0]]
    for node, offset, L in zip(
        rig.tree[1:], rig.offsets[1:], rig.rotations[1:], strict=True
    ):
        places.append(places[node.above] + G[node.above] @ offset)
        G.append(G[node.above] @ L)
    return np.array(places)


def find_tree(
    points: Floats, edges: Integers, root: int | None = None
) -> tuple[Node, ...]:
    """Return the tree of bones between points (f, 3, p) whose lengths change least.

    Parents come first, limb by limb. All points are known; edges (e, 2) come before
    other pairs of landmarks, which join only what edges leave apart. The root is by
    default the landmark with the fewest bones to all others.
    """
    graph = minimum_spanning_tree(np.triu(_joining_cost(points, edges), 1))
    if root is None:
        bones_between = shortest_path(graph, directed=False, unweighted=True)
        root = int(bones_between.sum(axis=1).argmin())
    order, above = breadth_first_order(graph, root, directed=False)
    children: list[tuple[int, ...]] = [() for _ in above]
    for landmark in sorted(order[1:].tolist()):
        children[above[landmark]] += (landmark,)
    nodes: list[Node] = []
    waiting = [Node(root, -1, children[root])]
    while waiting:
        node = waiting.pop()
        for child in reversed(node.aims):
            if len(node.aims) == 1:
                follower = Node(child, len(nodes), children[child])
            else:  # one more node at the same landmark, for this bone alone
                follower = Node(node.joint, len(nodes), (child,))
            waiting.append(follower)
        nodes.append(node)
    return tuple(nodes)


def _joining_cost(points: Floats, edges: Integers) -> Floats:
    """Return the cost (p, p) of a bone between two landmarks: how its length changes.

    1 and the standard deviation of their distance. Pairs that are no edge cost more
    than all edges.
    """
    rows = np.linspace(0, len(points) - 1, min(len(points), FRAMES_COMPARED))
    compared = points[rows.astype(int)].swapaxes(1, 2)
    distances = np.stack([cdist(x, x) for x in compared])
    cost = 1 + distances.std(axis=0)  # what is nearly 0 would be no edge to scipy
    is_no_edge = np.ones_like(cost)
    is_no_edge[edges[:, 0], edges[:, 1]] = 0
    is_no_edge[edges[:, 1], edges[:, 0]] = 0
    return np.asarray(cost + cost.max() * is_no_edge)


def find_bones(tree: Sequence[Node]) -> dict[int, int]:
    """Return the bones of a tree: the landmark where one ends -> where it begins."""
    ends = ((node.joint, tree[node.above].joint) for node in tree[1:])
    return {end: start for end, start in ends if end != start}


def _find_rest_frame(points: Floats, tree: Sequence[Node]) -> int:
    """Return the index of the frame (f, 3, p) with joints bent most like the median.

    How far a joint is bent shows in the distance of the landmarks on both sides of it.
    """
    start_of = find_bones(tree)
    pairs = [
        (end, start_of[joint]) for end, joint in start_of.items() if joint in start_of
    ]
    i, j = np.reshape(pairs, (-1, 2)).astype(int).T
    bends = np.linalg.norm(points[:, :, i] - points[:, :, j], axis=1)
    unlike = np.abs(bends - np.median(bends, axis=0)).sum(axis=1)
    return int(unlike.argmin())


def _find_rotations(points: Floats, tree: Sequence[Node], rest: int) -> Floats:
    """Return the rotations G (m, f, 3, 3) in space of all nodes since frame `rest`.

    Several bones turn by least squares. A single bone turns the shortest way from its
    mean direction, seen by its parent, and then about itself as the bones that follow
    do.
    """
    G = np.empty((len(tree), len(points), 3, 3))
    for number, node in enumerate(tree):
        if node.above >= 0:
            P = G[node.above]
        else:
            P = np.tile(np.eye(3), (len(points), 1, 1))
        bones = _directions(points, node.joint, node.aims)
        if not bones:
            G[number] = P
        elif len(bones) > 1:
            A = sum(bone[:, :, None] * bone[rest] for bone in bones)
            G[number] = nearest_rotation(A + PARENT_WEIGHT * P)
        else:
            (end,) = node.aims
            beyond = next(other.aims for other in tree if other.joint == end)
            following = _directions(points, end, beyond)
            seen = [_turn_back(P, bone) for bone in following]
            Q = _rotate_bone(_turn_back(P, bones[0]), seen)
            G[number] = P @ Q @ Q[rest].T
    return G


def _directions(points: Floats, start: int, ends: Sequence[int]) -> list[Floats]:
    """Return the unit vectors (f, 3) from one landmark to each landmark of `ends`."""
    return [_unit(points[:, :, end] - points[:, :, start]) for end in ends]


def _rotate_bone(bone: Floats, following: Sequence[Floats]) -> Floats:
    """Return the rotations (f, 3, 3) of a bone from its mean to its directions (f, 3).

    They also turn it about itself as the bones that follow do, whose directions (f, 3)
    `following` lists. The turn about the bone is the angle of sum_k
    conj(mean b_k) b_k + w for the parts b_k, complex numbers, of the bones that follow
    across this one. w is their variance, and more where a bone goes against its mean: a
    thigh turns with its knee, a tail that bends both ways does not turn.
    """
    mean = _unit(bone.mean(axis=0))
    Q = shortest_rotations(mean, bone)
    across = np.eye(3) - np.outer(mean, mean)
    e1, e2, _ = np.linalg.svd(across)[0].T
    if np.cross(e1, e2) @ mean < 0:
        e2 = -e2
    z = np.zeros(len(bone), dtype=complex)
    w = 0.0
    for other in following:
        turned = _turn_back(Q, other)
        b = turned @ e1 + 1j * (turned @ e2)
        z += np.conj(b.mean()) * b
        w += b.var()
    w += 2 * max(0.0, -z.real.min())
    return Q @ rotation_about(mean, np.angle(z + w))


def _find_pose_rotations(
    tree: Sequence[Node], at_rest: Mapping[int, Floats], pose: RestPose
) -> Floats:
    """Return the rotations T (m, 3, 3) that turn the bones of each node to a pose.

    at_rest: landmark where a bone ends -> its direction. A single bone turns the
    shortest way, several turn by least squares.
    """
    T = np.empty((len(tree), 3, 3))
    for number, node in enumerate(tree):
        P = T[node.above] if node.above >= 0 else np.eye(3)
        aims = [end for end in node.aims if end in pose and end in at_rest]
        posed = np.array([pose[end] for end in aims], np.float64)
        ends = _unit(posed.reshape(-1, 3))
        starts = np.array([at_rest[end] for end in aims]).reshape(-1, 3)
        if not aims:
            T[number] = P
        elif len(node.aims) == 1:
            T[number] = shortest_rotations(P @ starts[0], ends)[0] @ P
        else:
            T[number] = nearest_rotation(ends.T @ starts + PARENT_WEIGHT * P)
    return T


def _turn_back(R: Floats, vectors: Floats) -> Floats:
    """Return R^T v (f, 3) for rotations R (f, 3, 3) and vectors v (f, 3)."""
    turned: Floats = (R.swapaxes(-1, -2) @ vectors[..., None])[..., 0]
    return turned


def _unit(vectors: Floats) -> Floats:
    """Return vectors (..., 3) scaled to length 1; the axis y for those of length 0."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    up = np.broadcast_to(np.array([0.0, 1.0, 0.0]), vectors.shape).copy()
    unit: Floats = np.divide(vectors, length, out=up, where=length > 0)
    return unit
