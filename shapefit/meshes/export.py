"""Mesh files in memory: OBJ, PLY and GLB."""

from __future__ import annotations

from typing import Literal

from shapefit.arrays import Floats, Integers

MeshFormat = Literal["obj", "ply", "glb"]
"""OBJ keeps 8 decimals, PLY and GLB single precision."""

COLOUR = (120, 155, 190)
"""Of a mesh, in GLB."""


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
