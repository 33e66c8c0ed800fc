"""Landmarks that are not lifted: dependent ones, and those that a map left out.

Dependent landmarks are seen from another and never move it: feet from ankles, as
detectors often guess them.

    y_a += K ((w_a - y_o) - (w_b - y_b)),
    K = C_ao (C_oo + R)^-1,    R = v (I + 1 1^T)

for the shape y of an image, lifted without the landmarks w_a: each is seen from the
landmark b that it depends on, as the image has both. C is the covariance of y_a where
all other landmarks are known, o are x and y, v is the residual variance. v I is the
noise of each landmark, v 1 1^T that of the one on which several depend, in x and in y.
The covariance of y becomes T C T^T + K R K^T for y -> T y.

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

from shapefit.arrays import Flags, Floats, Indices, Integers
from shapefit.geometry.pinhole import project_pinhole
from shapefit.lifting.estimate import PAIRS, PosteriorEstimate
from shapefit.lifting.lift import Lifting

UNSEEN_VARIANCE = 1e9
"""Residual variance of what an image does not show."""


class Points(NamedTuple):
    """Points and what is known of their errors.

    points (n, 3, q), their standard deviations (n, 3, q), correlations (n, 3, q) of x
    with y, x with z, and y with z; None where the landmarks have no covariance.
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
    """Move dependent landmarks, as feet, of lifted shapes to where images show them.

    The lifting must have covariances, which change too. landmarks (n, 2, p) as
    observed; shown (n, p), which of them are; depends_on (p,), the landmark that each
    depends on, -1 for none; residual_variance, that of landmarks in the unit of shapes.
    """
    C = lifting.estimate.covariance
    assert C is not None, "the plan asks for it"
    p = len(depends_on)
    a = np.flatnonzero(depends_on >= 0)
    b = depends_on[a]
    scale = lifting.scale[:, None, None]
    is_seen = np.tile(shown[:, a] & shown[:, b], 2)
    R = _noise_of_differences(is_seen, np.concatenate([b, p + b]), residual_variance)
    K = _kalman_gain(C, R, np.concatenate([a, p + a, 2 * p + a]))
    residual = (landmarks - lifting.landmarks_fitted) / scale
    difference = residual[..., a] - residual[..., b]
    r = np.where(is_seen, difference.reshape(is_seen.shape), 0.0)
    step = np.zeros((len(C), 3, p))
    step[..., a] = (K @ r[..., None]).reshape(len(C), 3, len(a))
    shapes = lifting.shapes + scale * step
    fitted = shapes[:, :2]
    view = lifting.perspective
    if view is not None:
        about = shapes.copy()
        about[:, :2] -= lifting.translation[..., None]
        in_space = about / scale + view.translation[..., None]
        fitted = project_pinhole(view.camera, in_space)
    estimate = replace(
        lifting.estimate,
        shapes=lifting.estimate.shapes + step,
        covariance=_covariance_of_placed(C, K, R, a, b),
    )
    return replace(lifting, shapes=shapes, landmarks_fitted=fitted, estimate=estimate)


def _noise_of_differences(
    is_seen: Flags, others: Integers, residual_variance: float
) -> Floats:
    """Return the covariance R (n, q, q) of the noise of q differences of coordinates.

    others (q,): the coordinate that each is a difference from. Those from one landmark
    share its noise; one that is not seen (n, q) has `UNSEEN_VARIANCE`.
    """
    of_each = np.where(is_seen, residual_variance, UNSEEN_VARIANCE)
    both_seen = is_seen[:, :, None] & is_seen[:, None]
    is_shared = both_seen & (others[:, None] == others)
    R: Floats = of_each[:, :, None] * np.eye(len(others))
    R += np.where(is_shared, residual_variance, 0.0)
    return R


def _kalman_gain(C: Floats, R: Floats, dependent: Indices) -> Floats:
    """Return the Kalman gain K (n, 3a, 2a) at the covariance C and the noise R.

    By which residuals in x and y move x, y and z. C (n, 3p, 3p), R (n, 2a, 2a);
    dependent (3a,): rows of C of the a landmarks.
    """
    q = R.shape[1]
    rest = np.setdiff1d(np.arange(C.shape[1]), dependent)
    known = C[:, rest][:, :, rest] + 1e-6 * np.eye(len(rest))
    across = C[:, dependent][:, :, rest]
    explained = across @ np.linalg.solve(known, across.swapaxes(1, 2))
    conditional = C[:, dependent][:, :, dependent] - explained
    K: Floats = conditional[:, :, :q] @ np.linalg.inv(conditional[:, :q, :q] + R)
    return K


def _covariance_of_placed(
    C: Floats, K: Floats, R: Floats, a: Indices, b: Integers
) -> Floats:
    """Return C (n, 3p, 3p) after landmarks `a` were placed from `b`, by the gain K.

    T C T^T + K R K^T, see above.
    """
    p = C.shape[1] // 3
    dependent = np.concatenate([a, p + a, 2 * p + a])
    own = np.concatenate([a, p + a])
    others = np.concatenate([b, p + b])
    T = np.tile(np.eye(3 * p), (len(C), 1, 1))
    for column, (landmark, other) in enumerate(zip(own, others, strict=True)):
        T[:, dependent, landmark] -= K[..., column]
        T[:, dependent, other] += K[..., column]
    placed: Floats = T @ C @ T.swapaxes(1, 2)
    placed[:, dependent[:, None], dependent] += K @ R @ K.swapaxes(1, 2)
    return placed


def combine_landmarks(
    rows: Floats,
    shapes: Floats,
    covariance: Floats | None,
    added_sd: Floats | float = 0.0,
) -> Points:
    """Return q weighted sums of landmarks, with standard deviations and correlations.

    rows (q, p), the weights; shapes (n, 3, p); covariance (n, 3p, 3p), without which no
    errors are known. added_sd (q,): standard deviation that a point has besides.
    """
    points = shapes @ rows.T
    if covariance is None:
        return Points(points, None, None)
    p = rows.shape[1]
    blocks = covariance.reshape(len(shapes), 3, p, 3, p)

    def combined(a: int, b: int) -> Floats:
        """Return the covariances (n, q) of axes a and b of the combined points."""
        block: Floats = np.einsum(
            "qi,nij,qj->nq", rows, blocks[:, a, :, b], rows, optimize=True
        )
        return block

    variance = np.maximum(np.stack([combined(a, a) for a in range(3)], axis=1), 0.0)
    deviation: Floats = np.sqrt(variance + np.square(added_sd))
    with np.errstate(divide="ignore", invalid="ignore"):
        of_pairs = [
            combined(a, b) / (deviation[:, a] * deviation[:, b]) for a, b in PAIRS
        ]
    correlation = np.stack(of_pairs, axis=1)
    return Points(points, deviation, np.nan_to_num(correlation))


def as_joints(
    lifting: Lifting[PosteriorEstimate], A: Floats
) -> Lifting[PosteriorEstimate]:
    """Convert a lifting of landmarks y = A x to one whose shapes are the joints x.

    Error bars are those of the joints. The landmarks fitted stay those of y. Shapes
    stay about the middle that those of y have.
    """
    back = np.asarray(np.linalg.inv(A), dtype=np.float64)
    estimate = lifting.estimate
    joints = combine_landmarks(back, estimate.shapes, estimate.covariance)
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
