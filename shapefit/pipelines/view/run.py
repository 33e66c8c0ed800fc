"""`view`: results, shapes and landmarks as one HTML page that turns and plays, or as a
sheet.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.config import ViewConfig
from shapefit.errors import input_error, listed
from shapefit.io.atomic import atomic_path, check_output
from shapefit.io.inputs import is_stream
from shapefit.meshes.pictures import (
    FittedImage,
    Model,
    check_can_draw,
    contact_sheet,
    save,
)
from shapefit.pipelines.items import subsample
from shapefit.pipelines.result import Result
from shapefit.pipelines.view.scene import make_scene
from shapefit.viewer.page import viewer_page

PAGES, SHEETS = ("", ".html", ".htm"), (".png", ".svg")
"""Endings of the names of a page, and of a sheet of pictures."""
MOST_IMAGES = 24
"""Images of a sheet, spread evenly over those that are chosen."""


def run(config: ViewConfig) -> Iterator[Result]:
    """Write the page, or a sheet of pictures; yields one Result with what is missing as
    warnings.

    Raises InputError for files that cannot be read or shown together, and where the
    output cannot be written.
    """
    output = config.output
    if output is None:
        output = Path.cwd() / f"{next(iter(config.files.values()))[0].stem}.html"
    if is_stream(output):
        raise input_error(
            "output", "a page is not written to a terminal", "name a file"
        )
    ending = output.suffix.lower()
    if ending not in PAGES + SHEETS:
        problem = (
            f"is a page or a sheet of pictures, and its name ends in {output.suffix}"
        )
        raise input_error(output, problem, f"end it in {listed(PAGES[1:] + SHEETS)}")
    check_output(output)
    if ending in SHEETS:
        check_can_draw("output")
    # Beyond 32-bit floats a value is not finite: missing.
    with np.errstate(over="ignore", invalid="ignore"), atomic_path(output) as temporary:
        scene = make_scene(config)
        count, note = len(scene["items"]), ""
        if ending in SHEETS:
            count = min(MOST_IMAGES, count)
            save(draw_sheet(scene, output), temporary, ending[1:])
        else:
            page = viewer_page(scene).encode("utf-8", "xmlcharrefreplace")
            temporary.write_bytes(page)
            note = f"{len(page) / 1e6:.1f} MB"
    yield Result(
        done=count, warnings=tuple(scene["notes"]), note=note, written=(output,)
    )


def draw_sheet(scene: Mapping[str, Any], output: Path) -> Any:
    """Draw images of one result, with the meshes or edges of the dictionary, as a
    figure.
    """
    if [layer["role"] for layer in scene["layers"]] != ["result"]:
        fix = "give one result of `fit`, or end the name in .html"
        raise input_error(output, "a sheet shows one result", fix)
    faces = scene["meshes"][0]["faces"] if scene["meshes"] else None
    edges = np.asarray(scene["edges"], np.int64).reshape(-1, 2)
    images = [
        fitted_image(scene, row) for row in subsample(MOST_IMAGES, len(scene["items"]))
    ]
    return contact_sheet(
        images, Model("down" if scene["y_down"] else "up", faces, edges)
    )


def fitted_image(scene: Mapping[str, Any], row: int) -> FittedImage:
    """Return one frame of the first layer of a scene; the shape is all nan where the
    fit failed.

    Its mesh is s R sum_j w_j V_j + t, which the camera sees at x f / |z| + c.
    """
    layer, observed, outliers = scene["layers"][0], scene["observed"], scene["outliers"]
    shape, mesh, flat_mesh = layer["points"][row], None, None
    if (
        "blend" in layer
        and layer["blend"]["start"][row] < layer["blend"]["start"][row + 1]
    ):
        chosen, pose = (
            slice(*layer["blend"]["start"][row : row + 2]),
            layer["pose"][row],
        )
        vertices = scene["meshes"][0]["vertices"][layer["blend"]["atom"][chosen]]
        mixed = np.tensordot(layer["blend"]["weight"][chosen], vertices, 1)
        mesh = pose[9] * pose[:9].reshape(3, 3) @ mixed + pose[10:, None]
        f, c = np.split(layer["camera"][row][:, None], 2)
        flat_mesh = (
            f * mesh[:2] / (np.abs(mesh[2]) if layer["perspective"] else 1.0) + c
        )
    return FittedImage(
        title=scene["items"][row],
        landmarks=(
            np.full_like(shape[:2], np.nan) if observed is None else observed[row]
        ),
        shape=shape,
        projected=layer["fitted"][row],
        mesh=mesh,
        projected_mesh=flat_mesh,
        outliers=None if outliers is None else outliers[row],
    )
