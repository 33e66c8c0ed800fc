"""All readings of an image: each is a shape R sum_i c_i B_i with the objective stated for it.

The coefficients are not stored. At the optimum over c the atoms in use have <Y Omega, Rbar B_i> =
lambda, Y the weighted residual, so they are those; c and its sum, which the objective states, then
follow from a system of linear equations, and must not be negative.
"""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats
from shapefit.verification.check import Check, check
from shapefit.verification.proofs.reconstruction import check_proper
from shapefit.verification.subject import Subject

NEAR = 1e-6
"""Share of lambda by which an atom in use may fall short of it."""


def check_readings(subject: Subject) -> list[Check]:
    """Check rotation, shape and objective of every reading, and that the best comes first."""
    r, n = subject.result, len(subject.rows)
    counts, objective, rotation = r.modes, r.mode_objective, r.mode_rotation
    if counts is None or objective is None or rotation is None or r.mode_shapes is None:
        return []
    images, claim = subject.images, "readings are shapes with the objective stated"
    of_image = np.full(len(r), -1)
    of_image[subject.rows] = np.arange(n)
    image = of_image[np.repeat(np.arange(len(r)), counts)]
    off, allowed, order, apart = np.zeros((4, n))
    made = counts[subject.rows] > 0
    for mode, i in enumerate(image.tolist()):
        if i < 0:
            return [check(claim, np.full(n, np.inf), 0.0)]
        found = _miss(subject, i, rotation[mode], objective[mode], r.mode_shapes[mode])
        if not found[0] <= found[1]:
            off[i], allowed[i] = found
        first = mode == 0 or image[mode - 1] != i
        least = subject.stated("objective")[i] * (1 - subject.stated("relative_gap")[i])
        before = least if first else objective[mode - 1]
        order[i] = max(order[i], before - objective[mode])
    proper = check_proper(rotation, images.factor[image], np.ones(len(image), bool))
    np.logical_or.at(apart := np.zeros(n, bool), image, proper.missed)
    rounding = 4 * images.factor * np.abs(subject.stated("objective"))
    return [
        check("readings are rotations", np.where(apart, np.inf, 0.0), 0.0, made),
        check(claim, off, allowed, made),
        check("readings are in order, none below the bound", order, rounding, made),
    ]


def _miss(subject: Subject, i: int, R: Floats, stated: float, X: Floats) -> tuple[float, float]:
    """By how much a reading X (3, p) of an image misses its objective, and what rounding allows."""
    images, atoms = subject.images, subject.atoms
    omega, lam, factor = images.inliers[i], images.lam[i], images.factor[i]
    S = X / images.size[i]
    S[:2] -= images.centroid[i][:, None] / images.size[i]
    r = omega * (images.points[i] - S[:2])
    turned = R @ atoms.rows.reshape(atoms.count, 3, -1)
    slope = (turned[:, :2] * (omega * r)).sum(axis=(1, 2))
    signs = np.sign(slope) if subject.terms.signed else np.ones(atoms.count)
    used = signs * slope >= (1 - NEAR) * lam
    if subject.kept is not None:
        used &= subject.kept[i]
    A = signs[used, None, None] * turned[used]
    for points in (A, S):
        points[..., :2, :] -= points[..., :2, :].mean(axis=-1, keepdims=True)
    total = (stated - (r**2).sum() / 2) / lam
    system = np.vstack([A.reshape(len(A), S.size).T, np.ones(len(A))])
    wanted = np.append(S.ravel(), total)
    c = np.linalg.lstsq(system, wanted, rcond=None)[0]
    left = float(np.abs(system @ c - wanted).max())
    middle = float(np.abs((omega * r).sum(axis=1)).max())
    size = atoms.reach * abs(total) + images.reach[i] + images.extent[i] / images.size[i]
    condition = np.linalg.cond(system) if used.any() else 1.0
    rounding = factor * (size + stated / lam) * (1 + condition)
    return max(left, -float(c.min(initial=0.0)), middle), float(rounding)
