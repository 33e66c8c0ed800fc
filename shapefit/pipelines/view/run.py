"""`view`: results, shapes and landmarks as one HTML page that turns and plays."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from shapefit.config import ViewConfig
from shapefit.errors import InputError, input_error, listed
from shapefit.io.atomic import atomic_path, check_output
from shapefit.io.inputs import is_stream
from shapefit.io.listing import Listing, list_file
from shapefit.io.options import InputOptions, input_options
from shapefit.pipelines.items import ChosenItems
from shapefit.pipelines.outcome import Failure, Outcome, unread
from shapefit.pipelines.view.images import MEGABYTES
from shapefit.pipelines.view.reading import Frames
from shapefit.pipelines.view.scene import assemble
from shapefit.viewer.page import viewer_page
from shapefit.viewer.scene import Scene

PAGES = ("", ".html", ".htm")
"""Endings of the name of a page."""
SHEETS = (".png", ".svg")
"""Endings of the name of a sheet of pictures."""
EVERY = ("*",)
"""Patterns that choose all items."""
MEGABYTE = 1_000_000
CODE_BYTES = 60_000
"""Size of a page without frames, about."""
MEASURES_BYTES = 9
"""A frame's relative gap, reprojection and status."""
ROUNDS = 4
"""Most pages that are made until one is small enough."""

Listings = dict[str, tuple[Listing, ...]]
"""The files of each name on the page."""


def run(config: ViewConfig) -> Iterator[Outcome]:
    """Write the page; yields one Outcome with what the page lacks as warnings.

    Files that cannot be read are failures where their name has others. Raises InputError where it
    has none, for files that cannot be shown together, and where the page cannot be written.
    """
    output = config.output
    if output is None:
        first = next(iter(config.files.values()))[0]
        output = Path.cwd() / f"{first.stem}.html"
    if is_stream(output):
        found = "a page is not written to a terminal"
        raise input_error("output", found, "give the name of a file")
    if output.suffix.lower() not in PAGES + SHEETS:
        found = f"is a page or a sheet of pictures, and its name ends in {output.suffix}"
        raise input_error(output, found, f"end it in {listed(PAGES[1:] + SHEETS)}")
    check_output(output)
    if output.suffix.lower() in SHEETS:
        from shapefit.pipelines.view.sheet import write_sheet

        yield write_sheet(config, output)
        return
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


@dataclass(frozen=True)
class Page:
    """The page in UTF-8, what it shows, and the files that cannot be read."""

    html: bytes
    scene: Scene
    unread: tuple[Failure, ...]


@np.errstate(over="ignore", invalid="ignore")  # beyond 32-bit floats a value is not finite: missing
def make_page(config: ViewConfig, kept: Collection[str] = ()) -> Page:
    """Return the page, of every n-th frame where all are too many; `kept` are never left out."""
    options = replace(input_options(config), rename={})  # which is for the truth
    listings, failures = _list_files(config, options)
    whole = _choose_frames(config, listings)
    most = MEGABYTES * MEGABYTE
    step = math.ceil(_least_bytes(whole, listings) / (most - CODE_BYTES)) or 1
    for _ in range(ROUNDS):
        frames = _thin(whole, step, kept)
        scene = assemble(config, listings, frames)
        page = Page(viewer_page(scene).encode("utf-8", "xmlcharrefreplace"), scene, failures)
        if len(page.html) <= most or len(frames.items) <= max(1, len(kept)):
            break
        step = math.ceil(step * 1.02 * len(page.html) / most)
    return page


def _list_files(config: ViewConfig, options: InputOptions) -> tuple[Listings, tuple[Failure, ...]]:
    """List the files of each name. Raises InputError for a name of which none can be read."""
    listings: Listings = {}
    failures: list[Failure] = []
    for name, files in config.files.items():
        found: list[Listing] = []
        lost: list[str] = []
        for file in files:
            try:
                found.append(list_file(file, options))
            except InputError as error:
                lost += error.problems
                failures.append(unread(file, error))
        if not found:
            raise InputError(lost)
        listings[name] = tuple(found)
    return listings, tuple(failures)


def _choose_frames(config: ViewConfig, listings: Listings) -> Frames:
    """Return the chosen items of all files, in order, those of a sequence together.

    Sequences of one frame each are no sequences. Raises InputError where no item is chosen.
    """
    chosen = ChosenItems("items", config.items)
    every = [listing for own in listings.values() for listing in own]
    sequence_of: dict[str, str] = {}
    for listing in every:
        sequences = listing.sequences or ("",) * len(listing.items)
        for item, sequence in zip(listing.items, sequences, strict=True):
            if config.items == EVERY or item in chosen:
                sequence_of.setdefault(item, sequence)
    if not sequence_of:
        places = ", ".join(str(listing.path) for listing in every)
        if any(listing.items for listing in every):
            raise input_error("items", f"no item of {places} fits", "correct the names or globs")
        raise input_error(places, "holds no images", "check the run that wrote it")
    groups: dict[str, list[str]] = {}
    for item, sequence in sequence_of.items():
        groups.setdefault(sequence, []).append(item)
    if len(groups) == len(sequence_of):
        groups = {"": list(sequence_of)}
    return Frames.of(groups, len(sequence_of))


def _thin(frames: Frames, step: int, kept: Collection[str]) -> Frames:
    """Return every `step`-th frame, and those of the items that are to be kept."""
    starts = [start for _, start in frames.sequences] + [len(frames.items)]
    groups: dict[str, list[str]] = {}
    for (name, start), end in zip(frames.sequences, starts[1:], strict=True):
        here = [f for f in range(start, end) if (f - start) % step == 0 or frames.items[f] in kept]
        groups[name] = [frames.items[frame] for frame in here]
    return Frames.of(groups, frames.count, step)


def _least_bytes(frames: Frames, listings: Listings) -> float:
    """Bytes of points, measures and names in base64, without what only some files have."""
    every = [listing for own in listings.values() for listing in own]
    solid = [one for one in every if one.kind != "landmarks"]
    points = sum(len(one.items) * (6 * len(one.landmark_names) + 16) for one in solid)
    seen = [one for one in every if "landmarks" in one.datasets or one.kind == "landmarks"]
    points += max((4 * len(one.items) * len(one.landmark_names) for one in seen), default=0)
    measures = MEASURES_BYTES * sum(len(one.items) for one in solid)
    chosen = len(frames.items) / max(len(one.items) for one in every)
    names = sum(len(item) + len('"",') for item in frames.items)
    return 4 / 3 * (points + measures) * min(1.0, chosen) + names
