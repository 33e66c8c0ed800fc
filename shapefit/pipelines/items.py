"""Items by name: the true shape of each image, and the items that a config chooses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats, Indices
from shapefit.errors import input_error
from shapefit.records.fit import Fit
from shapefit.records.items import Items
from shapefit.records.names import as_composed

BY_ITEM = "item"
"""Stands for the items of the images themselves."""

BY_FRAME = "frame"
"""Stands for the frames of the images."""

SAME_FRAME_WITHIN = 0.01
"""Frames of two rates are of one time where they are so near."""


class MatchKeys(NamedTuple):
    """Items, sequences, frames and times by which n images find their true shapes.

    Without frames the places in the sequences count; times (n,) in seconds, as stated.
    """

    items: Sequence[str]
    sequences: Sequence[str] | None = None
    frames: Sequence[int] | None = None
    frame_rate: float | None = None
    times: Sequence[float] | None = None

    def seconds(self) -> Floats | None:
        """Return the time (n,) of each item in seconds, None where it is unknown."""
        if self.times is not None:
            return np.array(self.times, np.float64)
        if self.frames is None or not self.frame_rate:
            return None
        seconds: Floats = np.array(self.frames, np.float64) / self.frame_rate
        return seconds

    def by_frame(self) -> tuple[Sequence[str], Sequence[int]]:
        """Return the sequence (n,) and the frame number (n,) of each item."""
        sequences = self.sequences or ("",) * len(self.items)
        if self.frames is not None:
            return sequences, self.frames
        length = Counter[str]()
        frames = []
        for name in sequences:
            frames.append(length[name])
            length[name] += 1
        return sequences, frames


def join_match_keys(parts: Iterable[Items]) -> MatchKeys:
    """Return items, sequences, frames and times of a source, joined over its parts."""
    items: list[str] = []
    sequences: list[str] = []
    frames: list[int] = []
    times: list[float] = []
    for part in parts:
        items += part.items
        sequences += part.sequences or ()
        if part.frames is not None:
            frames += part.frames.tolist()
        if part.times is not None:
            times += part.times.tolist()
    are_numbered = len(frames) == len(items)
    are_timed = len(times) == len(items) and bool(np.isfinite(times).all())
    return MatchKeys(
        items,
        sequences or None,
        frames if are_numbered else None,
        part.frame_rate,
        times if are_timed else None,
    )


def find_truth(
    place: str | Path, match: str, images: MatchKeys, truth: MatchKeys
) -> Indices:
    """Return the row (n,) of the true shape of each image, -1 where it has none.

    By item or by frame and sequence: of the same name, else of one that ends alike
    (`cam01/anna` and `anna`), else of any, as long as that is one. Raises InputError
    at `place` where no image has one.
    """
    if match == BY_FRAME:
        rows = find_truth_by_frame(images, truth)
    else:
        rows = find_rows(images.items, truth.items)
    if (rows < 0).all() and match == BY_FRAME:
        fault = (
            f"none of its {len(rows)} images is of a frame and sequence of the truth"
        )
        fix = "give the truth of these images, or name the sequences alike"
        if images.sequences and truth.sequences:
            fix += f" ('{images.sequences[0]}' here, '{truth.sequences[0]}' there)"
        raise input_error(place, fault, fix)
    if (rows < 0).all():
        fault = (
            f"none of its {len(rows)} images is in the truth, which has no"
            f" '{images.items[0]}'"
        )
        fix = (
            "give the truth of these images, or set `match`: to `frame` where both are"
            " the frames of one recording, or to a dataset that names such items as"
            f" '{truth.items[0]}'"
        )
        raise input_error(place, fault, fix)
    return rows


def find_rows(wanted: Iterable[object], keys: Iterable[object]) -> Indices:
    """Return the position in `keys` (n,) of each wanted key, -1 where it is absent."""
    row = {_composed(key): number for number, key in enumerate(keys)}
    return np.array([row.get(_composed(key), -1) for key in wanted], dtype=np.intp)


def _composed(key: object) -> object:
    """Return a name in Unicode's composed form, and another key unchanged."""
    return as_composed(key) if isinstance(key, str) else key


