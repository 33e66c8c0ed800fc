"""Landmarks from a pipe that stays open: each item as soon as it is complete."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from shapefit.arrays import Integers, split_runs
from shapefit.errors import abbreviate, counted, input_error
from shapefit.io.arrange import arrange
from shapefit.io.csv_file import Table
from shapefit.io.options import InputOptions
from shapefit.io.source import as_pixels, find_pixel_scale, source_of_stream
from shapefit.records.landmarks import Landmarks

STANDARD_INPUT = Path("-")

MAX_REMEMBERED = 1_000_000
"""Items that are known again when they return, in 100 MB of memory: those that came
last.
"""

TOGETHER = "write all rows of an item one after the other, or leave out --live"


class LiveLandmarks:
    """Items of a tidy table that comes through standard input, one after the other.

    An item is complete when all `landmarks` of it have come, the next begins, or the
    input ends. The landmarks of the first item are those of all; `head` is that item
    without its rows, and `count` how many have been given out.
    """

    def __init__(self, options: InputOptions, landmarks: Sequence[str]) -> None:
        """Read the header of standard input; `landmarks` are a dictionary's names.

        Those are names after `options.rename`. Raises InputError for a header that is
        none.
        """
        self._options = options
        self._table = Table(STANDARD_INPUT, "landmarks", live=True)
        of_files = {new: old for old, new in options.rename.items()}
        self._wanted = frozenset(of_files.get(name, name) for name in landmarks)
        self._names: tuple[str, ...] = ()
        self._pixels: tuple[float, float] | None = None
        self._written: dict[int, None] = {}
        self._left_out: dict[str, None] = {}
        self.head: Landmarks | None = None
        self.count = 0

    @property
    def notes(self) -> tuple[str, ...]:
        """A note on landmarks that were left out, () where there are none."""
        if not self._left_out:
            return ()
        names = [*self._left_out]
        text = f"{counted(len(names), 'landmark')} left out, which the first item lacks"
        return (f"{self._table.name}: {text} ({abbreviate(names)})",)

    def items(self) -> Iterator[Landmarks]:
        """Yield each item when it is complete; one empty record if there are no items.

        Raises InputError for wrong cells, an item that returns, and a landmark that the
        first item lacks and the dictionary may have.
        """
        current = ""
        present: set[str] = set()
        for cells in self._table.blocks:
            items, _ = cells.unique_texts("item")
            for rows in split_runs(np.diff(items) != 0, len(items)):
                of_run = cells.select_rows(rows)
                item = of_run.cell("item", 0)
                landmarks = of_run.column_texts("landmark")
                if item != current and self._table.size:
                    yield self._pop_item()
                self._check_landmarks(of_run.lines, landmarks)
                if hash(item) in self._written:
                    if item == current and not self._are_in_first(landmarks):
                        continue
                    fault = f"item '{item}' returns after its shape was written"
                    place = f"{self._table.name}:{of_run.lines[0]}"
                    raise input_error(place, fault, TOGETHER)
                if item != current:
                    current, present = item, set()
                self._table.add(of_run)
                present.update(landmarks)
                if present >= (set(self._names) or self._wanted):
                    yield self._pop_item()
        if self._table.size or not self.count:
            yield self._pop_item()

    def _are_in_first(self, landmarks: Sequence[str]) -> bool:
        """Whether the first item has any of these landmarks."""
        return not set(self._names).isdisjoint(landmarks)

    def _check_landmarks(self, lines: Integers, landmarks: Sequence[str]) -> None:
        """Collect, for `notes`, those of these landmarks that the first item lacks.

        `lines` are their line numbers. Raises InputError where the first item lacks
        landmarks of the dictionary, too.
        """
        if self.head is None or set(self._names).issuperset(landmarks):
            return
        others = [row for row, name in enumerate(landmarks) if name not in self._names]
        if not self._wanted.issubset(self._names):
            fault = f"the first item lacks the landmark '{landmarks[others[0]]}'"
            fix = (
                "list all landmarks in the first item, with empty x and y where they"
                " are hidden"
            )
            raise input_error(f"{self._table.name}:{lines[others[0]]}", fault, fix)
        self._left_out.update(dict.fromkeys(landmarks[row] for row in others))

    def _pop_item(self) -> Landmarks:
        """Remove the complete item from the table; return it with options applied."""
        images = self._table.pop_all()
        assert isinstance(images, Landmarks), "as the table was opened"
        name = self._table.name
        if self.head is None:
            self._names = tuple(images.landmark_names)
            self._pixels = find_pixel_scale(images, self._options, name)
        images = arrange(images, self._names, name, omit=True)
        if self._pixels is not None:
            images = as_pixels(images, self._pixels)
        images = source_of_stream(images, name, self._options).whole()
        if self.head is None:
            self.head = images.take(slice(0, 0))
        if (images.frames is None) != (self.head.frames is None):
            fault = f"item '{images.items[0]}' has a frame, and the first item none"
            fix = "give all items a frame, or leave out the column"
            raise input_error(name, fault, fix)
        self.count += len(images)
        self._remember(images.items)
        return images

    def _remember(self, items: Sequence[str]) -> None:
        """Store hashes of items that are yielded, the last MAX_REMEMBERED of them."""
        self._written.update(dict.fromkeys(map(hash, items)))
        while len(self._written) > MAX_REMEMBERED:
            del self._written[next(iter(self._written))]
