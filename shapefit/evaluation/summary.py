"""Per-image errors summed up over sequences and groups of sequences: numbers, no formatting."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Protocol

import numpy as np

from shapefit.arrays import Floats
from shapefit.evaluation.averages import (
    Labels,
    Sliced,
    by_name,
    labels_of,
    mean,
    median,
    percentiles,
)

ALL = "all"
"""Name of the one group, and of the one sequence, where none are named."""


class Names(Protocol):
    """Names (n) that are read by slices: a tuple, or a column in a file."""

    def __len__(self) -> int: ...

    def __getitem__(self, rows: slice, /) -> Sequence[str]: ...


@dataclass(frozen=True)
class ImageErrors:
    """Errors of one method in one metric and unit, one per image; nan = failed.

    items and sequences (n), values (n,), all read by slices, so that they need not be in memory;
    plausibility (n,) where the method has it, nan where it has none of an image.
    """

    method: str
    metric: str
    unit: str
    items: Names
    sequences: Labels
    values: Sliced
    plausibility: Sliced | None = None

    def __post_init__(self) -> None:
        """Take the sequences as a tuple, too."""
        if not isinstance(self.sequences, Labels):
            object.__setattr__(self, "sequences", labels_of(self.sequences))


@dataclass(frozen=True)
class Summary:
    """Errors of one method in one metric and unit over a sequence, or over a group.

    `sequence` is None for a group. `images` counts the images with an error, `failed` those
    without. For a sequence mean, median and 90th percentile are over its images; for a group each
    is the mean of that number over its sequences (those with at least one image). nan where no
    image has an error.
    """

    method: str
    metric: str
    unit: str
    group: str
    sequence: str | None
    images: int
    failed: int
    mean: float
    median: float
    p90: float


def group_sequences(
    groups: Mapping[str, str], sequences: Iterable[str]
) -> dict[str, tuple[str, ...]]:
    """Sequences of each group, by the group's glob; without groups all are in the group `all`.

    Sequences keep their order; one that several globs match is in several groups.
    """
    names = tuple(dict.fromkeys(sequences))
    if not groups:
        return {ALL: names}
    return {
        group: tuple(name for name in names if fnmatchcase(name, glob))
        for group, glob in groups.items()
    }


def summarise(errors: ImageErrors, grouping: Mapping[str, Sequence[str]]) -> list[Summary]:
    """Sum up one set of errors: each group followed by its sequences.

    A sequence or group of which the errors have no image at all is left out.
    """
    by_sequence = {
        name: _sequence(errors, name, count, known)
        for name, count, known in by_name(errors.values, errors.sequences)
    }
    summaries = []
    for group, members in grouping.items():
        rows = [replace(by_sequence[s], group=group) for s in members if s in by_sequence]
        if rows:
            summaries += [_group(errors, group, rows), *rows]
    return summaries


def _sequence(errors: ImageErrors, sequence: str, count: int, known: Floats) -> Summary:
    """Sum up a sequence of so many images; its group is not known yet."""
    labels = (errors.method, errors.metric, errors.unit, "", sequence)
    counts = (len(known), count - len(known))
    return Summary(*labels, *counts, mean(known), median(known), *percentiles(known, (90,)))


def _group(errors: ImageErrors, group: str, rows: Sequence[Summary]) -> Summary:
    known = [row for row in rows if row.images]
    statistics = (
        np.mean([(row.mean, row.median, row.p90) for row in known], axis=0)
        if known
        else (np.nan, np.nan, np.nan)
    )
    counts = (sum(row.images for row in rows), sum(row.failed for row in rows))
    labels = (errors.method, errors.metric, errors.unit, group, None)
    return Summary(*labels, *counts, *map(float, statistics))
