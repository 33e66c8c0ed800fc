"""Mesh files of a result, one per image, named after its item: OBJ, PLY or GLB."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import read_dictionary
from shapefit.io.atomic import check_folder, file_stem, staged_files, storage_errors
from shapefit.io.source import open_results
from shapefit.meshes.dense import metric_scale
from shapefit.pipelines.result import Failure, Result, warn_of_empty
from shapefit.records import Fit

MESHES_AT_ONCE = 64
"""Images whose vertices are in memory at a time."""

MESH_COLOUR = (120, 155, 190)
"""In GLB."""


def write_meshes(
    files: Sequence[Path], dictionary_file: Path | None, folder: Path, file_format: str
) -> Iterator[Result]:
    """Write into a folder the mesh of each image of results that has a shape.

    Yields a Result per batch. dictionary_file is that of their fit. The files appear in
    the folder together at the end. Raises InputError for results that have no meshes,
    and a folder that cannot get files.
    """
    if dictionary_file is None:
        fix = "name the dictionary of the fit, for example -d cars.h5"
        raise input_error("dictionary", "meshes are made of those of a dictionary", fix)
    check_folder(folder)
    dictionary = read_dictionary(dictionary_file)
    count = 0
    with open_results(files) as source:
        if source.head.landmark_names != dictionary.landmark_names:
            problem = f"its landmarks are not those of {files[0]}"
            raise input_error(
                dictionary_file, problem, "name the dictionary of the fit"
            )
        mixes = source.head.coefficients is not None
        check_has_meshes(dictionary, files[0], mixes_atoms=mixes)
        with staged_files(folder) as staging:
            for batch in source.batches(MESHES_AT_ONCE):
                has_mesh = has_shape(batch)
                images = batch.take(np.flatnonzero(has_mesh))
                placed = mix_object_meshes(images, dictionary)
                for item, vertices in zip(images.items, placed, strict=True):
                    stem = file_stem(item)
                    file = staging / stem.with_name(f"{stem.name}.{file_format}")
                    file.parent.mkdir(parents=True, exist_ok=True)
                    mesh = encode_mesh(vertices, dictionary.mesh_faces, file_format)
                    with storage_errors(folder, None):
                        file.write_bytes(mesh)
                count += len(images)
                failures = tuple(
                    Failure(batch.items[row], "has no shape, and so no mesh")
                    for row in np.flatnonzero(~has_mesh).tolist()
                )
                yield Result(
                    done=len(batch),
                    total=source.count,
                    unit="image",
                    failures=failures,
                )
    warnings = warn_of_empty(source.count, "images")
    yield Result(
        total=source.count,
        warnings=warnings,
        note="1 mesh" if count == 1 else f"{count} meshes",
        written=(folder,) if count else (),
    )


def check_has_meshes(
    dictionary: Dictionary, place: str | Path, *, mixes_atoms: bool
) -> None:
    """Raise InputError at `place` where results of this dictionary have no meshes.

    mixes_atoms: whether the shapes are combinations of the atoms, as the meshes then
    are.
    """
    if dictionary.mesh_vertices is None:
        fix = (
            "learn it by `method: exemplars` from shapes with `mesh_vertices` and"
            " `mesh_faces`"
        )
        raise input_error(place, "has no mesh to export", fix)
    if not mixes_atoms:
        fault = "the result has no coefficients to combine the meshes of the atoms"
        raise input_error(place, fault, "fit with `--method convex` or `convex+refine`")


def mix_object_meshes(result: Fit, dictionary: Dictionary) -> Floats:
    """Return vertices (n, 3, q) in the object frame: size * sum_i c_i (V_i - o_i).

    The frame is that of the dictionary's training shapes, with their origins o_i, in
    which objects stand upright, and on the ground if these did; a dictionary that does
    not know it has the centroid of the landmarks there. The size is that of the
    dictionary's shapes (metres, for instance) where it knows the sizes of its atoms,
    else that of the shape in the image.
    """
    c, size = result.coefficients, result.scale
    vertices = dictionary.mesh_vertices
    assert vertices is not None
    assert c is not None, "`check_has_meshes` asks for them"
    assert size is not None, "every fit has it"
    if dictionary.atom_scale is not None:
        size = metric_scale(dictionary.atoms, c, dictionary.atom_scale)
    if dictionary.atom_origin is not None:
        vertices = vertices - dictionary.atom_origin[:, :, None]
    return np.asarray(size[:, None, None] * np.tensordot(c, vertices, axes=1))


def has_shape(result: Fit) -> Flags:
    """Return which images (n,) have a finite shape with an extent, and a rotation."""
    extent = np.ptp(result.shapes, axis=1).max(axis=1)
    turned = 0.0 if result.rotation is None else result.rotation.sum(axis=(1, 2))
    return np.asarray(np.isfinite(extent + turned) & (extent > 0))


def encode_mesh(vertices: Floats, faces: Integers | None, file_format: str) -> bytes:
    """Return the bytes of an OBJ, PLY or GLB file of vertices (3, q) and faces (f, 3).

    They are one object called `mesh`. Coordinates, order and winding stay as given,
    whatever the format.
    """
    from trimesh import Scene, Trimesh
    from trimesh.exchange.gltf import export_glb
    from trimesh.exchange.obj import export_obj
    from trimesh.exchange.ply import export_ply
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    look = {
        "baseColorFactor": MESH_COLOUR,
        "metallicFactor": 0.0,
        "roughnessFactor": 0.6,
    }
    visual = TextureVisuals(material=PBRMaterial(name="mesh", **look))
    mesh = Trimesh(
        vertices.T, faces, process=False, visual=visual, metadata={"name": "mesh"}
    )
    if file_format == "ply":
        return bytes(export_ply(mesh, encoding="binary", vertex_normal=False))
    scene = Scene()
    scene.add_geometry(mesh, node_name="mesh", geom_name="mesh")
    if file_format == "glb":
        return bytes(export_glb(scene, include_normals=False))
    text: str = export_obj(scene, include_texture=False, header=None)
    return text.strip().encode() + b"\n"
