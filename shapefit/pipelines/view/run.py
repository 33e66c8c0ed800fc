"""`view`: results, shapes and landmarks as one HTML page, or as a sheet."""

from __future__ import annotations

import shlex
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shapefit.arrays import Floats
from shapefit.config import ViewConfig
from shapefit.errors import input_error, listed
from shapefit.io.atomic import atomic_path, check_output
from shapefit.io.inputs import is_stream
from shapefit.meshes.pictures import (
    DrawnModel,
    FittedImage,
    PlacedPhotograph,
    check_can_draw,
    contact_sheet,
    save,
)
from shapefit.pipelines.items import subsample
from shapefit.pipelines.result import Result
from shapefit.pipelines.unfinished import describe_unfinished
from shapefit.pipelines.view.film import is_film
from shapefit.pipelines.view.photographs import (
    find_photographs,
    notes_on_missing,
    read_photographs,
)
from shapefit.pipelines.view.scene import make_scene
from shapefit.viewer.page import Layer, Scene, viewer_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE_SUFFIXES = ("", ".html", ".htm")
SHEET_SUFFIXES = (".png", ".svg")

MAX_SHEET_IMAGES = 24
"""Images of a sheet, spread evenly over those that are chosen."""


def write_page(config: ViewConfig) -> Iterator[Result]:
    """Write the page of the config's files, or a sheet of pictures.

    Yields one Result, with what is missing as warnings. Raises InputError for files
    that cannot be read or shown together, and where the output cannot be written.
    """
    output = config.output
    if output is None:
        output = Path.cwd() / f"{next(iter(config.files.values()))[0].stem}.html"
    if is_stream(output):
        raise input_error(
            "output", "a page is not written to a terminal", "name a file"
        )
    ending = output.suffix.lower()
    if ending not in PAGE_SUFFIXES + SHEET_SUFFIXES:
        problem = (
            f"is a page or a sheet of pictures, and its name ends in {output.suffix}"
        )
        endings = listed(PAGE_SUFFIXES[1:] + SHEET_SUFFIXES)
        raise input_error(output, problem, f"end it in {endings}")
    check_output(output)
    if ending in SHEET_SUFFIXES:
        check_can_draw("output")
    note = ""
    # Beyond 32-bit floats a value is not finite: missing.
    with np.errstate(over="ignore", invalid="ignore"), atomic_path(output) as temporary:
        if ending in SHEET_SUFFIXES:
            # Of photographs only those of the sheet are read.
            scene = make_scene(config.changed(images=None))
            rows = subsample(MAX_SHEET_IMAGES, len(scene["items"]))
            notes = [*scene["notes"]]
            photographs = read_sheet_photographs(config, scene, rows, notes)
            sheet = draw_sheet(scene, rows, photographs, output)
            save(sheet, temporary, ending[1:])
            count = len(rows)
        else:
            scene = make_scene(config)
            notes = scene["notes"]
            count = len(scene["items"])
            page = viewer_page(scene).encode("utf-8", "xmlcharrefreplace")
            temporary.write_bytes(page)
            note = f"{len(page) / 1e6:.1f} MB"
    every_file = (file for files in config.files.values() for file in files)
    warnings = (*describe_unfinished(every_file), *notes)
    yield Result(done=count, warnings=warnings, note=note, written=(output,))


def read_sheet_photographs(
    config: ViewConfig, scene: Scene, rows: Sequence[int], notes: list[str]
) -> dict[int, PlacedPhotograph]:
    """Return row -> photograph of some rows of a scene; faults go to the notes.

    Raises InputError for a film, whose frames nobody decodes here, and as
    `read_photographs`.
    """
    if config.images is None:
        return {}
    if is_film(config.images):
        film = shlex.quote(str(config.images))
        fault = "is a film, and a sheet shows photographs"
        line = f"mkdir frames; ffmpeg -i {film} -fps_mode passthrough frames/%06d.jpg"
        fix = f"make them by `{line}`, and give `--images frames`"
        raise input_error(config.images, fault, fix)
    items = [scene["items"][row] for row in rows]
    paths = find_photographs(config.images, items)
    notes += notes_on_missing(config.images, len(items), len(paths))
    of_rows = {rows[number]: path for number, path in paths.items()}
    return dict(read_photographs(of_rows, scene["image"], notes))


