"""Views of a car from the street: a pinhole camera, and which landmarks the car itself hides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sample_data.car_body import Floats, Integers

IMAGE_SIZE = (1280, 960)
FOCAL_LENGTH = 1600.0
LOOK_AT = np.array([0.0, 0.70, 0.0])
CLEARANCE = 0.03  # metres before a landmark in which a surface does not hide it


@dataclass(frozen=True)
class Camera:
    """Rotation (3, 3) from the car to the camera (x right, y down, z forward), and its place."""

    rotation: Floats
    place: Floats

    def picture(self, points: Floats) -> Floats:
        """Pixels (p, 2) of points (p, 3), y down from the upper left corner."""
        x, y, z = self.rotation @ (points - self.place).T
        return np.array(IMAGE_SIZE) / 2 + FOCAL_LENGTH * np.stack([x / z, y / z], axis=1)

    def visible(self, points: Floats, vertices: Floats, faces: Integers) -> np.ndarray:
        """Whether the way from each point (p, 3) to the camera is free of the mesh (bool (p,))."""
        before = points + CLEARANCE * _unit(self.place - points)
        return ~_hits(self.place, before, vertices[faces])


def look(azimuth: float, elevation: float, roll: float, distance: float) -> Camera:
    """Camera on a sphere around the car; azimuth 0 is before it, 90 on its left; degrees."""
    a, e, r = np.radians([azimuth, elevation, roll])
    outward = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    right = _unit(np.cross(-outward, [0.0, 1.0, 0.0]))
    upright = np.stack([right, np.cross(-outward, right), -outward])
    turn = np.array([[np.cos(r), -np.sin(r), 0], [np.sin(r), np.cos(r), 0], [0, 0, 1]])
    return Camera(turn @ upright, LOOK_AT + distance * outward)


def camera_matrix() -> Floats:
    """Intrinsics (3, 3) of every view."""
    matrix = np.diag([FOCAL_LENGTH, FOCAL_LENGTH, 1.0])
    matrix[:2, 2] = np.array(IMAGE_SIZE) / 2
    return matrix


def _hits(start: Floats, ends: Floats, triangles: Floats) -> np.ndarray:
    """Whether the segment from `start` to each of `ends` crosses a triangle (f, 3, 3).

    Solves start + t (end - start) = a + u (b - a) + v (c - a) for each pair.
    """
    a, b, c = triangles.transpose(1, 0, 2)
    ab, ac, offset = b - a, c - a, start - a
    normal = np.cross(ab, ac)
    away = np.cross(offset, np.stack([ab, ac]))
    way = ends - start
    determinant = -way @ normal.T
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (offset * normal).sum(axis=1) / determinant
        u = -(way @ away[1].T) / determinant
        v = way @ away[0].T / determinant
    return ((t > 0) & (t < 1) & (u >= 0) & (v >= 0) & (u + v <= 1)).any(axis=1)


def _unit(vectors: Floats) -> Floats:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
