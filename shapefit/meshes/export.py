"""Mesh files in memory: OBJ, PLY and GLB; and tubes for shapes that have edges and no faces."""

from __future__ import annotations

from functools import cache
from typing import Literal

import numpy as np

from shapefit.arrays import Floats, Integers

MeshFormat = Literal["obj", "ply", "glb"]
"""OBJ keeps 8 decimals, PLY and GLB single precision."""

COLOUR = (120, 155, 190)
"""Of a mesh, in GLB."""
SIDES = 8
"""Corners of the rings of a tube."""
GOLDEN = (np.sqrt(5) - 1) / 2
"""Each tube is turned by this part of a side against the last: no two rings ever coincide, for
what reads a mesh may merge vertices that do, and the tubes would no longer be closed."""
SHORTEST = 0.1
"""Length of the shortest tube in radii: with none at all its rings would fall together."""


def mesh_file(vertices: Floats, faces: Integers, file_format: MeshFormat) -> bytes:
    """Encode one mesh, vertices (3, q) and faces (f, 3), as one object called `mesh`.

    Coordinates, order and winding stay as given, whatever the format.
    """
    from trimesh import Scene, Trimesh
    from trimesh.exchange.gltf import export_glb
    from trimesh.exchange.obj import export_obj
    from trimesh.exchange.ply import export_ply
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    material = PBRMaterial(
        name="mesh", baseColorFactor=COLOUR, metallicFactor=0.0, roughnessFactor=0.6
    )
    look = TextureVisuals(material=material)
    mesh = Trimesh(vertices.T, faces, process=False, visual=look, metadata={"name": "mesh"})
    if file_format == "ply":
        return bytes(export_ply(mesh, encoding="binary", vertex_normal=False))
    scene = Scene()
    scene.add_geometry(mesh, node_name="mesh", geom_name="mesh")
    if file_format == "glb":
        return bytes(export_glb(scene, include_normals=False))
    text: str = export_obj(scene, include_normals=False, include_texture=False, header=None)
    return text.strip().encode() + b"\n"


def tubes(points: Floats, edges: Integers, thickness: float = 0.01) -> tuple[Floats, Integers]:
    """Tubes with round ends along the edges -> vertices (3, v) and faces (f, 3).

    points (3, p), edges (e, 2); thickness is the diameter as a share of the largest extent of the
    points. Each tube is a closed surface of its own, wound outwards, with as many vertices as the
    others; where edges meet, the tubes overlap. An edge given twice has one tube; they are sorted.
    """
    first, second = np.unique(np.sort(edges, axis=1), axis=0).T
    radius = thickness / 2 * np.ptp(points, axis=1).max()
    along = points[:, second] - points[:, first]
    length = np.linalg.norm(along, axis=0)
    along = np.where(length > 0, along / np.where(length > 0, length, 1.0), np.eye(3)[:, 2:])
    ends, corners, faces = _capsule()
    across = np.eye(3)[np.abs(along).argmin(axis=0)].T
    x = np.cross(across, along, axis=0)
    x /= np.linalg.norm(x, axis=0)
    y = np.cross(along, x, axis=0)
    angle = 2 * np.pi / SIDES * GOLDEN * np.arange(len(first))
    x, y = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    frames = radius * np.stack([x, y, along])  # (3 axes, 3, e)
    placed = np.einsum("ca,axe->xec", corners, frames)
    far = np.maximum(length, SHORTEST * radius) * along
    placed += points[:, first, None] + far[:, :, None] * ends
    offsets = len(corners) * np.arange(len(first))[:, None, None]
    return placed.reshape(3, -1), (faces + offsets).reshape(-1, 3)


@cache
def _capsule() -> tuple[Floats, Floats, Integers]:
    """Return the capsule of radius 1 and length 0 along z: ends (c,), corners (c, 3), faces.

    The end of a corner is 1 where it moves with the far end of an edge, else 0.
    """
    from trimesh.creation import capsule

    tube = capsule(height=1.0, radius=1.0, count=[4, SIDES])
    ends = (tube.vertices[:, 2] > tube.vertices[:, 2].mean()).astype(float)
    corners = tube.vertices - tube.vertices.mean(axis=0)
    corners[:, 2] -= ends - 0.5
    return ends, corners, np.asarray(tube.faces)
