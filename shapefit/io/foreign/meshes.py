"""Meshes (OBJ, PLY, GLB) as shapes: each is one, and a file beside it says where landmarks are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.errors import counted, input_error
from shapefit.io.foreign.detections import read_json
from shapefit.io.foreign.text_table import Table
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.names import match_landmarks
from shapefit.io.records import ShapeSet

Place = int | tuple[float, ...]
Places = Mapping[str, Place]
"""The number of a vertex, from 0, or a point in the frame of the mesh, by landmark."""

FORMS = "`landmark,vertex` or `landmark,x,y,z` in CSV, or {name: vertex or [x, y, z]} in JSON"

METRES = ".glb"
"""Endings of the format whose unit is the metre; the others have none."""


def read_meshes(paths: tuple[Path, ...], *, gaps: bool = False) -> tuple[ShapeSet, tuple[str, ...]]:
    """Return the meshes of a folder as shapes of their landmarks, named after the files.

    Vertices and faces are kept where all meshes have the same faces. Raises InputError for a mesh
    without landmarks or with other ones than the first, and for one that cannot be read.
    """
    loaded = [_load(path) for path in paths]
    places = [_read_places(path) for path in paths]
    names = tuple(places[0])
    found = [
        _find_landmarks(path, vertices, place, names)
        for path, (vertices, _), place in zip(paths, loaded, places, strict=True)
    ]
    notes: tuple[str, ...] = ()
    vertices, faces = loaded[0]
    shared = all(v.shape == vertices.shape and np.array_equal(f, faces) for v, f in loaded)
    kept = shared and len(faces) > 0
    if not kept and len(paths) > 1:
        notes = (
            f"{paths[0].parent}: {len(paths)} meshes of different faces; "
            "only their landmarks are read",
        )
    metres = all(path.suffix.lower() == METRES for path in paths)
    shapes = ShapeSet(
        shapes=np.array(found).transpose(0, 2, 1),
        landmark_names=names,
        items=tuple(path.stem for path in paths),
        mesh_vertices=np.array([v.T for v, _ in loaded]) if kept else None,
        mesh_faces=faces if kept else None,
        unit="m" if metres else UNKNOWN_UNIT,
    )
    return shapes, notes


def _load(path: Path) -> tuple[Floats, Integers]:
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


def _read_places(mesh: Path) -> Places:
    """Read NAME.landmarks.json or .csv beside NAME.obj, or landmarks.json or .csv for all there.

    Raises InputError where there is none, and for a file of another form.
    """
    names = [f"{mesh.stem}.landmarks", "landmarks"]
    wanted = [mesh.with_name(f"{name}.{kind}") for name in names for kind in ("json", "csv")]
    path = next((path for path in wanted if path.is_file()), None)
    if path is None:
        found = "nothing says which of its vertices are landmarks"
        fix = f"write {wanted[1].name} beside it, or {wanted[3].name} for all meshes there: {FORMS}"
        raise input_error(mesh, found, fix)
    places = _of_json(path) if path.suffix == ".json" else _of_csv(path)
    if not places:
        raise input_error(path, "names no landmarks", f"write {FORMS}")
    return places


def _of_json(path: Path) -> Places:
    found = read_json(path)
    if not isinstance(found, dict):
        raise input_error(path, "is no JSON object", f"write {FORMS}")
    return {name: _place(value, f"{path}: {name}") for name, value in found.items()}


def _of_csv(path: Path) -> Places:
    table = Table(path)
    ((line, header),) = table.first_rows(1) or [(1, [])]
    header = [cell.strip() for cell in header]
    if header not in (["landmark", "vertex"], ["landmark", "x", "y", "z"]):
        raise input_error(f"{path}:1", f"the header is {','.join(header)[:80]!r}", f"write {FORMS}")
    table.skip(line, header)
    values, (names,), lines = table.read(range(1, len(header)), [0], finite=True, empty=False)
    places: dict[str, Place] = {}
    for name, own, line in zip(names, values.tolist(), lines.tolist(), strict=True):
        if name in places:
            raise input_error(
                f"{path}:{line}", f"the landmark {name!r} repeats", "keep one of them"
            )
        value = own if len(own) == 3 else int(own[0]) if own[0].is_integer() else own[0]
        places[name] = _place(value, f"{path}:{line}")
    return places


def _place(value: Any, place: str) -> Place:
    if type(value) is int:
        return value
    plain = isinstance(value, list) and all(type(x) in (int, float) for x in value)
    if plain and len(value) == 3 and np.isfinite(value).all():
        return tuple(map(float, value))
    fix = "give the number of a vertex, from 0, or three coordinates"
    raise input_error(place, f"{str(value)[:40]!r} is no place", fix)


def _find_landmarks(path: Path, vertices: Floats, places: Places, names: tuple[str, ...]) -> Floats:
    """Return the landmarks (p, 3) of a mesh. Raises InputError for other names than these."""
    match_landmarks(tuple(places), names, f"{path}: landmarks")
    match_landmarks(names, tuple(places), f"{path}: landmarks")
    for name, place in places.items():
        if isinstance(place, int) and not 0 <= place < len(vertices):
            there = counted(len(vertices), "vertex").replace("vertexs", "vertices")
            what = f"the landmark {name!r} is vertex {place} of {there}"
            raise input_error(path, what, "count vertices from 0, in the order of the file")
    found = [
        vertices[place] if isinstance(place, int) else place for place in map(places.get, names)
    ]
    return np.array(found, dtype=np.float64)
