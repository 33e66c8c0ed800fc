"""The files of a page, listed, and its frames: their items by sequence, thinned where too many."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from shapefit.config import ViewConfig
from shapefit.errors import InputError, input_error
from shapefit.io.listing import Listing, list_file
from shapefit.io.options import InputOptions
from shapefit.pipelines.items import ChosenItems
from shapefit.pipelines.outcome import Failure, unread

EVERY = ("*",)
"""Patterns that choose all items."""

MOST_LISTED = 1_000_000
"""Images of one name whose items are in memory: ten times what a page can show."""


@dataclass(frozen=True)
class Listed:
    """The listings of each name, with the chosen items; every `step`-th where they are many.

    count   the chosen images of the name that has most of them
    unread  the files that cannot be read, and why; each name has another
    """

    listings: Mapping[str, tuple[Listing, ...]]
    count: int
    step: int = 1
    unread: tuple[Failure, ...] = ()


@dataclass(frozen=True)
class _Part:
    """What is kept of a listing: `rows` of the file."""

    listing: Listing
    rows: NDArray[np.intp]

    def take(self, chosen: NDArray[np.bool_]) -> _Part:
        """Return some of it; the same where that is all."""
        if chosen.all():
            return self
        of = self.listing
        items, sequences = (
            None if names is None else tuple(names[row] for row in np.flatnonzero(chosen))
            for names in (of.items, of.sequences)
        )
        listing = replace(of, items=items or (), sequences=sequences)
        return _Part(listing, self.rows[chosen])

    def every(self, step: int, kept: Collection[str]) -> _Part:
        """Leave out all rows but every `step`-th, and the items that are to be kept."""
        here = np.array([item in kept for item in self.listing.items], dtype=bool)
        return self.take(here | (self.rows % step == 0))


def list_files(config: ViewConfig, options: InputOptions, kept: Collection[str] = ()) -> Listed:
    """List the files of each name; the items `kept` are never left out.

    Raises InputError for a name of which no file can be read, and where no item is chosen.
    """
    chosen = ChosenItems("items", config.items)
    held: dict[str, list[_Part]] = {name: [] for name in config.files}
    found, counted, step = 0, 0, 1
    failures: list[Failure] = []
    for name, files in config.files.items():
        own = 0
        lost: list[str] = []
        for file in files:
            try:
                listing = list_file(file, options)
            except InputError as error:
                lost += error.problems
                failures.append(unread(file, error))
                continue
            found += len(listing.items)
            part = _Part(listing, np.arange(len(listing.items)))
            if config.items != EVERY:
                part = part.take(np.array([item in chosen for item in listing.items], dtype=bool))
            own += len(part.rows)
            held[name].append(part.every(step, kept))
            while sum(len(each.rows) for each in held[name]) > max(MOST_LISTED, len(kept)):
                step *= 2
                held = {n: [each.every(step, kept) for each in parts] for n, parts in held.items()}
        if not held[name]:
            raise InputError(lost)
        counted = max(counted, own)
    if not counted:
        places = ", ".join(str(file) for files in config.files.values() for file in files)
        if found:
            raise input_error("items", f"no item of {places} fits", "correct the names or globs")
        raise input_error(places, "holds no images", "check the run that wrote it")
    listings = {n: tuple(each.listing for each in parts) for n, parts in held.items()}
    return Listed(listings, counted, step, tuple(failures))


@dataclass(frozen=True)
class Frames:
    """Items in the order of the page; sequences (name, first frame) cover them all.

    About every `step`-th frame of `count` is here.
    """

    items: tuple[str, ...]
    sequences: tuple[tuple[str, int], ...]
    count: int
    step: int = 1

    @property
    def index(self) -> dict[str, int]:
        """Return the frame of each item."""
        return {item: frame for frame, item in enumerate(self.items)}


def choose_frames(listed: Listed) -> Frames:
    """Return the items of all files, in order, those of a sequence together.

    Sequences of one frame each are no sequences.
    """
    sequence_of: dict[str, str] = {}
    for own in listed.listings.values():
        for listing in own:
            sequences = listing.sequences or ("",) * len(listing.items)
            for item, sequence in zip(listing.items, sequences, strict=True):
                sequence_of.setdefault(item, sequence)
    groups: dict[str, list[str]] = {}
    for item, sequence in sequence_of.items():
        groups.setdefault(sequence, []).append(item)
    if len(groups) == len(sequence_of):
        groups = {"": list(sequence_of)}
    count = max(listed.count, len(sequence_of))
    return replace(_frames(groups, count), step=listed.step)


def thin(frames: Frames, step: int, kept: Collection[str] = ()) -> Frames:
    """Return every `step`-th frame, and those of the items that are to be kept."""
    if step == 1:
        return frames
    starts = [start for _, start in frames.sequences] + [len(frames.items)]
    groups: dict[str, list[str]] = {}
    for (name, start), end in zip(frames.sequences, starts[1:], strict=True):
        here = [f for f in range(start, end) if f % step == 0 or frames.items[f] in kept]
        if here:
            groups[name] = [frames.items[frame] for frame in here]
    return replace(_frames(groups, frames.count), step=step * frames.step)


def _frames(groups: dict[str, list[str]], count: int) -> Frames:
    items: list[str] = []
    sequences = []
    for name, members in groups.items():
        sequences.append((name, len(items)))
        items += members
    return Frames(tuple(items), tuple(sequences), count)
