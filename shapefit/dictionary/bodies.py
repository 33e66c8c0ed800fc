"""Bodies: how training shapes move, how long and rigid their bones are; other bodies.

Bones are the edges of the shapes. A few subjects have few bodies and few combinations
of what arms and legs do; `vary` makes others of them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Flags, Floats, Integers, split_runs
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import metres_in, normalise, std
from shapefit.timeline import ASSUMED_RATE, Timeline, begins_sequence

MIN_SECOND_DIFFERENCES = 100
"""From which on a mean square is taken."""

MIN_ACCELERATION = 1e-3
"""Floor of the result: nothing stands stiller than that on purpose."""

SAME_BODY_WITHIN = 0.02
"""Root mean square difference of the logarithms of lengths within which two sequences
show one body: motion capture finds those of a body again within 0.015.
"""

LIMB_ENDS = (
    {"hip", "knee"},
    {"knee", "ankle"},
    {"shoulder", "elbow"},
    {"elbow", "wrist"},
)
"""Joints of people, but for their sides, between which limbs are."""

SIDE = r"(?:left|right|l|r)"
JOINT = re.compile(
    rf"{SIDE}?[ _.-]?(hip|knee|ankle|shoulder|elbow|wrist)[ _.-]?{SIDE}?", re.IGNORECASE
)
"""A joint of a limb with its side, as `lknee`, `left_knee` or `Knee.R`."""

USUAL_LENGTH_SD = 0.06
"""s, how the logarithms of lengths of bones differ from body to body.

