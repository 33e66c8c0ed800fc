"""The frames of a page: items of all its files, by sequence, thinned where they are too many."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from shapefit.pipelines.view.files import Listed


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
