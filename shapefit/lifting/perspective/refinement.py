"""One shape under a full perspective projection, refined from where another method left it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.convex.solution import Status, read_statuses
from shapefit.geometry.pinhole import Camera
from shapefit.lifting.options import PerspectiveOptions
from shapefit.lifting.perspective.start import place_in_depth

FAILED = (Status.DEGENERATE, Status.NUMERICAL_FAILURE)
"""How a refinement without a result ends."""


@dataclass(frozen=True)
class Refined:
    """Stationary points for n images: X = R sum_i c_i B_i + t.

    rotation R (n, 3, 3); translation t (n, 3); coefficients c (n, k) >= 0; objective (n,);
    rounds (n,); status, a Status per image. nan where it is DEGENERATE, which means that a landmark
    begins behind the camera, or NUMERICAL_FAILURE.
    """

    rotation: Floats
    translation: Floats
    coefficients: Floats
    objective: Floats
    rounds: NDArray[np.int64]
    status: tuple[Status, ...]


def refine_perspective(
    landmarks: Floats,
    weights: Floats,
    atoms: Floats,
    camera: Camera,
    rotation: Floats,
    prior: Floats,
    options: PerspectiveOptions,
) -> Refined:
    """min over R, t, c >= 0 of sum_j s^2/2 log(1 + |r_j|^2 / s^2) + ridge/2 |c - prior|^2.

    s is the softness of the options, with ridge and the maximum rounds per image.
    r_j = Omega_j (w_j - projection of column j of R sum_i c_i B_i + t), in normalised units:
    landmarks w (n, 2, p), weights Omega (n, p), atoms B (k, 3, p), camera in the unit of w. It
    starts from the rotations R (n, 3, 3), c = prior (k,), and t where weak perspective puts it.
    A shape twice as large at twice the depth looks the same, so the size is fixed:
    prior^T c = prior^T prior. The result is a local minimum; no certificate bounds it.
    """
    n = len(landmarks)
    R = np.array(rotation, np.float64)
    c = np.tile(np.asarray(prior, np.float64), (n, 1))
    t = place_in_depth(landmarks, weights, np.tensordot(prior, atoms, axes=1), camera, R)
    objective, rounds, codes = np.full(n, np.nan), np.zeros(n, np.int64), np.zeros(n, np.int64)
    core.refine_perspective(
        landmarks=np.ascontiguousarray(landmarks, np.float64),
        weights=np.ascontiguousarray(weights, np.float64),
        atoms=np.ascontiguousarray(atoms, np.float64),
        prior=np.ascontiguousarray(prior, np.float64),
        focal=np.ascontiguousarray(camera.focal, np.float64),
        centre=np.ascontiguousarray(camera.centre, np.float64),
        sign=camera.sign,
        ridge=options.ridge,
        softness=options.softness,
        max_rounds=options.max_rounds,
        rotation=R,
        translation=t,
        coefficients=c,
        objective=objective,
        rounds=rounds,
        status=codes,
        threads=options.threads,
    )
    failed = np.isin(codes, [list(Status).index(status) for status in FAILED])
    R[failed], t[failed], c[failed] = np.nan, np.nan, np.nan
    return Refined(R, t, c, objective, rounds, read_statuses(codes))
