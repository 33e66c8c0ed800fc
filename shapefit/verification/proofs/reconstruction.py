"""Shapes, rotations and places of a result, from its transforms or coefficients."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.verification.check import Check, check, largest
from shapefit.verification.proofs.program import Value
from shapefit.verification.subject import Subject

ACTIVE = 1e-6
"""Share of the largest coefficient of an image beyond which an atom is active."""


PIVOT = 1e-6
"""Share of the trace above which no rounding makes a pivot negative."""


def check_active(subject: Subject) -> Check:
    """Check how many coefficients are not negligible; those at the limit may count or not."""
    size, stated = np.abs(subject.stated("coefficients")), subject.stated("active_atoms")
    limit, slack = ACTIVE * largest(size), 1 + subject.images.factor
    surely = (size > (limit * slack)[:, None]).sum(axis=1)
    perhaps, more = surely.copy(), stated > surely
    perhaps[more] = (size[more] > (limit / slack)[more, None]).sum(axis=1)
    off = np.maximum(surely - stated, stated - perhaps)
    return check("active_atoms follow from the coefficients", off, 0.0)


def check_place(subject: Subject, T: Value) -> list[Check]:
    """Check that scale is the size (n,), and translation size x T + centroid, T (n, 2)."""
    images, scale = subject.images, subject.stated("scale")
    rounding = 3 * images.factor * images.extent
    far = rounding + images.factor * images.size * (np.abs(T.value).max(axis=1) + 1)
    off = np.abs(subject.stated("translation") - images.size[:, None] * T.value - images.centroid)
    return [
        check("scale follows from the landmarks", np.abs(scale - images.size), rounding),
        check("translation follows from the fit", off, (far + images.size * T.error)[:, None]),
    ]


def check_points(claim: str, stated: Floats, shapes: Value, subject: Subject) -> Check:
    """Check points (n, d, p) for scale x shapes + translation on x and y, as they are stored.

    The error of the shapes (n,) is before scaling.
    """
    scale, translation = subject.stated("scale"), subject.stated("translation")
    expected = scale[:, None, None] * shapes.value[:, : stated.shape[1]]
    expected[:, :2] += translation[..., None]
    size = scale * largest(np.abs(shapes.value)) + np.abs(translation).max(axis=1)
    allowed = scale * shapes.error + subject.images.factor * size
    return check(claim, np.abs(stated - expected), allowed[:, None, None])


def check_shapes(subject: Subject, shapes: Value) -> list[Check]:
    """Check shapes and fitted landmarks, their x and y."""
    return [
        check_points(f"{name} follow from the fit", subject.stated(name), shapes, subject)
        for name in ("landmarks_fitted", "shapes")
    ]


def check_nearest(rotation: Floats, total: Floats, size: Floats, error: Floats) -> list[Check]:
    """Check that rotations R (n, 3, 3) are the nearest ones to A = sum_i c_i R_i.

    R maximises <R, A> over rotations where R^T A is symmetric and no two of its eigenvalues sum
    to less than 0. A is at most `error` (n,) off and of about the size (n,), 0 for no transforms:
    there R is nan.
    """
    turned = size > 0
    R = np.where(turned[:, None, None], rotation, np.eye(3))
    H = R.swapaxes(1, 2) @ total
    skew = np.abs(H - H.swapaxes(1, 2))
    H = np.where(np.isfinite(H), (H + H.swapaxes(1, 2)) / 2, 0.0)
    trace = H[:, 0, 0] + H[:, 1, 1] + H[:, 2, 2]
    sums = trace[:, None, None] * np.eye(3) - H
    sums = np.where(np.isfinite(sums), sums, 0.0)
    least = np.zeros(len(H))
    doubtful = ~surely_positive(sums)
    least[doubtful] = np.linalg.eigvalsh(sums[doubtful])[:, 0]
    absent = np.where(np.isnan(rotation).all(axis=(1, 2)), 0.0, np.inf)
    return [
        check("rotation is absent without transforms", absent, 0.0, ~turned),
        check("rotation is nearest to the transforms", skew, 2 * error[:, None, None], turned),
        check("rotation is nearest to the transforms", -least, 3 * error, turned),
    ]


def surely_positive(A: Floats) -> Flags:
    """Whether A (n, 3, 3) are positive definite by far: pivots of elimination above PIVOT tr A.

    Elimination without exchanges errs by a few roundings of the trace where all pivots are above 0.
    """
    least = PIVOT * (A[:, 0, 0] + A[:, 1, 1] + A[:, 2, 2])
    first = A[:, 0, 0]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        b, c = A[:, 1, 0] / first, A[:, 2, 0] / first
        second = A[:, 1, 1] - b * A[:, 1, 0]
        e = A[:, 2, 1] - c * A[:, 1, 0]
        third = A[:, 2, 2] - c * A[:, 2, 0] - e * e / second
    return (first > least) & (second > least) & (third > least) & (least > 0)


def check_proper(rotation: Floats, factor: Floats, made: Flags) -> Check:
    """Check that R (n, 3, 3) are rotations: R^T R = I and det R = +1."""
    gram = np.abs(rotation.swapaxes(1, 2) @ rotation - np.eye(3)).reshape(len(rotation), 9)
    handed = np.abs(np.linalg.det(rotation) - 1)[:, None]
    off = np.concatenate([gram, handed], axis=1)
    return check("rotation is a rotation", off, 4 * factor[:, None], made)
