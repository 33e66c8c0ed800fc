"""Where the landmarks of a mesh are: a CSV or JSON file beside it, of vertices or of points."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from shapefit.errors import InputError, input_error
from shapefit.io.sources import read_whole

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
