"""Meshes (OBJ, PLY, GLB) as shapes: each is one, and a file beside it says where landmarks are."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from shapefit.arrays import Floats, Integers
from shapefit.errors import InputError, counted, input_error
from shapefit.io.inputs import read_whole
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.names import match_landmarks
from shapefit.io.records import ShapeSet

Place = int | tuple[float, float, float]
Places = Mapping[str, Place]
"""The number of a vertex, from 0, or a point in the frame of the mesh, by landmark."""

FORMS = "`landmark,vertex` or `landmark,x,y,z` in CSV, or {name: vertex or [x, y, z]} in JSON"


def find_file(mesh: Path) -> Path:
    """Return NAME.landmarks.json or .csv beside NAME.obj, or landmarks.json or .csv for all there.

    Raises InputError where there is none.
    """
    names = [f"{mesh.stem}.landmarks", "landmarks"]
    wanted = [mesh.with_name(f"{name}.{kind}") for name in names for kind in ("json", "csv")]
    for path in wanted:
        if path.is_file():
            return path
    found = "nothing says which of its vertices are landmarks"
    fix = f"write {wanted[1].name} beside it, or {wanted[3].name} for all meshes there: {FORMS}"
    raise input_error(mesh, found, fix)


def read_places(mesh: Path) -> Places:
    """Return the places of a mesh's landmarks. Raises InputError for a file of another form."""
    path = find_file(mesh)
    text = read_whole(path).decode("utf-8-sig", "backslashreplace")
    places = _of_json(path, text) if path.suffix == ".json" else _of_csv(path, text)
    if not places:
        raise input_error(path, "names no landmarks", f"write {FORMS}")
    return places


def _of_json(path: Path, text: str) -> Places:
    try:
        found = orjson.loads(text)
    except orjson.JSONDecodeError as error:
        raise input_error(f"{path}:{error.lineno}", f"is no JSON ({error.msg})", FORMS) from error
    if not isinstance(found, dict):
        raise input_error(path, "is no JSON object", f"write {FORMS}")
    return {name: _place(value, f"{path}: {name}") for name, value in found.items()}


def _of_csv(path: Path, text: str) -> Places:
    try:
        rows = [
            (line, [cell.strip() for cell in row])
            for line, row in enumerate(csv.reader(text.splitlines()), 1)
            if any(cell.strip() for cell in row)
        ]
    except csv.Error as error:
        raise input_error(path, f"is no CSV ({error})", f"write {FORMS}") from error
    header = rows[0][1] if rows else []
    if header not in (["landmark", "vertex"], ["landmark", "x", "y", "z"]):
        raise input_error(f"{path}:1", f"the header is {','.join(header)[:80]!r}", f"write {FORMS}")
    places: dict[str, Place] = {}
    for line, row in rows[1:]:
        place = f"{path}:{line}"
        if len(row) != len(header):
            found = f"has {len(row)} cells for {len(header)} columns"
            raise input_error(place, found, "write one cell per column")
        if row[0] in places:
            raise input_error(place, f"the landmark {row[0]!r} repeats", "keep one of them")
        try:
            values: Any = int(row[1]) if len(row) == 2 else [float(cell) for cell in row[1:]]
        except ValueError as error:
            raise _wrong(place, ",".join(row[1:])) from error
        places[row[0]] = _place(values, place)
    return places


def _place(value: Any, place: str) -> Place:
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    if isinstance(value, list) and len(value) == 3:
        plain = all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
        if plain and np.isfinite(value).all():
            x, y, z = map(float, value)
            return x, y, z
    raise _wrong(place, str(value))


def _wrong(place: str, value: str) -> InputError:
    fix = "give the number of a vertex, from 0, or three coordinates"
    return input_error(place, f"{value[:40]!r} is no place", fix)


METRES = ".glb"
"""Endings of the format whose unit is the metre; the others have none."""


def read_meshes(paths: tuple[Path, ...], *, gaps: bool = False) -> tuple[ShapeSet, tuple[str, ...]]:
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
