"""Landmarks seen by a pinhole camera, and what a posterior in its rays says of the shape.

A shape whose middle is at the depth D of a camera with the focal length f is s = f / D times as
large in the image as it is. In that unit its middle lies at the depth f, and landmark j, which is
seen in the direction u_j, at

    s (X_j + t) = u_j (f +- s Z_j)     in x and y,

+ where z points away from the camera. So f u_j = s (X_j + t -+ u_j Z_j) + e_j: linear in the shape,
like weak perspective, with the slope +-u_j for each landmark.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.geometry.pinhole import Camera


@dataclass(frozen=True)
class Rays:
    """f u (n, 2, p) with f the geometric mean of both focal lengths, slopes (n, 2, p), f (n,)."""

    landmarks: Floats
    slopes: Floats
    focal: Floats


@dataclass(frozen=True)
class Placement:
    """Shapes S (n, 3, p) about their middle and t (n, 3), in the unit of the dictionary.

    The camera sees S + t; middle (n, 2) is where it sees t.
    """

    shapes: Floats
    translation: Floats
    middle: Floats


def find_rays(landmarks: Floats, camera: Camera) -> Rays:
    """Return the rays of landmarks (n, 2, p), in the unit of the camera."""
    directions = (landmarks - camera.centre[..., None]) / camera.focal[..., None]
    focal = np.sqrt(camera.focal.prod(axis=1))
    return Rays(focal[:, None, None] * directions, camera.sign * directions, focal)


def stretch_noise(noise: Floats, camera: Camera) -> Floats:
    """Covariances (n, p, 2, 2) of landmarks as those of f u."""
    grow = np.sqrt(camera.focal.prod(axis=1))[:, None] / camera.focal
    stretched: Floats = noise * grow[:, None, :, None] * grow[:, None, None, :]
    return stretched


def face(rotations: Floats, landmarks: Floats, seen: NDArray[np.bool_], camera: Camera) -> Floats:
    """Turn rotations (n, S, 3, 3) of weak perspective, which looks along the ray to the landmarks.

    They are turned with the least turn of the optical axis onto the ray to the middle of the seen
    landmarks (n, 2, p): an object off to the side shows its side.
    """
    count = np.maximum(seen.sum(axis=1), 1)[:, None]
    middle = np.where(seen[:, None], landmarks, 0.0).sum(axis=2) / count
    ray = np.empty((len(landmarks), 3))
    ray[:, :2] = (middle - camera.centre) / camera.focal
    ray[:, 2] = camera.sign
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    axis = np.array([0.0, 0.0, camera.sign])
    x, y, z = np.cross(axis, ray).T
    zero = np.zeros_like(x)
    K = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    turn = np.eye(3) + K + K @ K / (1 + ray @ axis)[:, None, None]
    turned: Floats = turn[:, None] @ rotations
    return turned


def place(points: Floats, scale: Floats, rays: Rays, camera: Camera) -> Placement:
    """Where shapes stand whose points (n, 3, p) are in the unit of the image, at mean depth 0."""
    middle = points[:, :2].mean(axis=2)
    t = np.concatenate([middle, camera.sign * rays.focal[:, None]], axis=1) / scale[:, None]
    S = points / scale[:, None, None]
    S[:, :2] -= t[:, :2, None]
    seen = camera.centre + camera.focal * middle / rays.focal[:, None]
    return Placement(S, t, seen)
