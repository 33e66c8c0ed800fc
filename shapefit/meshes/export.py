"""Mesh files in memory: OBJ, PLY and GLB, each as the bytes of the files to write."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.meshes.wireframe import balls

if TYPE_CHECKING:
    from trimesh import PointCloud, Trimesh
    from trimesh.path import Path3D

Files = dict[str, bytes]
"""The end of a file's name -> the content of that file."""

COLOURS = {"mesh": (120, 155, 190), "landmarks": (230, 120, 30), "edges": (40, 60, 90)}
"""The objects of a file by name, and their colours where the format has any (GLB)."""


class MeshFormat(StrEnum):
    """Formats of mesh files: OBJ keeps 8 decimals, PLY and GLB single precision."""

    OBJ = "obj"
    PLY = "ply"
    PLY_ASCII = "ply-ascii"
    GLB = "glb"


def mesh_files(
    vertices: Floats, faces: Integers, file_format: MeshFormat, landmarks: Floats | None = None
) -> Files:
    """Encode one mesh, vertices (3, q) and faces (f, 3).

    Coordinates, order and winding stay as given, whatever the format. The landmarks (3, p), if
    given, are a second object named `landmarks`: in OBJ and GLB a little ball each, for most
    viewers of these formats do not show bare points; in PLY, which has no objects, the bare points
    in a file of their own, `-landmarks.ply`. Raises ValueError where a coordinate is not finite or
    a face has a vertex that does not exist.
    """
    mesh = _mesh("mesh", vertices, faces)
    if file_format in (MeshFormat.PLY, MeshFormat.PLY_ASCII):
        return {".ply": _ply(mesh, file_format), **_point_files(landmarks, file_format)}
    return {f".{file_format}": _scene({"mesh": mesh, **_balls(landmarks)}, file_format)}


def line_files(
    points: Floats, edges: Integers, file_format: MeshFormat, landmarks: Floats | None = None
) -> Files:
    """Encode the edges (e, 2) between points (3, p) as lines.

    Lines have no width, and many viewers leave them out: `wireframe.tubes` gives a mesh that all
    of them show. OBJ keeps all points in their order; PLY and GLB hold the two ends of each edge.
    Landmarks are as in `mesh_files`. Raises ValueError as `mesh_files` does.
    """
    from trimesh.path import Path3D
    from trimesh.path.entities import Line

    rows = _rows(points)
    _check_indices(edges, len(rows))
    if file_format is MeshFormat.OBJ:
        return {".obj": _obj_lines(rows, edges, landmarks)}
    path = Path3D([Line(edge) for edge in edges], rows, process=False)
    if file_format is MeshFormat.GLB:
        return {".glb": _scene({"edges": path, **_balls(landmarks)}, file_format)}
    return {".ply": _ply(path, file_format), **_point_files(landmarks, file_format)}


def _point_files(landmarks: Floats | None, file_format: MeshFormat) -> Files:
    """Encode bare points as PLY."""
    from trimesh import PointCloud

    if landmarks is None:
        return {}
    return {"-landmarks.ply": _ply(PointCloud(_rows(landmarks)), file_format)}


def _balls(landmarks: Floats | None) -> dict[str, Trimesh]:
    """Return the object of the landmarks by its name."""
    if landmarks is None:
        return {}
    return {"landmarks": _mesh("landmarks", *balls(_rows(landmarks).T))}


def _mesh(name: str, vertices: Floats, faces: Integers) -> Trimesh:
    from trimesh import Trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    rows = _rows(vertices)
    _check_indices(faces, len(rows))
    material = PBRMaterial(
        name=name, baseColorFactor=COLOURS[name], metallicFactor=0.0, roughnessFactor=0.6
    )
    look = TextureVisuals(material=material)
    return Trimesh(rows, faces, process=False, visual=look, metadata={"name": name})


def _ply(geometry: Trimesh | PointCloud | Path3D, file_format: MeshFormat) -> bytes:
    from trimesh.exchange.ply import export_ply

    encoding = "ascii" if file_format is MeshFormat.PLY_ASCII else "binary"
    return export_ply(geometry, encoding=encoding, vertex_normal=False)


def _scene(objects: Mapping[str, Trimesh | Path3D], file_format: MeshFormat) -> bytes:
    """Encode named objects as OBJ or GLB."""
    from trimesh import Scene
    from trimesh.exchange.gltf import export_glb
    from trimesh.exchange.obj import export_obj

    scene = Scene()
    for name, geometry in objects.items():
        scene.add_geometry(geometry, node_name=name, geom_name=name)
    if file_format is MeshFormat.GLB:
        return export_glb(scene, include_normals=False)
    text: str = export_obj(scene, include_normals=False, include_texture=False, header=None)
    return text.strip().encode() + b"\n"


def _obj_lines(rows: Floats, edges: Integers, landmarks: Floats | None) -> bytes:
    """Write what trimesh cannot: lines in OBJ. All objects count their vertices together."""
    lines = ["o edges", *_obj_vertices(rows)]
    lines += [f"l {first + 1} {second + 1}" for first, second in edges.tolist()]
    if landmarks is not None:
        vertices, faces = balls(_rows(landmarks).T)
        lines += ["o landmarks", *_obj_vertices(vertices.T)]
        lines += [f"f {i} {j} {k}" for i, j, k in (faces + len(rows) + 1).tolist()]
    return "\n".join([*lines, ""]).encode()


def _obj_vertices(rows: Floats) -> list[str]:
    return [f"v {x:.8f} {y:.8f} {z:.8f}" for x, y, z in rows.tolist()]


def _rows(points: Floats) -> Floats:
    """Return points (3, p) as one row each, for trimesh."""
    if not np.isfinite(points).all():
        raise ValueError("a coordinate is not finite")
    return points.T


def _check_indices(indices: Integers, points: int) -> None:
    if ((indices < 0) | (indices >= points)).any():
        raise ValueError(f"an index is not within 0..{points - 1}")
