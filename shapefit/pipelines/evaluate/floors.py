"""Rows of a report that no fit made: what the dictionary leaves of the truth at best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.config.commands.evaluate import (
    BEST_COMBINATION,
    MEAN_SHAPE,
    NEAREST_ATOM,
    FloorsConfig,
)
from shapefit.dictionary.model import Dictionary
from shapefit.errors import abbreviate, input_error
from shapefit.evaluation.averages import Coder, Labels
from shapefit.evaluation.floors import best_combination, nearest_atom
from shapefit.evaluation.metrics import similarity, truth_scale
from shapefit.evaluation.summary import ImageErrors
from shapefit.io import read_dictionary
from shapefit.io.columns import Column, Texts
from shapefit.io.landmark_names import match_landmarks
from shapefit.io.name_index import NameIndex
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.pipelines.evaluate.judgement import Judgement, common_landmarks
from shapefit.pipelines.evaluate.measurement import in_both_units
from shapefit.pipelines.items import named_items

METRIC = "similarity"
KEY = "floors.leave_out"

TOGETHER = 1 << 15
"""Images that are measured together."""


def _mean_shape(true: Floats, dictionary: Dictionary) -> Floats:
    return similarity(np.broadcast_to(dictionary.mean_shape, true.shape), true)


def _nearest_atom(true: Floats, dictionary: Dictionary) -> Floats:
    return nearest_atom(true, dictionary.atoms)


def _best_combination(true: Floats, dictionary: Dictionary) -> Floats:
    return similarity(best_combination(true, dictionary.atoms), true)


FLOORS: Mapping[str, Callable[[Floats, Dictionary], Floats]] = {
    MEAN_SHAPE: _mean_shape,
    NEAREST_ATOM: _nearest_atom,
    BEST_COMBINATION: _best_combination,
}
"""Name of a row -> its errors (n,) for true shapes (n, 3, p) and a dictionary of p landmarks."""


class Floors:
    """Errors of each of `FLOORS`, with a dictionary, of the images that have a truth.

    They are over the landmarks that dictionary and truth share. An image is measured once, however
    many methods have it. Some thousand are measured together, wherever files end and begin.
    """

    def __init__(self, config: FloorsConfig, head: ShapeSet, folder: Path | None) -> None:
        """Take the head of the truth. Raises InputError where few landmarks are shared."""
        self._leave_out = config.leave_out
        self._file = config.dictionary
        dictionary = read_dictionary(config.dictionary)
        names = common_landmarks(self._file, dictionary.landmark_names, head.landmark_names)
        self._dictionary = dictionary.of_landmarks(names)
        self._columns = match_landmarks(head.landmark_names, names)
        self._unit = head.unit
        self._waiting = _Waiting()
        self._left_out: dict[str | None, None] = {}
        self._items, self._coder, self._codes = Texts(folder), Coder(), Column(folder, np.int32)
        self._errors: dict[tuple[str, str, str], Column] = {}
        self._of_others = NameIndex.of([])
        self._folder = folder

    def begin_method(self) -> None:
        """Go on with another method: the images so far are not measured again."""
        self._flush()
        self._of_others = NameIndex.of(self._items.blocks())

    def add(self, results: ResultSet, judgement: Judgement, truth: ShapeSet) -> None:
        """Add the images of a file. Raises as `named_items` and `errors`."""
        left_out: Sequence[str | None] = (None,) * len(results)
        if self._leave_out is not None:
            left_out = named_items(results, self._leave_out, judgement.file, KEY)
        known = self._of_others.find(judgement.items) >= 0
        for image in np.flatnonzero((judgement.truth_rows >= 0) & ~known).tolist():
            row = judgement.truth_rows[image]
            self._left_out[left_out[image]] = None
            self._waiting.add(
                judgement.items[image],
                judgement.sequences[image],
                (truth.items[row], left_out[image]),
                truth.shapes[row][:, self._columns],
            )
            if len(self._waiting.items) == TOGETHER:
                self._flush()

    def errors(self) -> list[ImageErrors]:
        """Return the errors of each of `FLOORS`.

        Raises InputError where the truth lacks landmarks, and where the atoms of the shapes to
        leave out are unknown or all there are.
        """
        self._flush()
        labels = Labels(self._coder.names, self._codes)
        return [
            ImageErrors(name, metric, unit, self._items, labels, values)
            for (name, metric, unit), values in self._errors.items()
        ]

    def _flush(self) -> None:
        """Measure the images that wait; many images show one shape, which is measured once."""
        waiting, self._waiting = self._waiting, _Waiting()
        if not waiting.items:
            return
        _check_left_out(self._file, self._dictionary, list(self._left_out))
        true = np.stack(waiting.shapes)
        if np.isnan(true).any():
            found = "the truth lacks landmarks (NaN), and the nearest atoms need all"
            fix = "drop `floors`, or give the shapes that are complete"
            raise input_error("floors", found, fix)
        left_out = [left_out for _, left_out in waiting.places]
        scale = truth_scale(true, true)
        for name, error in _errors(true, left_out, self._dictionary).items():
            both = in_both_units(METRIC, error, scale, self._unit)
            for (metric, unit), values in both.items():
                column = self._errors.setdefault(
                    (name, metric, unit), Column(self._folder, np.float64)
                )
                column.append(values[waiting.of_image])
        self._items.append(waiting.items)
        self._codes.append(self._coder(waiting.sequences))


@dataclass
class _Waiting:
    """Images to be measured together, and the different shapes that they show.

    places: what a shape is called, and the training shape to leave out for it -> its place in
    `shapes`, (3, p) each; of_image: the place of each image's.
    """

    items: list[str] = field(default_factory=list)
    sequences: list[str] = field(default_factory=list)
    of_image: list[int] = field(default_factory=list)
    places: dict[tuple[str, str | None], int] = field(default_factory=dict)
    shapes: list[Floats] = field(default_factory=list)

    def add(self, item: str, sequence: str, shown: tuple[str, str | None], shape: Floats) -> None:
        """Add an image."""
        if shown not in self.places:
            self.places[shown] = len(self.shapes)
            self.shapes.append(shape)
        self.items.append(item)
        self.sequences.append(sequence)
        self.of_image.append(self.places[shown])


def _errors(
    true: Floats, left_out: Sequence[str | None], dictionary: Dictionary
) -> dict[str, Floats]:
    """Errors (n,) of each floor for true shapes (n, 3, p), each without its own training shape."""
    errors = {name: np.full(len(true), np.nan) for name in FLOORS}
    for item in dict.fromkeys(left_out):
        rows = [row for row, other in enumerate(left_out) if other == item]
        known = dictionary if item is None else dictionary.without(item)
        for name, floor in FLOORS.items():
            errors[name][rows] = floor(true[rows], known)
    return errors


def _check_left_out(file: Path, dictionary: Dictionary, left_out: Sequence[str | None]) -> None:
    """Raise InputError unless the shapes to leave out, if any, can be."""
    items = dict.fromkeys(name for name in left_out if name is not None)
    if not items:
        return
    if dictionary.atom_items is None:
        found = "does not state which training shape each atom is"
        raise input_error(file, found, f"learn it with `method: exemplars`, or drop `{KEY}`")
    if not any(item in dictionary.atom_items for item in items):
        found = f"has no atom of {abbreviate(list(items))}; its atoms are of "
        found += abbreviate(dictionary.atom_items)
        raise input_error(file, found, f"name another dataset in `{KEY}`, or drop it")
    for item in items:
        if not dictionary.atoms_without(item).any():
            found = f"has no atom but those of '{item}', which `{KEY}` leaves out"
            raise input_error(file, found, "give a dictionary of more shapes")
