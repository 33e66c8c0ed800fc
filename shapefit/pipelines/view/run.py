"""`view`: results, shapes and landmarks as one HTML page that turns and plays."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from shapefit.config import ViewConfig
from shapefit.errors import input_error, listed
from shapefit.io.listing import Listing
from shapefit.io.options import input_options
from shapefit.io.sources import is_stream
from shapefit.io.whole.atomic import atomic_path, check_output
from shapefit.pipelines.outcome import Failure, Outcome
from shapefit.pipelines.view.assembly import MEGABYTES, assemble
from shapefit.pipelines.view.frames import Frames, choose_frames, list_files, thin
from shapefit.viewer.page import viewer_page
from shapefit.viewer.scene import Scene

PAGES = ("", ".html", ".htm")
"""Endings of the name of a page."""

MEGABYTE = 1_000_000
CODE_BYTES = 60_000
"""Size of a page without frames, about."""
MEASURES_BYTES = 5
"""A frame's relative gap, reprojection and status."""
ROUNDS = 4
"""Most pages that are made until one is small enough."""


def run(config: ViewConfig) -> Iterator[Outcome]:
    """Write the page; yields one Outcome with what the page lacks as warnings.

    Files that cannot be read are failures where their name has others. Raises InputError where it
    has none, for files that cannot be shown together, and where the page cannot be written.
    """
    output = check_page(config)
    page = make_page(config)
    with atomic_path(output) as temporary:
        temporary.write_bytes(page.html)
    yield Outcome(
        done=len(page.scene.items),
        failures=page.unread,
        warnings=tuple(page.scene.notes),
        note=f"{len(page.html) / MEGABYTE:.1f} MB",
        written=(output,),
    )


def check_page(config: ViewConfig) -> Path:
    """Return the file to write; raises InputError where it cannot be written."""
    output = config.output
    if output is None:
        first = next(iter(config.files.values()))[0]
        output = Path.cwd() / f"{first.stem}.html"
    if is_stream(output):
        raise input_error(
            "output", "a page is not written to a terminal", "give the name of a file"
        )
    if output.suffix.lower() not in PAGES:
        found = f"is a page of HTML, and its name ends in {output.suffix}"
        raise input_error(output, found, f"end it in {listed(PAGES[1:])}")
    check_output(output)
    return output


@dataclass(frozen=True)
class Page:
    """The page in UTF-8, what it shows, and the files that cannot be read."""

    html: bytes
    scene: Scene
    unread: tuple[Failure, ...]


@np.errstate(over="ignore", invalid="ignore")  # beyond 32-bit floats a value is not finite: missing
def make_page(config: ViewConfig, kept: Collection[str] = ()) -> Page:
    """Return the page; the items `kept` are never left out."""
    options = replace(input_options(config.input), rename={})  # which is for the truth
    listed = list_files(config, options, kept)
    every = [listing for own in listed.listings.values() for listing in own]
    whole = choose_frames(listed)
    most = MEGABYTES * MEGABYTE
    step = math.ceil(_least_bytes(whole, every) / (most - CODE_BYTES)) or 1
    for _ in range(ROUNDS):
        frames = thin(whole, step, kept)
        scene = assemble(config, listed.listings, frames)
        page = Page(viewer_page(scene).encode("utf-8", "xmlcharrefreplace"), scene, listed.unread)
        if len(page.html) <= most or len(frames.items) <= max(1, len(kept)):
            break
        step = math.ceil(step * 1.02 * len(page.html) / most)
    return page


def _least_bytes(frames: Frames, listings: list[Listing]) -> float:
    """Bytes of points, measures and names in base64, without what only some files have."""
    solid = [one for one in listings if one.kind != "landmarks"]
    points = sum(6 * len(one.items) * len(one.landmark_names) for one in solid)
    seen = [one for one in listings if "landmarks" in one.datasets or one.kind == "landmarks"]
    points += max((4 * len(one.items) * len(one.landmark_names) for one in seen), default=0)
    measures = MEASURES_BYTES * sum(len(one.items) for one in solid)
    chosen = len(frames.items) / max(len(one.items) for one in listings)
    names = sum(len(item) + len('"",') for item in frames.items)
    return 4 / 3 * (points + measures) * min(1.0, chosen) + names