def draw_sheet(
    scene: Scene,
    rows: Sequence[int],
    photographs: Mapping[int, PlacedPhotograph],
    output: Path,
) -> Figure:
    """Draw some images of one result with the meshes or edges of its dictionary.

    Raises InputError for a scene of anything else.
    """
    if [layer["role"] for layer in scene["layers"]] != ["result"]:
        fix = "give one result of `fit`, or end the name in .html"
        raise input_error(output, "a sheet shows one result", fix)
    model = DrawnModel(
        y_axis="down" if scene["y_down"] else "up",
        faces=scene["meshes"][0]["faces"] if scene["meshes"] else None,
        edges=np.asarray(scene["edges"], np.int64).reshape(-1, 2),
        sides=scene["sides"],
    )
    images = [
        fitted_image(scene, row)._replace(photograph=photographs.get(row))
        for row in rows
    ]
    return contact_sheet(images, model)


def fitted_image(scene: Scene, row: int) -> FittedImage:
    """Return one frame of the first layer of a scene as an image of a sheet.

    The shape is all nan where the fit failed.
    """
    layer = scene["layers"][0]
    shape = layer["points"][row]
    landmarks = np.full_like(shape[:2], np.nan)
    if scene["observed"] is not None:
        landmarks = scene["observed"][row]
    mesh = _mixed_mesh(scene, layer, row)
    outliers = scene["outliers"]
    reasons = layer.get("reasons")
    doubt = "" if reasons is None else reasons["words"][reasons["codes"][row]]
    pose = layer["pose"]
    upright = None
    if scene["rigid"] and pose is not None and np.isfinite(pose[row]).all():
        upright = pose[row, :9].reshape(3, 3).T
    return FittedImage(
        title=scene["items"][row],
        landmarks=landmarks,
        shape=shape,
        projected=layer["fitted"][row],
        mesh=mesh,
        projected_mesh=None if mesh is None else _project_by_camera(mesh, layer, row),
        outliers=None if outliers is None else outliers[row],
        doubt=doubt,
        upright=upright,
        individual=_name_individual(scene, row),
    )


def _name_individual(scene: Scene, row: int) -> tuple[str, int]:
    """Return the name and number of an individual of several, ("", 0) for one alone."""
    starts = [start for _, start in scene["sequences"]]
    sequence = bisect_right(starts, row) - 1
    for members in scene["recordings"]:
        if sequence in members and len(members) > 1:
            name = scene["sequences"][sequence][0].rpartition("/")[2]
            return name, members.index(sequence)
    return "", 0


def _mixed_mesh(scene: Scene, layer: Layer, row: int) -> Floats | None:
    """Return the mesh (3, q) of one frame, s R sum_j w_j V_j + t; None without any."""
    pose = layer["pose"]
    if "blend" not in layer or pose is None:
        return None
    blend = layer["blend"]
    start, stop = blend["start"][row : row + 2]
    if start == stop:
        return None
    vertices = scene["meshes"][0]["vertices"][blend["atom"][start:stop]]
    mixed = np.tensordot(blend["weight"][start:stop], vertices, 1)
    R = pose[row, :9].reshape(3, 3)
    scale = pose[row, 9]
    translation = pose[row, 10:, None]
    mesh: Floats = scale * R @ mixed + translation
    return mesh


def _project_by_camera(points: Floats, layer: Layer, row: int) -> Floats:
    """Project points (3, q) of one frame to the image: x f / |z| + c, or x f + c."""
    camera = layer["camera"]
    assert camera is not None
    f, c = np.split(camera[row][:, None], 2)
    depth = np.abs(points[2]) if layer["perspective"] else 1.0
    return np.asarray(f * points[:2] / depth + c)
