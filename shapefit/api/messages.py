"""What the functions of `import shapefit` tell: warnings, and errors of arrays without
names.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence

from shapefit.errors import InputError, input_error, listed
from shapefit.io.skeletons import skeletons_of_size
from shapefit.pipelines.result import Note
from shapefit.records import Landmarks, Record


def warn(messages: Iterable[object], level: int = 3) -> None:
    """Issue a Python warning for each message, at the caller of the function; notes are
    none.
    """
    for message in messages:
        if not isinstance(message, Note):
            warnings.warn(str(message), stacklevel=level)


def with_names(record: Record, names: Sequence[str]) -> Record:
    """Return a record with names of its items, and these names of its landmarks.

    Names of its own stay. Raises InputError where `names` are too few or too many.
    """
    p = record.points.shape[1]
    if not record.landmark_names and len(names) != p:
        raise unnamed(record.POINTS, p, names)
    return record.named(names)


def unnamed(dataset: str, p: int, names: Sequence[str]) -> InputError:
    """Return the InputError for p landmarks without names, not as many as `names`."""
    skeletons = skeletons_of_size(p) if dataset == Landmarks.POINTS else ()
    fix = f"name them: {dataset.title()}({dataset}, landmark_names=[...])"
    if skeletons:
        fix = f"name them, as in {listed(f'`keypoints={name}`' for name in skeletons)}"
    return input_error(
        dataset, f"has {p} landmarks without names, not {len(names)}", fix
    )
