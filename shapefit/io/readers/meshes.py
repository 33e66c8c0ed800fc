"""Meshes (OBJ, PLY, GLB) as shapes: each is one, and a file beside it says where landmarks are."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.errors import input_error
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.names import match_landmarks
from shapefit.io.readers.detections import read_json
from shapefit.io.readers.recording import UnexpectedError, at, check_names, expect
from shapefit.io.readers.text_table import Table
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

    with at(path, "give a whole OBJ, PLY or GLB file"):
        try:
            mesh = trimesh.load(path, force="mesh", process=False, maintain_order=True)
            vertices = np.asarray(mesh.vertices, dtype=np.float64)
            faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
        except Exception as error:  # trimesh has many kinds of error for damaged files
            raise UnexpectedError(f"cannot be read as a mesh ({error})") from error
        expect(vertices.ndim == 2 and len(vertices), "has no vertices")
        expect(vertices.shape[1] == 3, f"has vertices of {vertices.shape[1]} coordinates, not 3")
        expect(np.isfinite(vertices).all(), "has a vertex that is not finite")
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
    with at(path, f"write {FORMS}"):
        if path.suffix == ".json":
            places: Places = {name: _place(name, value) for name, value in read_json(path).items()}
        else:
            places = _of_csv(path)
        expect(places, "names no landmarks")
    return places


def _of_csv(path: Path) -> Places:
    table = Table(path)
    ((line, header),) = table.first_rows(1) or [(1, [])]
    header = [cell.strip() for cell in header]
    known = header in (["landmark", "vertex"], ["landmark", "x", "y", "z"])
    expect(known, f"the header is {','.join(header)[:80]!r}")
    table.skip(line, header)
    values, (names,), _ = table.read(range(1, len(header)), [0], finite=True, empty=False)
    check_names(names, "landmark")
    rows = (own if len(own) == 3 else own[0] for own in values.tolist())
    return {name: _place(name, place) for name, place in zip(names, rows, strict=True)}


def _place(name: str, value: Any) -> Place:
    """Return the number of a vertex, from 0, or three coordinates."""
    if type(value) in (int, float) and value == int(value):
        return int(value)
    plain = isinstance(value, list) and all(type(x) in (int, float) for x in value)
    point = plain and len(value) == 3 and np.isfinite(value).all()
    expect(point, f"{name!r} is at {str(value)[:40]}: neither a vertex nor three coordinates")
    return tuple(map(float, value))


def _find_landmarks(path: Path, vertices: Floats, places: Places, names: tuple[str, ...]) -> Floats:
    """Return the landmarks (p, 3) of a mesh. Raises InputError for other names than these."""
    match_landmarks(tuple(places), names, f"{path}: landmarks")
    match_landmarks(names, tuple(places), f"{path}: landmarks")
    with at(path, "count vertices from 0, in the order of the file"):
        for name, place in places.items():
            there = not isinstance(place, int) or 0 <= place < len(vertices)
            expect(there, f"the landmark {name!r} is vertex {place} of {len(vertices)} vertices")
    found = [
        vertices[place] if isinstance(place, int) else place for place in map(places.get, names)
    ]
    return np.array(found, dtype=np.float64)
