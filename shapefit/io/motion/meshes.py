"""Meshes (OBJ, PLY, GLB) as shapes: each is one, and a file beside it says where landmarks are."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.errors import counted, input_error
from shapefit.io.landmark_names import match_landmarks
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.motion.mesh_landmarks import Places, read_places
from shapefit.io.records import ShapeSet

METRES = ".glb"
"""Endings of the format whose unit is the metre; the others have none."""


def read(paths: tuple[Path, ...], *, gaps: bool = False) -> tuple[ShapeSet, tuple[str, ...]]:
    """Return the meshes of a folder as shapes of their landmarks, named after the files.

    Vertices and faces are kept where all meshes have the same faces. Raises InputError for a mesh
    without landmarks or with other ones than the first, and for one that cannot be read.
    """
    loaded = [load(path) for path in paths]
    places = [read_places(path) for path in paths]
    names = tuple(places[0])
    found = np.array(
        [
            find_landmarks(path, vertices, place, names)
            for path, (vertices, _), place in zip(paths, loaded, places, strict=True)
        ]
    )
    notes: tuple[str, ...] = ()
    vertices, faces = loaded[0]
    shared = all(v.shape == vertices.shape and np.array_equal(f, faces) for v, f in loaded)
    kept = shared and len(faces) > 0
    if not kept and len(paths) > 1:
        what = f"{counted(len(paths), 'mesh').replace('meshs', 'meshes')} of different faces"
        notes = (f"{paths[0].parent}: {what}; only their landmarks are read",)
    metres = all(path.suffix.lower() == METRES for path in paths)
    shapes = ShapeSet(
        shapes=found.transpose(0, 2, 1),
        landmark_names=names,
        items=tuple(path.stem for path in paths),
        mesh_vertices=np.array([v.T for v, _ in loaded]) if kept else None,
        mesh_faces=faces if kept else None,
        unit="m" if metres else UNKNOWN_UNIT,
    )
    return shapes, notes


def load(path: Path) -> tuple[Floats, Integers]:
    """Return vertices (q, 3) and faces (f, 3) of a mesh, in the order of the file."""
    import trimesh

    try:
        mesh = trimesh.load(path, force="mesh", process=False, maintain_order=True)
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # trimesh has many kinds of error for damaged files
        found = f"cannot be read as a mesh ({error})"
        raise input_error(path, found, "give a whole OBJ, PLY or GLB file") from error
    if vertices.ndim != 2 or not len(vertices):
        raise input_error(path, "has no vertices", "give a mesh")
    if vertices.shape[1] != 3:
        found = f"has vertices of {vertices.shape[1]} coordinates"
        raise input_error(path, found, "give x, y and z for each")
    if not np.isfinite(vertices).all():
        raise input_error(path, "has a vertex that is not finite", "correct it")
    return vertices, faces


def find_landmarks(path: Path, vertices: Floats, places: Places, names: tuple[str, ...]) -> Floats:
    """Return the landmarks (p, 3) of a mesh. Raises InputError for other names than these."""
    match_landmarks(tuple(places), names, f"{path}: landmarks")
    match_landmarks(names, tuple(places), f"{path}: landmarks")
    found = []
    for name in names:
        place = places[name]
        if not isinstance(place, int):
            found.append(place)
            continue
        if not 0 <= place < len(vertices):
            there = counted(len(vertices), "vertex").replace("vertexs", "vertices")
            what = f"the landmark {name!r} is vertex {place} of {there}"
            raise input_error(path, what, "count vertices from 0, in the order of the file")
        found.append(tuple(vertices[place].tolist()))
    return np.array(found, dtype=np.float64)
