"""Items by name: the true shape of each image, and the items that a config chooses."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import count
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io.layout import FRAME
from shapefit.io.records import Records

BY_ITEM, BY_FRAME = "item", "frame"
"""Stand for the items of the images themselves, and for their frames."""

NEAR = 0.01
"""Frames of two rates are of one time where they are so near."""


@dataclass(frozen=True)
class Keys:
    """What n images or true shapes are matched by: items, sequences and frames (n).

    Where frames are None they are the places in the sequences; all are one sequence by default.
    """

    items: Sequence[str]
    sequences: Sequence[str] | None = None
    frames: Sequence[int] | None = None
    frame_rate: float | None = None

    def by_frame(self) -> tuple[Sequence[str], Sequence[int]]:
        """Return the sequence and the number of the frame of each."""
        sequences = self.sequences or ("",) * len(self.items)
        if self.frames is not None:
            return sequences, self.frames
        reached = defaultdict[str, Iterator[int]](count)
        return sequences, [next(reached[name]) for name in sequences]


def keys_of(parts: Iterable[Records]) -> Keys:
    """Return the keys of records, of one source, that come part by part."""
    items, sequences, frames = list[str](), list[str](), list[int]()
    for part in parts:
        items += part.items
        sequences += part.sequences or ()
        numbers = part.per_item.get(FRAME)
        if numbers is not None and numbers.ndim == 1 and numbers.dtype.kind in "iu":
            frames += numbers.tolist()
    numbered = len(frames) == len(items)
    return Keys(items, sequences or None, frames if numbered else None, part.frame_rate)


def find_truth(place: str | Path, match: str, own: Keys, truth: Keys) -> NDArray[np.intp]:
    """Return the true shape (n,) of each image, -1 where there is none.

    By item, of which an image may name another one, or by frame (or its time, where the rates of
    both differ), and sequence: of the same name, else of one that ends alike (`cam01/anna` and
    `anna`), else of any, as long as that is one. Raises InputError at `place` where no image has a
    true shape.
    """
    if match != BY_FRAME:
        known = {item: row for row, item in enumerate(truth.items)}
        rows = np.array([known.get(item, -1) for item in own.items], dtype=np.intp)
    else:
        rows = _by_frame(own, truth)
    if not (rows < 0).all():
        return rows
    found = f"none of its {len(rows)} images is in the truth, which has no '{own.items[0]}'"
    fix = "give the truth of these images, or set `match`: to `frame` where both are the frames of "
    fix += f"one recording, or to a dataset that names such items as '{truth.items[0]}'"
    if match == BY_FRAME:
        found = f"no frame of its {len(rows)} images is in the truth, or there in two sequences"
        fix = "give the truth of these images, of one sequence or of those of the same names"
    raise input_error(place, found, fix)


def _by_frame(own: Keys, truth: Keys) -> NDArray[np.intp]:
    (sequences, frames), (true_sequences, true_frames) = own.by_frame(), truth.by_frame()
    if own.frame_rate and truth.frame_rate:
        times = np.array(frames) * (truth.frame_rate / own.frame_rate)
        frames = np.where(abs(times - times.round()) < NEAR, times.round(), -1).astype(int).tolist()
    for ending in (str, lambda name: name.rpartition("/")[2], lambda _: ""):
        names = zip(map(ending, true_sequences), true_frames, strict=True)
        known = {name: row for row, name in enumerate(names)}
        wanted = zip(map(ending, sequences), frames, strict=True)
        rows = np.array([known.get(name, -1) for name in wanted], dtype=np.intp)
        if len(known) == len(truth.items) and (rows >= 0).any():
            return rows
    return np.full(len(frames), -1)


def named_items(
    images: Records,
    dataset: str,
    place: str | Path,
    key: str,
) -> tuple[str, ...]:
    """Return what a dataset of the images names, one per image; BY_ITEM names the items.

    `key` of the config chose the dataset. Raises InputError at `place` where they have no
    such dataset with one name per image.
    """
    if dataset == BY_ITEM:
        return images.items
    per_item = {name: images.per_item.get(name) for name in images.further}
    named = {name: v for name, v in per_item.items() if v is not None and v.ndim == 1}
    if dataset not in named:
        found = f"there is no dataset '{dataset}' with one name per image"
        texts = (name for name, values in named.items() if values.dtype.kind in "OSU")
        others = ", ".join([BY_ITEM, *sorted(texts)])
        raise input_error(place, found, f"set `{key}` to one of: {others}")
    return tuple(map(str, named[dataset]))


def matches(item: str, pattern: str) -> bool:
    """Whether an item is called `pattern` or matches it as a glob: `a[1]` matches a[1] and a1."""
    return pattern == item or fnmatchcase(item, pattern)


class ChosenItems:
    """The items that a config key chooses: those that match one of its patterns."""

    def __init__(self, key: str, patterns: Sequence[str]) -> None:
        self._key = key
        self._patterns = tuple(patterns)
        self._used: set[str] = set()

    def __contains__(self, item: str) -> bool:
        """Whether the item is chosen."""
        matching = [pattern for pattern in self._patterns if matches(item, pattern)]
        self._used.update(matching)
        return bool(matching)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What chose none of the items asked for so far."""
        unused = [pattern for pattern in self._patterns if pattern not in self._used]
        return tuple(f"{self._key}: no item has this name or matches '{p}'" for p in unused)


def subsample(wanted: int, count: int) -> tuple[int, ...]:
    """Return the middle of each of as many equal parts of 0..count - 1 as wanted."""
    parts = min(wanted, count)
    return tuple((2 * part + 1) * count // (2 * parts) for part in range(parts))
