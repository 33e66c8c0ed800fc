"""Landmarks that are not lifted themselves: dependent ones, and those that a map left
out.

Dependent landmarks are seen from another and never move it: feet from ankles, as
detectors often guess them.

    y_a += K ((w_a - y_o) - (w_b - y_b)),    K = C_ao (C_oo + R)^-1,    R = v (I + 1
                                             1^T)

for the shape y of an image, lifted without the landmarks w_a: each is seen from the
landmark b that it depends on, as the image has both. C is the covariance of y_a where
all other landmarks are known, o are x and y, v is the residual variance. v I is the
noise of each landmark, v 1 1^T that of the one on which several depend, in x and in y.
The covariance of y becomes T C T^T + K R K^T for y
-> T y.

Where landmarks y = A x were lifted for joints x, other points of the same bodies are
rows of weights r y:

    E r y = r E y,  Cov r y = r C r^T

for the mean and the covariance C of the landmarks of an image. The joints are the rows
of A^-1, and any further landmark is a row of weights of the joints times A^-1.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.geometry.pinhole import project_pinhole
from shapefit.lifting.estimate import PAIRS, PosteriorEstimate
from shapefit.lifting.lift import Lifting

UNSEEN = 1e9
"""Residual variance of what an image does not show."""


class Points(NamedTuple):
    """points (n, 3, q), their standard deviations (n, 3, q), correlations (n, 3, q) of
    x with y, x with z, and y with z; None where the landmarks have no covariance.
    """

    points: Floats
    deviation: Floats | None
    correlation: Floats | None


def place_dependents(
    lifting: Lifting[PosteriorEstimate],
    landmarks: Floats,
    shown: Flags,
    depends_on: Integers,
    residual_variance: float,
) -> Lifting[PosteriorEstimate]:
    """Return a lifting with covariances whose dependent landmarks are where images say.

    landmarks (n, 2, p) as observed, which of them (n, p) are; depends_on (p,), the
    landmark that each depends on, -1 for none; residual_variance, that of landmarks in
    the unit of shapes.
    """
    C, p, scale = (
        lifting.estimate.covariance,
        len(depends_on),
        lifting.scale[:, None, None],
    )
    assert C is not None, "the plan asks for it"
    a, b = np.flatnonzero(depends_on >= 0), depends_on[depends_on >= 0]
    every, o = np.concatenate([a, p + a, 2 * p + a]), np.concatenate([a, p + a])
    on, q = np.concatenate([b, p + b]), len(o)
    rest = np.setdiff1d(np.arange(3 * p), every)
    residual = (landmarks - lifting.landmarks_fitted) / scale
    visible = np.tile(shown[:, a] & shown[:, b], 2)
    r = np.where(
        visible, (residual[..., a] - residual[..., b]).reshape(visible.shape), 0.0
    )
    # of differences: those on one landmark share its noise, and what is not shown has
    # much
    shared = visible[:, :, None] & visible[:, None] & (on[:, None] == on)
    R = np.where(visible, residual_variance, UNSEEN)[:, :, None] * np.eye(q)
    R += np.where(shared, residual_variance, 0.0)
    given = C[:, rest][:, :, rest] + 1e-6 * np.eye(len(rest))
    across = C[:, every][:, :, rest]
    conditional = C[:, every][:, :, every] - across @ np.linalg.solve(
        given, across.swapaxes(1, 2)
    )
    K = conditional[:, :, :q] @ np.linalg.inv(conditional[:, :q, :q] + R)
    T = np.tile(np.eye(3 * p), (len(C), 1, 1))
    for column, (landmark, other) in enumerate(zip(o, on, strict=True)):
        T[:, every, landmark] -= K[..., column]
        T[:, every, other] += K[..., column]
    C = T @ C @ T.swapaxes(1, 2)
    C[:, every[:, None], every] += K @ R @ K.swapaxes(1, 2)
    step = np.zeros((len(C), 3, p))
    step[..., a] = (K @ r[..., None]).reshape(len(C), 3, -1)
    shapes = lifting.shapes + scale * step
    fitted, view = shapes[:, :2], lifting.perspective
    if view is not None:
        about = shapes.copy()
        about[:, :2] -= lifting.translation[..., None]
        fitted = project_pinhole(
            view.camera, about / scale + view.translation[..., None]
        )
    estimate = replace(
        lifting.estimate, shapes=lifting.estimate.shapes + step, covariance=C
    )
    return replace(lifting, shapes=shapes, landmarks_fitted=fitted, estimate=estimate)


def see_rows(
    rows: Floats, shapes: Floats, covariance: Floats | None, sd: Floats | float = 0.0
) -> Points:
    """Combine the landmarks of shapes (n, 3, p) by rows of weights (q, p), covariances
    likewise.

    They have a variance of their own besides, that of the standard deviations `sd`
    (q,).
    """
    points = shapes @ rows.T
    if covariance is None:
        return Points(points, None, None)
    n, p = len(shapes), rows.shape[1]
    blocks = covariance.reshape(n, 3, p, 3, p)

    def combined(a: int, b: int) -> Floats:
        block: Floats = np.einsum(
            "qi,nij,qj->nq", rows, blocks[:, a, :, b], rows, optimize=True
        )
        return block

    variance = np.maximum(np.stack([combined(a, a) for a in range(3)], axis=1), 0.0)
    deviation: Floats = np.sqrt(variance + np.square(sd))
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.stack(
            [combined(a, b) / (deviation[:, a] * deviation[:, b]) for a, b in PAIRS],
            axis=1,
        )
    return Points(points, deviation, np.nan_to_num(correlation))


def as_joints(
    lifting: Lifting[PosteriorEstimate], A: Floats
) -> Lifting[PosteriorEstimate]:
    """Return a lifting of landmarks y = A x with the joints x as its shapes, and their
    error bars.

    The landmarks fitted stay those of y. Shapes stay about the middle that those of y
    have.
    """
    back = np.asarray(np.linalg.inv(A), dtype=np.float64)
    estimate = lifting.estimate
    joints = see_rows(back, estimate.shapes, estimate.covariance)
    estimate = replace(estimate, shapes=joints.points)
    if joints.deviation is not None and joints.correlation is not None:
        estimate = replace(
            estimate,
            deviation=joints.deviation,
            correlation=joints.correlation.astype(np.float32),
        )
    if estimate.covariance is not None:
        every = np.kron(np.eye(3), back)
        covariance = every @ estimate.covariance @ every.T
        estimate = replace(estimate, covariance=covariance)
    return replace(lifting, shapes=lifting.shapes @ back.T, estimate=estimate)
