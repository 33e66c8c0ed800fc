"""Solids for shapes without faces: a tube for each edge, a ball for each landmark."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats, Integers

SIDES = 8
"""Corners of the rings that a solid is made of."""

SHORTEST = 0.1
"""Length of the shortest tube in radii: with none at all its rings would fall together."""

GOLDEN = (np.sqrt(5) - 1) / 2
"""Each solid is turned by this part of a side against the last: no two rings ever coincide, for
what reads a mesh may merge vertices that do, and the tubes would no longer be closed."""

_D = np.sqrt(0.5)
# Rings from pole to pole: the end of the edge that they belong to (0 or 1), and their height along
# the edge and their radius, in radii of the solid. The first and the last are single points.
_TUBE = np.array([(0, -1, 0), (0, -_D, _D), (0, 0, 1), (1, 0, 1), (1, _D, _D), (1, 1, 0)])
_BALL = np.array([(0, -1, 0), (0, -_D, _D), (0, 0, 1), (0, _D, _D), (0, 1, 0)])


def tubes(points: Floats, edges: Integers, thickness: float = 0.01) -> tuple[Floats, Integers]:
    """Tubes with round ends along the edges -> vertices (..., 3, v) and faces (f, 3).

    points (..., 3, p), edges (e, 2); thickness is the diameter as a share of the largest extent of
    the points. Each tube is a closed surface of its own, wound outwards; where edges meet, the
    tubes overlap. An edge given twice has one tube. All shapes of a batch have the same faces.
    """
    first, second = np.unique(np.sort(edges, axis=1), axis=0).T
    start, end = points[..., first], points[..., second]
    radius = _radius(points, thickness)
    along, length = _directions(end - start)
    longer = np.maximum(length, SHORTEST * radius[..., None])[..., None, :]
    return _solids(start, start + longer * along, along, radius, _TUBE)


def balls(points: Floats, diameter: float = 0.02) -> tuple[Floats, Integers]:
    """Balls around the points (..., 3, p) -> vertices (..., 3, v) and faces (f, 3).

    diameter is a share of the largest extent of the points. Each ball is a closed surface of its
    own, wound outwards, and the mean of its vertices is its point.
    """
    along = np.broadcast_to(np.array([0.0, 0.0, 1.0])[:, None], points.shape)
    return _solids(points, points, along, _radius(points, diameter), _BALL)


def _radius(points: Floats, diameter: float) -> Floats:
    extent: Floats = np.ptp(points, axis=-1).max(axis=-1)
    return diameter / 2 * extent


def _directions(vectors: Floats) -> tuple[Floats, Floats]:
    """Unit vectors (..., 3, e), z where there is no direction, and lengths (..., e)."""
    length = np.linalg.norm(vectors, axis=-2)
    z = np.zeros_like(vectors)
    z[..., 2, :] = 1
    some = length[..., None, :] > 0
    return np.divide(vectors, length[..., None, :], out=z, where=some), length


def _solids(
    start: Floats, end: Floats, along: Floats, radius: Floats, profile: Floats
) -> tuple[Floats, Integers]:
    """Turn the profile around each of the m axes; start, end, along (..., 3, m), radius (...).

    Vertices are in the order solid, ring, corner; the poles have one corner.
    """
    which, height, width = profile.T
    first, second = _normals(along)
    count = along.shape[-1]
    corner = np.arange(SIDES) + GOLDEN * np.arange(count)[:, None]
    angle = 2 * np.pi / SIDES * corner  # (m, s)
    outward = first[..., None] * np.cos(angle) + second[..., None] * np.sin(angle)  # (..., 3, m, s)
    r = radius[..., None, None, None]
    ends = np.where(which == 0, start[..., None], end[..., None])  # (..., 3, m, rings)
    middle = ends + r * height * along[..., None]
    rings = middle[..., None] + (r * width)[..., None] * outward[..., None, :]
    flat = rings[..., 1:-1, :].reshape(*middle.shape[:-1], -1)
    solids = np.concatenate([middle[..., :1], flat, middle[..., -1:]], axis=-1)
    corners = solids.shape[-1]
    offsets = corners * np.arange(count)[:, None, None]
    faces = (_faces(len(profile) - 2) + offsets).reshape(-1, 3)
    return solids.reshape(*solids.shape[:-2], -1), faces


def _normals(along: Floats) -> tuple[Floats, Floats]:
    """Two unit vectors that make a right-handed frame with each unit vector of (..., 3, m)."""
    least = np.abs(along).argmin(axis=-2)
    axis = np.moveaxis(np.eye(3)[least], -1, -2)
    first, _ = _directions(np.cross(axis, along, axis=-2))
    return first, np.cross(along, first, axis=-2)


def _faces(rings: int) -> Integers:
    """Triangles of one solid with poles 0 and 1 + rings * SIDES, wound outwards."""
    here = np.arange(SIDES)
    there = np.roll(here, -1)
    triangles = [np.stack([np.zeros_like(here), there + 1, here + 1], axis=1)]
    for ring in range(rings - 1):
        low, high = 1 + ring * SIDES, 1 + (ring + 1) * SIDES
        triangles.append(np.stack([low + here, low + there, high + here], axis=1))
        triangles.append(np.stack([low + there, high + there, high + here], axis=1))
    top = 1 + (rings - 1) * SIDES
    pole = np.full_like(here, top + SIDES)
    triangles.append(np.stack([top + here, top + there, pole], axis=1))
    return np.concatenate(triangles)
