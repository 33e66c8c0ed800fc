"""`view`: results, shapes and landmarks as one HTML page that turns and plays, or as a sheet."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from shapefit.config import ViewConfig
from shapefit.errors import input_error, listed
from shapefit.io.atomic import atomic_path, check_output
from shapefit.io.inputs import is_stream
from shapefit.pipelines.outcome import Outcome
from shapefit.pipelines.view.reading import read_inputs
from shapefit.pipelines.view.scene import assemble
from shapefit.viewer.page import viewer_page
from shapefit.viewer.scene import Scene

PAGES, SHEETS = ("", ".html", ".htm"), (".png", ".svg")
"""Endings of the names of a page, and of a sheet of pictures."""


def run(config: ViewConfig) -> Iterator[Outcome]:
    """Write the page, or a sheet of pictures; yields one Outcome with what is missing as warnings.

    Raises InputError for files that cannot be read or shown together, and where the page cannot be
    written.
    """
    output = config.output
    if output is None:
        output = Path.cwd() / f"{next(iter(config.files.values()))[0].stem}.html"
    if is_stream(output):
        problem = "a page is not written to a terminal"
        raise input_error("output", problem, "give the name of a file")
    if output.suffix.lower() not in PAGES + SHEETS:
        problem = f"is a page or a sheet of pictures, and its name ends in {output.suffix}"
        raise input_error(output, problem, f"end it in {listed(PAGES[1:] + SHEETS)}")
    check_output(output)
    if output.suffix.lower() in SHEETS:
        from shapefit.pipelines.view.sheet import write_sheet

        yield write_sheet(config, output)
        return
    page, scene = make_page(config)
    with atomic_path(output) as temporary:
        temporary.write_bytes(page)
    size = f"{len(page) / 1e6:.1f} MB"
    yield Outcome(done=len(scene.items), warnings=scene.notes, note=size, written=(output,))


@np.errstate(over="ignore", invalid="ignore")  # beyond 32-bit floats a value is not finite: missing
def make_page(config: ViewConfig) -> tuple[bytes, Scene]:
    """Return the page in UTF-8 and its scene."""
    scene = assemble(config, read_inputs(config))
    return viewer_page(scene).encode("utf-8", "xmlcharrefreplace"), scene