def find_truth_by_frame(images: MatchKeys, truth: MatchKeys) -> Indices:
    """Return the row (n,) of each image's true shape, by sequence and frame, else -1.

    Where this finds none at all, the last parts of the sequences' names are compared,
    then frames alone. Frames of different rates are those of the same time. Where a
    side states times, which need not begin at 0, those of both count first.
    """
    sequences, frames = images.by_frame()
    true_sequences, true_frames = truth.by_frame()
    in_time = frames_on_one_clock(images, truth)
    if in_time is not None:
        rows = _find_in_sequences(sequences, in_time[0], true_sequences, in_time[1])
        if (rows >= 0).any():
            return rows
    if images.frame_rate and truth.frame_rate:
        places = np.array(frames) * (truth.frame_rate / images.frame_rate)
        whole = places.round()
        is_whole = abs(places - whole) < SAME_FRAME_WITHIN
        frames = np.where(is_whole, whole, -1).tolist()
    return _find_in_sequences(sequences, frames, true_sequences, true_frames)


def frames_on_one_clock(
    images: MatchKeys, truth: MatchKeys
) -> tuple[Sequence[int], Sequence[int]] | None:
    """Return the times of images and of truth as frames of one rate, from 0 s on.

    None where neither states times, or one has neither times nor numbered frames.
    """
    rate = truth.frame_rate or images.frame_rate
    seconds = images.seconds()
    true_seconds = truth.seconds()
    is_stated = images.times is not None or truth.times is not None
    if not is_stated or not rate or seconds is None or true_seconds is None:
        return None
    frames = np.rint(seconds * rate).astype(np.int64)
    true_frames = np.rint(true_seconds * rate).astype(np.int64)
    return frames.tolist(), true_frames.tolist()


def _find_in_sequences(
    sequences: Sequence[str],
    frames: Sequence[int],
    true_sequences: Sequence[str],
    true_frames: Sequence[int],
) -> Indices:
    """Return the row (n,) of the true shape of the same sequence and frame, else -1."""
    for shorten in (str, _last_part, _nothing):
        keys = list(zip(map(shorten, true_sequences), true_frames, strict=True))
        rows = find_rows(zip(map(shorten, sequences), frames, strict=True), keys)
        is_unambiguous = len(set(keys)) == len(keys)
        if is_unambiguous and (rows >= 0).any():
            return rows
    return np.full(len(frames), -1)


def _last_part(name: str) -> str:
    """Return what follows the last slash: `anna` of `cam01/anna`."""
    return name.rpartition("/")[2]


def _nothing(_: str) -> str:
    """Return "" for any name, so that all sequences count as one."""
    return ""


def names_in_dataset(
    images: Items, dataset: str, place: str | Path, key: str
) -> tuple[str, ...]:
    """Return the name (n,) that a dataset of images holds for each of them.

    BY_ITEM stands for the items. Raises InputError at `place` where there is no such
    dataset; its message names the config's `key`.
    """
    if dataset == BY_ITEM:
        return tuple(images.items)
    named = {name: v for name, v in images.extras.items() if v.ndim == 1}
    if isinstance(images, Fit) and images.omitted is not None:
        named["omitted"] = images.omitted
    if dataset not in named:
        texts = sorted(
            name for name, values in named.items() if values.dtype.kind in "OSU"
        )
        fix = f"set `{key}` to one of: {', '.join([BY_ITEM, *texts])}"
        raise input_error(
            place, f"there is no dataset '{dataset}' with one name per image", fix
        )
    return tuple(map(str, named[dataset]))


class ChosenItems:
    """The items that a config key chooses by patterns: names or globs."""

    def __init__(self, key: str, patterns: Sequence[str]) -> None:
        self._key = key
        self._is_used = dict.fromkeys(patterns, False)

    def __contains__(self, item: str) -> bool:
        """Whether the item is chosen: `a[1]` chooses a[1] and a1."""
        matching = [
            pattern
            for pattern in self._is_used
            if pattern == item or fnmatchcase(item, pattern)
        ]
        for pattern in matching:
            self._is_used[pattern] = True
        return bool(matching)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return a warning for each pattern that has chosen no item so far."""
        return tuple(
            f"{self._key}: no item has this name or matches '{pattern}'"
            for pattern, is_used in self._is_used.items()
            if not is_used
        )


def subsample(wanted: int, count: int) -> tuple[int, ...]:
    """Return at most `wanted` indices, spread evenly over 0 to count - 1."""
    parts = min(wanted, count)
    return tuple((2 * part + 1) * count // (2 * parts) for part in range(parts))