Ten bodies of motion capture have bones that are longer or shorter by 4.5% beside their
size, and a body differs from another by 1.4 times that.
"""

USUAL_LENGTH_BODIES = 5.0
"""m, as how many bodies the usual spread counts."""


def find_acceleration(
    shapes: Floats,
    sequences: Sequence[str],
    frames: Integers | None = None,
    rate: float | None = None,
) -> Floats | None:
    """Return the root mean square acceleration (p,) of landmarks from frame to frame.

    Of y_(t-1) - 2 y_t + y_(t+1), over frames t and axes. shapes (n, 3, p) in one frame;
    y are those shapes about their centroid, in units of their size. sequences (n,) name
    runs of frames in order of time; frames (n,) are their numbers, of which some may be
    missing, at a rate in Hz; without them one shape is the next frame after the other.
    None where these are too few or short.
    """
    scale = normalise(shapes).scale
    unit = float(np.median(scale)) if len(scale) else 1.0
    y = (shapes - shapes.mean(axis=2, keepdims=True)) / unit
    weights = weigh_differences(sequences, frames, rate or ASSUMED_RATE)
    has_difference = weights[:-2].any(axis=1)
    first, middle, last = weights[:-2, :, None, None].swapaxes(0, 1)
    second = last * y[2:] + middle * y[1:-1] + first * y[:-2]
    second = second[has_difference]
    if len(second) < MIN_SECOND_DIFFERENCES:
        return None
    root = np.sqrt((second**2).mean(axis=(0, 1)))
    acceleration: Floats = np.maximum(root, MIN_ACCELERATION)
    return acceleration


def weigh_differences(
    sequences: Sequence[str], frames: Integers | None, rate: float
) -> Floats:
    """Return the weights (n, 3) of each shape and the next two in a second difference.

    See `Timeline.second_differences`; they are 0 where there is none.
    """
    n = len(sequences)
    numbers = np.arange(n) if frames is None else frames
    is_other = begins_sequence(sequences)
    is_back = np.diff(numbers) <= 0
    weights = np.zeros((n, 3))
    for rows in split_runs(is_other | is_back, n):
        position = np.asarray(numbers[rows], np.float64)
        weights[rows] = Timeline(position, rate).second_differences()
    return weights


def find_bone_tolerance(
    shapes: Floats, edges: Integers, sequences: Sequence[str]
) -> Floats:
    """Return the root mean square change (e,) of edge lengths within a sequence.

    shapes (n, 3, p), edges (e, 2); in units of the size of the shapes. 0 where edges
    are rigid bones and each sequence shows one body.
    """
    lengths, mean, sequence_of = find_lengths(shapes, edges, sequences)
    squares = (lengths - mean[sequence_of]) ** 2
    tolerance: Floats = np.sqrt(squares.mean(axis=0))
    return tolerance / np.median(normalise(shapes).scale)


def find_lengths(
    shapes: Floats, edges: Integers, sequences: Sequence[str]
) -> tuple[Floats, Floats, Integers]:
    """Return edge lengths (n, e), means by sequence (s, e), and sequence indices (n,).

    The s sequences are sorted by name; the last array has the index among them of the
    sequence of each shape.
    """
    i, j = edges.T
    lengths = np.linalg.norm(shapes[:, :, i] - shapes[:, :, j], axis=1)
    names = np.array(sequences, dtype=object).astype(str)
    _, sequence_of = np.unique(names, return_inverse=True)
    count = np.maximum(np.bincount(sequence_of), 1)
    mean = np.empty((len(count), len(edges)))
    for edge, column in enumerate(lengths.T):
        mean[:, edge] = np.bincount(sequence_of, column) / count
    return lengths, mean, sequence_of


def find_edge_covariance(lengths: Floats, of_shapes: Floats | None = None) -> Floats:
    """Return the covariance (e, e) of the logarithms of edge lengths between bodies.

    S = (sum_b d_b d_b^T + m s^2 I) / (n - 1 + m), d_b = log l_b - mean, of n bodies:
    lengths (q, e) are mean lengths of the edges in q sequences, in any unit; those of
    one body (`SAME_BODY_WITHIN`) count once, and edges without a length differ by s
    alone. A few bodies say little of others: the spread s counts as much as m further
    ones would. Where nothing says which shapes are of one body they count as one, and S
    grows by the covariance of log l `of_shapes` (n, e).
    """
    is_measured: Flags = np.asarray((lengths > 0).all(axis=0))
    if of_shapes is not None:
        is_measured &= (of_shapes > 0).all(axis=0)
    bodies: list[Floats] = []
    for log in np.log(np.where(is_measured, lengths, 1.0)):
        distances = [np.sqrt(((log - body) ** 2).mean()) for body in bodies]
        if all(distance > SAME_BODY_WITHIN for distance in distances):
            bodies.append(log)
    d = np.array(bodies) - np.mean(bodies, axis=0)
    usual = USUAL_LENGTH_BODIES * USUAL_LENGTH_SD**2 * np.eye(len(is_measured))
    S: Floats = d.T @ d + usual
    S /= len(bodies) - 1 + USUAL_LENGTH_BODIES
    if of_shapes is not None:
        logs = np.log(np.where(is_measured, of_shapes, 1.0))
        logs -= logs.mean(axis=0)
        S += logs.T @ logs / len(logs)
    return S


def metres_per_unit(shapes: Floats, dictionary: Dictionary) -> Floats | None:
    """Return the metres (n,) in one unit of lifted shapes (n, 3, p).

    They are as large as the training shapes were: by the lengths of the edges where the
    dictionary has them, L_m / sum_e |X_i - X_j|, since bones are as long in every pose.
    Else by their spread, which is that of the training shapes on average. nan for a
    shape without size; None where the dictionary does not say how large its shapes
    were.
    """
    metres = metres_in(dictionary.unit)
    if metres is None or not knows_size(dictionary):
        return None
    if has_lengths(dictionary):
        assert dictionary.edges is not None
        assert dictionary.edge_length is not None
        i, j = dictionary.edges.T
        sides = (
            shapes[:, axis].take(i, axis=1) - shapes[:, axis].take(j, axis=1)
            for axis in range(3)
        )
        extent = np.sqrt(sum(side**2 for side in sides)).sum(axis=1)
        size = float(dictionary.edge_length.sum())
    else:
        assert dictionary.atom_scale is not None
        extent = std(shapes)
        size = float((dictionary.atom_scale * std(dictionary.atoms)).mean())
    unknown = np.full(len(shapes), np.nan)
    metres_each: Floats = np.divide(
        metres * size, extent, out=unknown, where=np.asarray(extent > 0)
    )
    return metres_each


def knows_size(dictionary: Dictionary) -> bool:
    """Whether the dictionary says how large its training shapes were, in metres."""
    measured = has_lengths(dictionary) or dictionary.atom_scale is not None
    return measured and metres_in(dictionary.unit) is not None


def has_lengths(dictionary: Dictionary) -> bool:
    """Whether the dictionary says how long its edges are."""
    length = dictionary.edge_length
    if dictionary.edges is None or length is None:
        return False
    return bool(length.sum() > 0)


def name_joints(names: Sequence[str]) -> list[str | None]:
    """Return the joint of a limb that each landmark is, such as "knee", else None.

    names: of landmarks. Joints are in small letters, without their side.
    """
    matches = [JOINT.fullmatch(name) for name in names]
    return [None if match is None else match[1].lower() for match in matches]


def find_limbs(names: Sequence[str], edges: Integers) -> Flags:
    """Return which edges (e, 2) are limbs of people, by the names of their landmarks.

    Trunks differ by who marks them. No edge is one where no limb ends in a wrist or an
    ankle: animals have paws.
    """
    joints = name_joints(names)
    ends = [{joints[end] for end in edge} for edge in edges.tolist()]
    limbs = np.array([pair in LIMB_ENDS for pair in ends], bool)
    of_people = any(pair in LIMB_ENDS and pair & {"wrist", "ankle"} for pair in ends)
    return limbs & of_people


def precision_of_ratios(covariance: Floats) -> Floats:
    """Return the precision of logarithms of lengths (e, e) at an unknown size.

    P - P 1 1^T P / (1^T P 1) with P the inverse of their covariance (e, e): what is
    common to all logarithms costs nothing.
    """
    P = np.linalg.inv(covariance)
    whole = P.sum(axis=1)
    Q: Floats = P - np.outer(whole, whole) / whole.sum()
    return Q


class BoneTree(NamedTuple):
    """A tree of bones, each of which ends in one of p landmarks.

    order (p - 1,): the landmarks without the root, each after its parent (p,). limbs:
    for each chain of bones that ends in a leaf, the landmarks beyond its first bone;
    that bone, such as from the neck to a shoulder, belongs to the trunk.
    """

    order: tuple[int, ...]
    parent: tuple[int, ...]
    limbs: tuple[tuple[int, ...], ...]


def find_bone_tree(edges: Integers, points: int) -> BoneTree:
    """Return the tree that edges (e, 2) of `points` landmarks form, and its limbs.

    The root is the landmark with the most edges. Raises ValueError where they do not
    form one tree.
    """
    neighbours: list[list[int]] = [[] for _ in range(points)]
    for a, b in edges.tolist():
        neighbours[a].append(b)
        neighbours[b].append(a)
    root = max(range(points), key=lambda j: len(neighbours[j]))
    parent = {root: root}
    order = [root]
    for landmark in order:  # which grows on the way
        children = [j for j in neighbours[landmark] if j not in parent]
        parent.update(dict.fromkeys(children, landmark))
        order += children
    if len(edges) != points - 1 or len(parent) != points:
        raise ValueError(f"{len(edges)} edges of {points} landmarks are not a tree")
    limbs = []
    for leaf in range(points):
        if leaf == root or len(neighbours[leaf]) != 1:
            continue
        chain = [leaf]
        while parent[chain[-1]] != root and len(neighbours[parent[chain[-1]]]) == 2:
            chain.append(parent[chain[-1]])
        if len(chain) > 1:
            beyond_first = chain[:-1]
            limbs.append(tuple(reversed(beyond_first)))
    parents = tuple(parent[j] for j in range(points))
    return BoneTree(tuple(order[1:]), parents, tuple(limbs))


def vary(
    shapes: Floats,
    tree: BoneTree,
    *,
    copies: int,
    bone_scale: float,
    exchange: float,
    partners: Integers | None = None,
) -> Floats:
    """Copy aligned shapes (n, 3, p) with limbs exchanged and bones stretched at random.

    Returns (copies n, 3, p). exchange: share of the shapes each of whose limbs comes
    from another shape, drawn at random, bone by bone as it lies there. bone_scale:
    standard deviation of the logarithm of the length of a bone; landmarks and their
    partners (p,) stretch alike. The shapes are no longer normalised. Equal shapes give
    equal copies.
    """
    rng = np.random.default_rng(0)
    n, _, p = shapes.shape
    twin = np.arange(p)
    if partners is not None:
        twin = np.minimum(twin, partners)
    parent = np.array(tree.parent)
    original = shapes - shapes[:, :, parent]  # the bone that ends in each landmark
    varied = []
    for _ in range(copies):
        bones = original.copy()
        is_exchanged = rng.random(n) < exchange
        for limb in tree.limbs:
            donors = rng.permutation(n)
            rows = np.flatnonzero(is_exchanged)
            for j in limb:
                bones[rows, :, j] = original[donors[rows], :, j]
        stretch = np.exp(bone_scale * rng.standard_normal((n, p)))[:, twin]
        bones *= stretch[:, None]
        built = shapes.copy()
        for j in tree.order:
            built[:, :, j] = built[:, :, parent[j]] + bones[:, :, j]
        varied.append(built)
    return np.concatenate(varied)
