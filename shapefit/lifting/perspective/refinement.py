"""One shape under a full perspective projection, refined from where another method left it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.convex.solution import Status
from shapefit.geometry.normalisation import Normalised
from shapefit.lifting.estimate import STATUS

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

FAILED = (Status.DEGENERATE, Status.NUMERICAL_FAILURE)
"""How a refinement without a result ends."""


@dataclass(frozen=True)
class Camera:
    """u = centre + focal X_xy / (sign X_z) for n images: focal (n, 2) > 0, centre (n, 2).

    In the unit of the landmarks they go with. sign is +1 where z points away from the camera (y of
    the landmarks down), -1 where it points to it (y up).
    """

    focal: Floats
    centre: Floats
    sign: float

    def take(self, images: Rows) -> Camera:
        """Keep some of the images."""
        return Camera(self.focal[images], self.centre[images], self.sign)

    def normalised_as(self, landmarks: Normalised) -> Camera:
        """Return the camera that sees the same as normalised landmarks."""
        size = landmarks.scale[:, None]
        return Camera(self.focal / size, (self.centre - landmarks.centroid) / size, self.sign)


@dataclass(frozen=True, kw_only=True)
class Options:
    """What `refine_perspective` can be told."""

    ridge: float
    softness: float
    max_rounds: int
    threads: int = 0


@dataclass(frozen=True)
class Refined:
    """Stationary points for n images: X = R sum_i c_i B_i + t.

    rotation R (n, 3, 3); translation t (n, 3); coefficients c (n, k) >= 0; objective (n,);
    rounds (n,); status, a Status an image. nan where it is DEGENERATE, which means that a landmark
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
    options: Options,
) -> Refined:
    """min over R, t, c >= 0 of sum_j s^2/2 log(1 + |r_j|^2 / s^2) + ridge/2 |c - prior|^2.

    s is the softness of the options, with ridge and the most rounds for an image.
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
    failed = np.isin(codes, [STATUS.index(status) for status in FAILED])
    R[failed], t[failed], c[failed] = np.nan, np.nan, np.nan
    return Refined(R, t, c, objective, rounds, tuple(STATUS[code] for code in codes))


def project(camera: Camera, points: Floats) -> Floats:
    """u = centre + focal X_xy / (sign X_z): points (n, 3, p) in the camera's frame -> (n, 2, p).

    nan for a point that is not in front of the camera.
    """
    depth = camera.sign * points[:, 2:]
    depth = np.where(depth > 0, depth, np.nan)
    return camera.centre[..., None] + camera.focal[..., None] * points[:, :2] / depth


def depth_sign(y_axis: Literal["up", "down"]) -> float:
    """+1 where z, the cross product of x and y, points away from the camera, else -1."""
    return 1.0 if y_axis == "down" else -1.0


def place_in_depth(
    landmarks: Floats, weights: Floats, shape: Floats, camera: Camera, rotation: Floats
) -> Floats:
    """t (n, 3) at which R S, seen by weak perspective, has the size and place of the landmarks.

    The depth is that of the visible landmarks' middle; S (3, p), the rest as above.
    """
    omega = np.where(weights > 0, weights, 0.0) ** 2
    share = omega / omega.sum(axis=1, keepdims=True)
    X = rotation @ shape
    W = np.where(weights[:, None] > 0, landmarks, 0.0)
    middle, seen = np.einsum("nap,np->na", X, share), np.einsum("nap,np->na", W, share)
    rays = (W - camera.centre[..., None]) / camera.focal[..., None]
    ray = (seen - camera.centre) / camera.focal
    flat = X[:, :2] - middle[:, :2, None]
    spread = np.einsum("nap,nap,np->n", flat, flat, share)
    overlap = np.einsum("nap,nap,np->n", flat, rays - ray[..., None], share)
    # a rotation that fits not at all must not put the shape at infinity
    least = 0.1 * np.sqrt(
        spread * np.einsum("nap,nap,np->n", *(2 * (rays - ray[..., None],)), share)
    )
    with np.errstate(divide="ignore"):  # the camera cannot tell the landmarks apart
        depth = spread / np.maximum(overlap, least)
    t = np.empty((len(W), 3))
    t[:, :2] = ray * depth[:, None] - middle[:, :2]
    t[:, 2] = camera.sign * depth - middle[:, 2]
    return t


def mean_coefficients(atoms: Floats, mean_shape: Floats) -> Floats:
    """argmin_{c >= 0} |sum_i c_i B_i - mean_shape|^2 + a little |c|^2: (k,).

    For exemplars all are alike, 1/k over the spread of their mean.
    """
    k = len(atoms)
    A = atoms.reshape(k, -1).T
    little = 1e-3 * np.linalg.norm(A, axis=0).max()
    c = np.zeros((1, k))
    core.code(
        gram=A.T @ A + little**2 * np.eye(k),
        pulls=np.reshape(mean_shape.ravel() @ A, (1, k)),
        smallest_moves=np.array([1e-12 * np.linalg.norm(mean_shape)]),
        coefficients=c,
        unsettled=np.zeros(1, dtype=bool),
        threads=1,
    )
    return c[0]
