"""From shapes of mapped landmarks y = A x to other points of the same bodies: rows of weights r y.

    E r y = r E y,  Cov r y = r C r^T

for the mean and the covariance C of the landmarks of an image. The joints x of the dictionary are
the rows of A^-1, and any further landmark is a row of weights of the joints times A^-1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from shapefit.lifting.estimate import CORRELATION
from shapefit.lifting.lift import Lifting

Floats = NDArray[np.float64]

PAIRS = ((0, 1), (0, 2), (1, 2))
"""Coordinates of a landmark, in the order of the correlations."""


@dataclass(frozen=True)
class Points:
    """points (n, 3, q), their standard deviations (n, 3, q), correlations (n, 3, q) of x with y, x
    with z, and y with z; None where the landmarks have no covariance.
    """

    points: Floats
    deviation: Floats | None
    correlation: Floats | None


def see_rows(
    rows: Floats, shapes: Floats, covariance: Floats | None, apart: Floats | float = 0.0
) -> Points:
    """Return the points of rows (q, p) of shapes (n, 3, p) with covariance (n, 3p, 3p), if any.

    They have a variance of their own besides, that of the standard deviations `apart` (q,).
    """
    points = shapes @ rows.T
    if covariance is None:
        return Points(points, None, None)
    n, p = len(shapes), rows.shape[1]
    blocks = covariance.reshape(n, 3, p, 3, p)

    def of(a: int, b: int) -> Floats:
        found: Floats = np.einsum("qi,nij,qj->nq", rows, blocks[:, a, :, b], rows, optimize=True)
        return found

    variance = np.maximum(np.stack([of(a, a) for a in range(3)], axis=1), 0.0)
    deviation: Floats = np.sqrt(variance + np.square(apart))
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.stack(
            [of(a, b) / (deviation[:, a] * deviation[:, b]) for a, b in PAIRS], axis=1
        )
    return Points(points, deviation, np.nan_to_num(correlation))


def as_joints(lifting: Lifting, A: Floats, keep_covariance: bool) -> Lifting:
    """Return a lifting of landmarks y = A x with the joints x as its shapes, and their error bars.

    The landmarks fitted stay those of y. Shapes stay about the middle that those of y have.
    """
    back = np.asarray(np.linalg.inv(A), dtype=np.float64)
    found = lifting.estimate
    joints = see_rows(back, found.shapes, found.covariance)
    whole = found.covariance
    if whole is not None:
        every = np.kron(np.eye(3), back)
        whole = every @ whole @ every.T if keep_covariance else None
    further = dict(found.further)
    if joints.correlation is not None:
        further[CORRELATION] = joints.correlation.swapaxes(1, 2).astype(np.float32)
    return replace(
        lifting,
        shapes=lifting.shapes @ back.T,
        estimate=replace(
            found,
            shapes=joints.points,
            deviation=joints.deviation if joints.deviation is not None else found.deviation,
            covariance=whole,
            further=further,
        ),
    )
