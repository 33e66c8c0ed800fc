"""Add to the dictionary of people what only some bodies have: feet, hands and a point
of the spine.

    p(x, y) = p(x) sum_k p(k | x) N(y; m_k + B_k (x - mu_k), Q_k)

for the joints x of the dictionary, whose prior stays as it is to the last bit, and the
further ones y, which follow from them by a regression in each component. Atoms and mean
shape get theirs by one regression for all: y = W x.

Usage: python -m experiments.people.further_joints DICTIONARY.h5 SHAPES.h5 RESULT.h5
[SEQUENCES ...]

SHAPES.h5 has all points of Acclaim skeletons. Sequences that one of the globs fits are
left out.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.dictionary.bodies import (
    find_acceleration,
    find_bone_tolerance,
    find_bone_tree,
    find_edge_covariance,
    find_lengths,
    vary,
)
from shapefit.dictionary.mixture import Mixture, expected_log_density, maximise
from shapefit.dictionary.model import WHERE_MARKED, Dictionary
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import lateral_axis, mirror, rotation_onto
from shapefit.io import (
    digests,
    read_dictionary,
    read_shapes,
    write_dictionary,
)
from shapefit.io.skeletons import FURTHER, PEOPLE, edges_of
from shapefit.lifting.posterior.p_value import with_p_value_table
from shapefit.pipelines.learn_dict.from_3d import MIN_COPIES, every_nth
from shapefit.records import Shapes

JOINTS = (*PEOPLE, *FURTHER)
GROUPS = (
    "rankle:rheel,rball,rtoe lankle:lheel,lball,ltoe rwrist:rhand lwrist:lhand"
    " neck:spine"
)
LIMBS = {
    "hip": "hipjoint",
    "knee": "femur",
    "ankle": "tibia",
    "ball": "foot",
    "toe": "toes",
    "shoulder": "clavicle",
    "elbow": "humerus",
    "wrist": "wrist",
    "hand": "hand",
}
POINTS = {"pelvis": "root", "neck": "thorax", "head": "head", "spine": "lowerback"} | {
    f"{side}{joint}": f"{side}{bone}" for side in "rl" for joint, bone in LIMBS.items()
}
"""Joints -> bones that end there. The shapes have no heels."""

BEHIND, BELOW = 0.038, 0.023
"""Where the heel is from the ankle, in heights of the body, with the foot flat: a foot
is 0.152 long, a quarter of it behind the ankle, which is 0.039 above the floor (R.
Drillis and R. Contini, Body segment parameters, 1966); detectors mark the back of the
heel, about 0.016 above the floor.
"""

BALL = 0.073, 0.021
"""Where the ball of the foot is from the ankle: forwards and down, alike; of the shapes
here.
"""


@dataclass(frozen=True)
class Regression:
    """The linear regression y - mean_y = B (x - mean_x) + noise of covariance Q: B
    (..., e, d), Q (..., e, e).
    """

    B: Floats
    Q: Floats

    @classmethod
    def from_covariance(cls, C: Floats, d: int) -> Regression:
        """B = C_yx C_xx^-1, Q = C_yy - B C_xy for covariances C (..., d + e, d + e) of
        x (d,) and y (e,).
        """
        B = np.asarray(np.linalg.solve(C[..., :d, :d], C[..., :d, d:]).swapaxes(-1, -2))
        return cls(B, C[..., d:, d:] - B @ C[..., :d, d:])

    def joint_covariance(self, C: Floats) -> Floats:
        """Return the covariance (..., d + e, d + e) of x and y together, for the
        covariance C (..., d, d) of x.
        """
        across = self.B @ C
        last = across @ self.B.swapaxes(-1, -2) + self.Q
        whole = np.block(
            [[C, across.swapaxes(-1, -2)], [across, (last + last.swapaxes(-1, -2)) / 2]]
        )
        return np.asarray(whole, dtype=np.float64)


def with_heels(shapes: Floats, names: list[str]) -> Floats:
    """Return shapes (n, 3, len(JOINTS)) of all joints, from shapes (n, 3, p) without
    heels: these are placed at a fixed angle from the ball of the foot about the ankle.
    """
    point = {name: shapes[:, :, names.index(name)] for name in names}
    turn = np.pi - np.arctan2(BALL[1], BALL[0]) - np.arctan2(BELOW, BEHIND)
    length = np.hypot(BEHIND, BELOW) / np.hypot(*BALL)
    for side in "rl":
        knee, ankle, ball = (
            point[f"{side}{joint}"] for joint in ("knee", "ankle", "ball")
        )
        foot: Floats = ball - ankle
        long: Floats = np.linalg.norm(foot, axis=1, keepdims=True)
        sole = ankle - knee
        sole = sole - foot * ((sole * foot).sum(axis=1, keepdims=True) / long**2)
        sole *= long / np.linalg.norm(sole, axis=1, keepdims=True)
        point[f"{side}heel"] = ankle + length * (
            np.cos(turn) * foot + np.sin(turn) * sole
        )
    return np.stack([point[name] for name in JOINTS], axis=2)


def mirror_index(names: list[str]) -> list[int]:
    """Return the index of the joint on the other side for each joint, its own where
    there is none.
    """
    twins = {name: {"r": "l", "l": "r"}.get(name[0], "") + name[1:] for name in names}
    return [
        names.index(twins[name]) if twins[name] in names else j
        for j, name in enumerate(names)
    ]


def training_shapes(given: Shapes, dictionary: Dictionary) -> Floats:
    """Return shapes (n, 3, p) of all joints for learning, thinned, mirrored, varied and
    aligned like those that the prior of the dictionary was learned from.
    """
    config = json.loads(dictionary.provenance["config"])
    d, prior = len(dictionary.landmark_names), config["prior"]
    names = [name for name in JOINTS if name in POINTS]
    shapes = given.as_columns()[every_nth(given.sequences or (), config["every"])]
    shapes = shapes[..., [given.landmark_names.index(POINTS[name]) for name in names]]
    partners = mirror_index(names)
    images = mirror(shapes, partners, lateral_axis(shapes, partners))
    shapes = align(np.concatenate([shapes, images]), dictionary)
    bones = [edge for edge in edges_of(names) if set(edge) != {0, names.index("neck")}]
    varied = vary(
        shapes,
        find_bone_tree(np.array(bones), len(names)),
        copies=MIN_COPIES,
        bone_scale=prior["bone_scale"],
        exchange=prior["exchange"],
        partners=np.array(partners),
    )
    assert names[:d] == list(dictionary.landmark_names)
    return align(with_heels(varied, names), dictionary)


def align(shapes: Floats, dictionary: Dictionary) -> Floats:
    """Return shapes (n, 3, p) normalised by the joints of the dictionary, their first
    ones, and rotated onto its mean shape.
    """
    d = len(dictionary.landmark_names)
    norm = normalise(shapes[..., :d])
    moved = (shapes - norm.centroid[..., None]) / norm.scale[:, None, None]
    turned: Floats = rotation_onto(moved[..., :d], dictionary.mean_shape) @ moved
    return turned


def extend_prior(
    prior: Mixture, shapes: Floats, shrinkage: float, variance_floor: float
) -> Mixture:
    """Extend a prior over the first d joints to all p joints of shapes (n, 3, p).

    Its marginal over the first d joints is the prior. shrinkage and variance_floor as
    in `mixture_rounds`.
    """
    n, _, p = shapes.shape
    d = prior.means.shape[2]
    X = np.concatenate(
        [shapes[..., :d].reshape(n, -1), shapes[..., d:].reshape(n, -1)], axis=1
    )
    density = expected_log_density(X[:, : 3 * d], prior, variance_floor)
    share = np.exp(density - density.max(axis=1, keepdims=True))
    share /= share.sum(axis=1, keepdims=True)
    G = np.cov(X.T, bias=True) + variance_floor * np.eye(3 * p)
    kappa = shrinkage / (1 - shrinkage) * n / len(prior)
    visible = maximise(X, share, G, kappa, variance_floor)
    means, mu = (
        visible.means.reshape(len(prior), -1),
        prior.means.reshape(len(prior), -1),
    )
    regression = Regression.from_covariance(visible.covariances, 3 * d)
    away = np.einsum("kij,kj->ki", regression.B, mu - means[:, : 3 * d])
    further = (means[:, 3 * d :] + away).reshape(len(prior), 3, p - d)
    axes = np.arange(3)[:, None]
    order = np.hstack(
        [axes * d + np.arange(d), 3 * d + axes * (p - d) + np.arange(p - d)]
    ).ravel()
    C = regression.joint_covariance(prior.covariances)[:, order][:, :, order]
    return Mixture(prior.weights, np.concatenate([prior.means, further], axis=2), C)


def extend(dictionary: Dictionary, given: Shapes) -> Dictionary:
    """Return the dictionary extended to all JOINTS, learned from shapes that have those
    it lacks, but for heels.
    """
    d, config = (
        len(dictionary.landmark_names),
        json.loads(dictionary.provenance["config"]),
    )
    assert dictionary.prior is not None
    assert dictionary.edges is not None
    assert dictionary.acceleration is not None
    assert dictionary.edge_covariance is not None
    shapes = training_shapes(given, dictionary)
    x, y = (
        shapes[..., :d].reshape(len(shapes), -1),
        shapes[..., d:].reshape(len(shapes), -1),
    )
    W = np.linalg.lstsq(x, y, rcond=None)[0]

    def add_joints(points: Floats) -> Floats:
        """Return points (..., 3, d) with the joints that they predict."""
        further = (points.reshape(-1, 3 * d) @ W).reshape(*points.shape[:-1], -1)
        return np.concatenate([points, further], axis=-1)

    names = [name for name in JOINTS if name in POINTS]
    columns = [given.landmark_names.index(POINTS[name]) for name in names]
    moving = with_heels(given.as_columns()[..., columns], names)
    sequences = given.sequences or ()
    old = {tuple(edge) for edge in dictionary.edges.tolist()}
    edges = np.concatenate(
        [dictionary.edges, [e for e in edges_of(JOINTS) if e not in old]]
    )
    e = len(dictionary.edges)
    # Units of the size of a body with d joints.
    unit = float(
        np.median(normalise(moving).scale) / np.median(normalise(moving[..., :d]).scale)
    )
    acceleration = find_acceleration(moving, sequences)
    assert acceleration is not None

    def append_further(known: Floats | None, found: Floats) -> Floats | None:
        """Return the known entries, followed by those of `found` beyond them."""
        return None if known is None else np.concatenate([known, found[len(known) :]])

    between = find_edge_covariance(find_lengths(moving, edges, sequences)[1])
    return replace(
        dictionary,
        atoms=add_joints(dictionary.atoms),
        landmark_names=JOINTS,
        mean_shape=add_joints(dictionary.mean_shape),
        edges=edges,
        mirror_index=np.array(mirror_index(list(JOINTS))),
        prior=extend_prior(
            dictionary.prior,
            shapes,
            config["prior"]["shrinkage"],
            config["prior"]["floor"],
        ),
        acceleration=append_further(dictionary.acceleration, unit * acceleration),
        bone_tolerance=append_further(
            dictionary.bone_tolerance,
            unit * find_bone_tolerance(moving, edges, sequences),
        ),
        edge_length=append_further(
            dictionary.edge_length,
            find_lengths(moving, edges, sequences)[0].mean(axis=0),
        ),
        edge_covariance=Regression.from_covariance(between, e).joint_covariance(
            dictionary.edge_covariance
        ),
        provenance={**dictionary.provenance, WHERE_MARKED: GROUPS},
    )


def main() -> None:
    """Read a dictionary and a file of shapes, and write the extended dictionary.

    The command line: both, the file to write, and globs of sequences to leave out.
    """
    source, points, target = map(Path, sys.argv[1:4])
    given = read_shapes([points])
    retained = [
        not any(fnmatchcase(name, glob) for glob in sys.argv[4:])
        for name in given.sequences or ()
    ]
    dictionary = read_dictionary(source)
    made = extend(dictionary, given.take(np.flatnonzero(retained)))
    inputs = json.loads(dictionary.provenance["inputs"]) | digests((points,))
    provenance = {**made.provenance, "inputs": json.dumps(inputs)}
    write_dictionary(target, with_p_value_table(replace(made, provenance=provenance)))


if __name__ == "__main__":
    main()
