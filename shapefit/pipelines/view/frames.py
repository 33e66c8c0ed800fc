"""The frames of a page: items of all its files, by sequence, thinned where they are too many."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from shapefit.errors import input_error
from shapefit.io.kinds.listing import Listing
from shapefit.pipelines.items import ChosenItems


@dataclass(frozen=True)
class Frames:
    """Items in the order of the page; sequences (name, first frame) cover them all.

    Every `step`-th frame of `count` is here.
    """

    items: tuple[str, ...]
    sequences: tuple[tuple[str, int], ...]
    count: int
    step: int = 1

    @property
    def index(self) -> dict[str, int]:
        """Return the frame of each item."""
        return {item: frame for frame, item in enumerate(self.items)}


def choose_frames(listings: Sequence[Listing], patterns: Sequence[str]) -> Frames:
    """Return the items that the patterns choose, in order, those of a sequence together.

    Sequences of one frame each are no sequences. Raises InputError where nothing is left.
    """
    chosen = ChosenItems("items", patterns)
    sequence_of: dict[str, str] = {}
    for listing in listings:
        sequences = listing.sequences or ("",) * len(listing.items)
        for item, sequence in zip(listing.items, sequences, strict=True):
            if patterns == ("*",) or item in chosen:
                sequence_of.setdefault(item, sequence)
    if not sequence_of:
        places = ", ".join(str(listing.path) for listing in listings)
        if any(listing.items for listing in listings):
            raise input_error("items", f"no item of {places} fits", "correct the names or globs")
        raise input_error(places, "holds no images", "check the run that wrote it")
    groups: dict[str, list[str]] = {}
    for item, sequence in sequence_of.items():
        groups.setdefault(sequence, []).append(item)
    if len(groups) == len(sequence_of):
        groups = {"": list(sequence_of)}
    return _frames(groups, len(sequence_of))


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
    return replace(_frames(groups, frames.count), step=step)


def _frames(groups: dict[str, list[str]], count: int) -> Frames:
    items: list[str] = []
    sequences = []
    for name, members in groups.items():
        sequences.append((name, len(items)))
        items += members
    return Frames(tuple(items), tuple(sequences), count)
