"""Bodies: how training shapes move, how long and how rigid their bones are, and other
bodies.

Bones are the edges of the shapes. A few subjects have few bodies and few combinations
of what arms and legs do; `vary` makes others of them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import metres_in, normalise, std
from shapefit.timeline import ASSUMED_RATE, Timeline

FEWEST = 100
"""Second differences from which a mean square is taken."""

LEAST = 1e-3
"""Floor of the result: nothing stands stiller than that on purpose."""

ALIKE = 0.02
"""Root mean square difference of the logarithms of lengths within which two sequences
show one body: motion capture finds those of a body again within 0.015.
"""

LIMBS = ({"hip", "knee"}, {"knee", "ankle"}, {"shoulder", "elbow"}, {"elbow", "wrist"})
"""Joints of people, but for their sides, between which limbs are."""

SIDE = r"(?:left|right|l|r)"
JOINT = re.compile(
    rf"{SIDE}?[ _.-]?(hip|knee|ankle|shoulder|elbow|wrist)[ _.-]?{SIDE}?", re.IGNORECASE
)
"""A joint of a limb with its side, as `lknee`, `left_knee` or `Knee.R`."""

LENGTH_STD, WORTH = 0.06, 5.0
"""s and m. Ten bodies of motion capture have bones that are longer or shorter by 4.5%
beside their size, and a body differs from another by 1.4 times that.
"""


def find_acceleration(
    shapes: Floats,
    sequences: Sequence[str],
    frames: Integers | None = None,
    rate: float | None = None,
) -> Floats | None:
    """Root mean square over frames t and axes of y_(t-1) - 2 y_t + y_(t+1), for each
    landmark (p,).

    shapes (n, 3, p) in one frame; y are those shapes about their centroid, in units of
    their size. sequences (n,) name runs of frames in order of time; frames (n,) are
    their numbers, of which some may be missing, at a rate in Hz; without them one shape
    is the next frame after the other. None where these are too few or short.
    """
    scale = normalise(shapes).scale
    unit = float(np.median(scale)) if len(scale) else 1.0
    y = (shapes - shapes.mean(axis=2, keepdims=True)) / unit
    weights = weigh_differences(sequences, frames, rate or ASSUMED_RATE)
    together = weights[:-2].any(axis=1)
    first, middle, last = weights[:-2, :, None, None].swapaxes(0, 1)
    second = (last * y[2:] + middle * y[1:-1] + first * y[:-2])[together]
    if len(second) < FEWEST:
        return None
    acceleration: Floats = np.maximum(np.sqrt((second**2).mean(axis=(0, 1))), LEAST)
    return acceleration


def weigh_differences(
    sequences: Sequence[str], frames: Integers | None, rate: float
) -> Floats:
    """Return the weights (n, 3) of the second difference that begins at each shape, see
    `Timeline.second_differences`; 0 where there is none.
    """
    n = len(sequences)
    numbers = np.arange(n) if frames is None else frames
    names = np.array(sequences, dtype=object)
    ends = np.flatnonzero((names[1:] != names[:-1]) | (np.diff(numbers) <= 0)) + 1
    weights = np.zeros((n, 3))
    for start, stop in pairwise([0, *ends.tolist(), n]):
        position = np.asarray(numbers[start:stop], np.float64)
        weights[start:stop] = Timeline(position, rate).second_differences()
    return weights


def find_bone_tolerance(
    shapes: Floats, edges: Integers, sequences: Sequence[str]
) -> Floats:
    """Root mean square (e,) of how the edges' lengths differ from their means in each
    sequence.

    shapes (n, 3, p), edges (e, 2); in units of the size of the shapes. 0 where edges
    are rigid bones and each sequence shows one body.
    """
    lengths, mean, of = find_lengths(shapes, edges, sequences)
    tolerance: Floats = np.sqrt(((lengths - mean[of]) ** 2).mean(axis=0))
    return tolerance / np.median(normalise(shapes).scale)


def find_lengths(
    shapes: Floats, edges: Integers, sequences: Sequence[str]
) -> tuple[Floats, Floats, Integers]:
    """Lengths (n, e) of the edges, their means (s, e) in s sequences by name, and which
    (n,).
    """
    i, j = edges.T
    lengths = np.linalg.norm(shapes[:, :, i] - shapes[:, :, j], axis=1)
    _, of = np.unique(
        np.array(sequences, dtype=object).astype(str), return_inverse=True
    )
    count = np.maximum(np.bincount(of), 1)
    mean = [np.bincount(of, column) / count for column in lengths.T]
    return lengths, np.stack(mean, axis=1) if mean else np.empty((len(count), 0)), of


def find_edge_covariance(lengths: Floats, of_shapes: Floats | None = None) -> Floats:
    """S = (sum_b d_b d_b^T + m s^2 I) / (n - 1 + m), d_b = log l_b - mean, of n bodies
    (e, e).

    lengths (q, e), mean lengths of the edges in q sequences, in any unit; those of one
    body (`ALIKE`) count once, and edges without a length differ by s alone. A few
    bodies say little of others: the spread s counts as much as m further ones would.
    Where nothing says which shapes are of one body they count as one, and S grows by
    the covariance of log l `of_shapes` (n, e).
    """
    measured: Flags = np.asarray((lengths > 0).all(axis=0))
    if of_shapes is not None:
        measured &= (of_shapes > 0).all(axis=0)
    bodies: list[Floats] = []
    for log in np.log(np.where(measured, lengths, 1.0)):
        if all(np.sqrt(((log - body) ** 2).mean()) > ALIKE for body in bodies):
            bodies.append(log)
    d = np.array(bodies) - np.mean(bodies, axis=0)
    S: Floats = d.T @ d + WORTH * LENGTH_STD**2 * np.eye(len(measured))
    S /= len(bodies) - 1 + WORTH
    if of_shapes is not None:
        logs = np.log(np.where(measured, of_shapes, 1.0))
        logs -= logs.mean(axis=0)
        S += logs.T @ logs / len(logs)
    return S


def metres_per_unit(shapes: Floats, dictionary: Dictionary) -> Floats | None:
    """Metres (n,) in one unit of lifted shapes (n, 3, p): as large as the training
    shapes were.

    By the lengths of the edges where the dictionary has them, L_m / sum_e |X_i - X_j|:
    bones are as long in every pose. Else by their spread, which is that of the training
    shapes on average. nan for a shape without size; None where the dictionary does not
    say how large its shapes were.
    """
    metres = metres_in(dictionary.unit)
    if metres is None or not knows_size(dictionary):
        return None
    if has_lengths(dictionary):
        assert dictionary.edges is not None
        assert dictionary.edge_length is not None
        i, j = dictionary.edges.T
        sides = (
            shapes[:, a].take(i, axis=1) - shapes[:, a].take(j, axis=1)
            for a in range(3)
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
    """Whether the dictionary says how large its training shapes were, in a unit of
    length.
    """
    measured = has_lengths(dictionary) or dictionary.atom_scale is not None
    return measured and metres_in(dictionary.unit) is not None


def has_lengths(dictionary: Dictionary) -> bool:
    """Whether the dictionary says how long its edges are."""
    length = dictionary.edge_length
    return (
        dictionary.edges is not None and length is not None and bool(length.sum() > 0)
    )


def name_joints(names: Sequence[str]) -> list[str | None]:
    """Return the joint of a limb that each name stands for, without its side, or
    None.
    """
    matches = [JOINT.fullmatch(name) for name in names]
    return [None if match is None else match[1].lower() for match in matches]


def find_limbs(names: Sequence[str], edges: Integers) -> Flags:
    """Which edges (e, 2) are limbs of people: their trunks differ by who marks them.

    None is where no limb ends in a wrist or an ankle: animals have paws.
    """
    joints = name_joints(names)
    ends = [{joints[end] for end in edge} for edge in edges.tolist()]
    limbs = np.array([pair in LIMBS for pair in ends], bool)
    of_people = any(pair in LIMBS and pair & {"wrist", "ankle"} for pair in ends)
    return limbs & of_people


def precision_of_ratios(covariance: Floats) -> Floats:
    """P - P 1 1^T P / (1^T P 1): of logarithms that are known but for a number common
    to all.
    """
    P = np.linalg.inv(covariance)
    whole = P.sum(axis=1)
    Q: Floats = P - np.outer(whole, whole) / whole.sum()
    return Q


class Skeleton(NamedTuple):
    """A tree of bones: order (p - 1,), the landmarks without the root, each after its
    parent (p,).

    limbs: for each chain of bones that ends in a leaf, the landmarks beyond its first
    bone; that bone, such as from the neck to a shoulder, belongs to the trunk.
    """

    order: tuple[int, ...]
    parent: tuple[int, ...]
    limbs: tuple[tuple[int, ...], ...]


def find_skeleton(edges: Integers, points: int) -> Skeleton:
    """Lay out the tree of edges (e, 2). Raises ValueError where they do not form
    one.
    """
    neighbours: list[list[int]] = [[] for _ in range(points)]
    for a, b in edges.tolist():
        neighbours[a].append(b)
        neighbours[b].append(a)
    root = max(range(points), key=lambda j: len(neighbours[j]))
    parent, order = {root: root}, [root]
    for at in order:
        children = [j for j in neighbours[at] if j not in parent]
        parent |= dict.fromkeys(children, at)
        order += children
    if len(edges) != points - 1 or len(parent) != points:
        raise ValueError(f"{len(edges)} edges of {points} landmarks are not a tree")
    limbs = []
    for leaf in range(points):
        chain = [leaf]
        while parent[chain[-1]] != root and len(neighbours[parent[chain[-1]]]) == 2:
            chain.append(parent[chain[-1]])
        if leaf != root and len(neighbours[leaf]) == 1 and len(chain) > 1:
            limbs.append(tuple(chain[-2::-1]))
    return Skeleton(
        tuple(order[1:]), tuple(parent[j] for j in range(points)), tuple(limbs)
    )


def vary(
    shapes: Floats,
    skeleton: Skeleton,
    *,
    copies: int,
    bone_scale: float,
    exchange: float,
    partners: Integers | None = None,
) -> Floats:
    """(n, 3, p) -> (copies n, 3, p), aligned shapes varied at random, the same for
    equal shapes.

    exchange: share of the shapes each of whose limbs comes from another shape, drawn at
    random, bone by bone as it lies there. stretch: standard deviation of the logarithm
    of the length of a bone; landmarks and their partners (p,) stretch alike. The shapes
    are no longer normalised.
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
        lengths = np.exp(bone_scale * rng.standard_normal((n, p)))[:, twin]
        bones *= lengths[:, None]
        built = shapes.copy()
        for j in order:
            built[:, :, j] = built[:, :, parent[j]] + bones[:, :, j]
        varied.append(built)
    return np.concatenate(varied)
