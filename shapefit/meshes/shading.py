"""A mesh as flat coloured triangles: painter's algorithm and Lambert shading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shapefit.arrays import Floats, Integers

# In the viewer's frame: the lamp shines over the viewer's left shoulder.
LAMP = np.array([-0.4, 0.75, 0.53]) / np.linalg.norm([-0.4, 0.75, 0.53])
AMBIENT, FROM_LAMP, FROM_VIEWER = 0.26, 0.52, 0.22


@dataclass(frozen=True)
class Painted:
    """What the viewer sees of a mesh, in the plane of the picture.

    triangles (m, 3, 2) in the order to paint them, back to front, and their colours (m, 3);
    outline (l, 2, 2): the edges behind which the surface turns away. Painted first and wide, only
    those of the silhouette show.
    """

    triangles: Floats
    colours: Floats
    outline: Floats


def paint(vertices: Floats, faces: Integers, colour: tuple[float, float, float]) -> Painted:
    """Colour the faces that the viewer sees: colour * (ambient + lamp n.l + viewer n_z).

    vertices (3, q) in the viewer's frame (x right, y up, z towards the viewer), faces (f, 3) wound
    counter-clockwise seen from outside; those that face away, or have no area, are left out. A
    face is painted over those whose middle is further away: right for small faces of about equal
    size that do not cut each other.
    """
    corners = vertices.T[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    seen = normals[:, 2] > 0
    outline = vertices.T[_border(faces[seen])][..., :2]
    corners, normals = corners[seen], normals[seen]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    order = np.argsort(corners[:, :, 2].mean(axis=1), kind="stable")
    light = AMBIENT + FROM_LAMP * np.maximum(normals @ LAMP, 0) + FROM_VIEWER * normals[:, 2]
    shaded = light[:, None] * np.asarray(colour)
    return Painted(corners[order, :, :2], shaded[order], outline)


def _border(faces: Integers) -> Integers:
    """Edges (l, 2) that belong to one of the faces (f, 3) only."""
    edges = np.sort(np.concatenate([faces[:, :2], faces[:, 1:], faces[:, ::2]]), axis=1)
    different, count = np.unique(edges, axis=0, return_counts=True)
    return different[count == 1]
