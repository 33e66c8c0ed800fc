"""Files written and read as a whole, as most tests do."""

import re
from pathlib import Path
from typing import Any

from shapefit.io import (
    open_landmarks,
    open_shapes,
    read_dictionary,
    read_results,
    read_shapes,
)
from shapefit.io.formats import record_writer
from shapefit.io.layout import LAYOUT_OF
from shapefit.io.options import OutputOptions, Summary
from shapefit.io.skeletons import Skeleton
from shapefit.records import Fit, Items, Landmarks, Shapes


def save(path: Path, *records: Items, to: str = "auto", **options: Any) -> Summary:
    """Write records of one kind one after the other; options are those of files in
    metres.
    """
    form = LAYOUT_OF[type(records[0])]
    with record_writer(path, form, to, OutputOptions(**options)) as writer:
        for record in records:
            writer.append(record)
    return writer.summary


def load(*paths: Path) -> Landmarks:
    """Return the landmarks in files."""
    with open_landmarks(paths) as source:
        return source.whole()


def load_shapes(path: Path) -> tuple[Shapes, tuple[str, ...]]:
    """Return the shapes in a file, which may have gaps, and the warnings."""
    with open_shapes([path], gaps=True) as source:
        return source.whole(), source.notes


def read_shape_file(path: Path) -> Shapes:
    """Return the shapes in one file."""
    return read_shapes([path])


def read_result_with_proofs(path: Path) -> Fit:
    """Return a result with what proves its objectives."""
    return read_results(path, proofs=True)


READERS = {
    "landmarks": load,
    "shapes": read_shape_file,
    "results": read_result_with_proofs,
    "dictionary": read_dictionary,
}
"""Kind of file -> what reads it."""


def mirror_pairs(skeleton: Skeleton) -> tuple[tuple[int, int], ...]:
    """Return right and left landmarks that a reflection of the body exchanges, each
    pair once.
    """
    place = {name: number for number, name in enumerate(skeleton.landmark_names)}
    pairs = []
    for number, name in enumerate(place):
        left = re.sub(r"^R(?=[A-Z])", "L", name.replace("right", "left"))
        partner = place.get(left, number)
        if partner != number:
            pairs.append((number, partner))
    return tuple(pairs)
