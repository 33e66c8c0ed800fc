"""Rows of a report that no fit made: what the dictionary leaves of the truth at best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.config.commands.evaluate import BEST_COMBINATION, MEAN_SHAPE, NEAREST_ATOM
from shapefit.dictionary.model import Dictionary
from shapefit.errors import abbreviate, input_error
from shapefit.evaluation.floors import best_combination, nearest_atom
from shapefit.evaluation.metrics import similarity
from shapefit.evaluation.summary import ImageErrors
from shapefit.io import read_dictionary
from shapefit.io.records import ResultSet, ShapeSet, match_landmarks
from shapefit.pipelines.evaluate.common_landmarks import common_landmarks
from shapefit.pipelines.evaluate.judgement import Judgement
from shapefit.pipelines.evaluate.measurement import in_both_units
from shapefit.pipelines.items import named_items

Floats = NDArray[np.float64]

METRIC = "similarity"
KEY = "floors.leave_out"


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


@dataclass(frozen=True)
class Shown:
    """What an image shows: the row of its true shape, and the training shape to leave out."""

    sequence: str
    row: int
    left_out: str | None


def shown_in(results: ResultSet, judgement: Judgement, leave_out: str | None) -> dict[str, Shown]:
    """Return item -> what it shows, for the images with a truth; raises as `named_items`."""
    left_out: Sequence[str | None] = (None,) * len(results)
    if leave_out is not None:
        left_out = named_items(results.items, results.extras, leave_out, judgement.file, KEY)
    rows = judgement.truth_rows.tolist()
    images = zip(judgement.items, judgement.sequences, rows, left_out, strict=True)
    return {item: Shown(sequence, row, out) for item, sequence, row, out in images if row >= 0}


def floor_errors(file: Path, truth: ShapeSet, images: Mapping[str, Shown]) -> list[ImageErrors]:
    """Errors of each of `FLOORS`, with the dictionary of a file, for the images (item -> shown).

    They are over the landmarks that dictionary and truth share. Raises InputError where these are
    fewer than three, and where the atoms of the shapes to leave out are unknown or all there are.
    """
    dictionary = read_dictionary(file)
    names = common_landmarks(file, dictionary.landmark_names, truth.landmark_names)
    dictionary = _of_landmarks(dictionary, names)
    _check_left_out(file, dictionary, [shown.left_out for shown in images.values()])
    # Many images show one shape, which is measured once.
    shapes = dict.fromkeys((shown.row, shown.left_out) for shown in images.values())
    columns = match_landmarks(truth.landmark_names, names)
    true = truth.shapes[[row for row, _ in shapes]][..., columns]
    if np.isnan(true).any():
        found = "the truth lacks landmarks (NaN), and the nearest atoms need all"
        raise input_error("floors", found, "drop `floors`, or give the shapes that are complete")
    errors = _errors(true, [left_out for _, left_out in shapes], dictionary)
    place = {shape: index for index, shape in enumerate(shapes)}
    of_image = [place[shown.row, shown.left_out] for shown in images.values()]
    sequences = tuple(shown.sequence for shown in images.values())
    return [
        ImageErrors(name, METRIC, unit, tuple(images), sequences, values[of_image])
        for name, error in errors.items()
        for (_, unit), values in in_both_units(METRIC, error, true, true, truth.unit).items()
    ]


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


def _of_landmarks(dictionary: Dictionary, names: tuple[str, ...]) -> Dictionary:
    """Return the dictionary of some of its landmarks."""
    columns = match_landmarks(dictionary.landmark_names, names)
    return replace(
        dictionary,
        atoms=dictionary.atoms[..., columns],
        mean_shape=dictionary.mean_shape[:, columns],
        landmark_names=names,
    )


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
