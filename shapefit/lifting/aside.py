"""Landmarks that hang on another and never move it: feet on ankles, where detectors often guess.

    y_a += K ((w_a - y_o) - (w_b - y_b)),    K = C_ao (C_oo + R)^-1,    R = v (I + 1 1^T)

for the shape y of an image, lifted without the landmarks w_a: each is seen from the landmark b that
it hangs on, as the image has both. C is the covariance of y_a where all other landmarks are known,
o are x and y, v is the misfit. v I is the noise of each landmark, v 1 1^T that of the one on which
several hang, in x and in y. The covariance of y becomes T C T^T + K R K^T for y -> T y.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.geometry.pinhole import project
from shapefit.lifting.lift import Lifting

UNSEEN = 1e9
"""Misfit of what an image does not show."""


def place_aside(
    lifting: Lifting, landmarks: Floats, shown: NDArray[np.bool_], hung: Integers, misfit: float
) -> Lifting:
    """Return a lifting with covariances whose landmarks that hang on others are where images say.

    landmarks (n, 2, p) as observed, which of them (n, p) are; hung (p,), what each hangs on, -1
    for nothing; misfit, the variance of landmarks in the unit of shapes.
    """
    found, p = lifting.estimate, len(hung)
    assert found.covariance is not None, "the plan asks for it"
    a, b = np.flatnonzero(hung >= 0), hung[hung >= 0]
    every, o = np.concatenate([a, p + a, 2 * p + a]), np.concatenate([a, p + a])
    rest = np.setdiff1d(np.arange(3 * p), every)
    away = (landmarks - lifting.landmarks_fitted) / lifting.scale[:, None, None]
    seen = np.tile(shown[:, a] & shown[:, b], 2)
    r = np.where(seen, (away[..., a] - away[..., b]).reshape(seen.shape), 0.0)
    R = noise_of_differences(seen, np.concatenate([b, p + b]), misfit)
    C = found.covariance
    known = C[:, rest][:, :, rest] + 1e-6 * np.eye(len(rest))
    across = C[:, every][:, :, rest]
    own = C[:, every][:, :, every] - across @ np.linalg.solve(known, across.swapaxes(1, 2))
    q = len(o)
    K = own[:, :, :q] @ np.linalg.inv(own[:, :q, :q] + R)
    T = np.tile(np.eye(3 * p), (len(C), 1, 1))
    for column, (landmark, other) in enumerate(zip(o, np.concatenate([b, p + b]), strict=True)):
        T[:, every, landmark] -= K[..., column]
        T[:, every, other] += K[..., column]
    C = T @ C @ T.swapaxes(1, 2)
    C[:, every[:, None], every] += K @ R @ K.swapaxes(1, 2)
    step = np.zeros((len(C), 3, p))
    step[..., a] = (K @ r[..., None]).reshape(len(C), 3, -1)
    shapes = lifting.shapes + lifting.scale[:, None, None] * step
    fitted, view = shapes[:, :2], lifting.perspective
    if view is not None:
        about = shapes.copy()
        about[:, :2] -= lifting.translation[..., None]
        about /= lifting.scale[:, None, None]
        fitted = project(view.camera, about + view.translation[..., None])
    return replace(
        lifting,
        shapes=shapes,
        landmarks_fitted=fitted,
        estimate=replace(found, shapes=found.shapes + step, covariance=C),
    )


def noise_of_differences(seen: NDArray[np.bool_], shared: Integers, misfit: float) -> Floats:
    """R (n, q, q): of differences between landmarks and others; equal `shared` (q,) have the same.

    seen (n, q), which differences the images show; the others have the variance UNSEEN.
    """
    both = seen[:, :, None] & seen[:, None] & (shared[:, None] == shared)
    own = np.where(seen, misfit, UNSEEN)
    R: Floats = own[:, :, None] * np.eye(len(shared)) + np.where(both, misfit, 0.0)
    return R
