"""Per-image errors summed up over sequences and groups of sequences: numbers, no formatting."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ALL = "all"
"""Name of the one group, and of the one sequence, where none are named."""


@dataclass(frozen=True)
class ImageErrors:
    """Errors of one method in one metric and unit, one per image; nan = failed.

    items and sequences (n), values (n,).
    """

    method: str
    metric: str
    unit: str
    items: tuple[str, ...]
    sequences: tuple[str, ...]
    values: Floats


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
    names, codes = np.unique(np.array(errors.sequences, dtype=object), return_inverse=True)
    starts = np.searchsorted(np.sort(codes), np.arange(1, len(names)))
    values = np.split(errors.values[np.argsort(codes, kind="stable")], starts)
    by_sequence = dict(zip(names, values, strict=True))
    summaries = []
    for group, members in grouping.items():
        rows = [_sequence(errors, group, s, by_sequence[s]) for s in members if s in by_sequence]
        if rows:
            summaries += [_group(errors, group, rows), *rows]
    return summaries


def _sequence(errors: ImageErrors, group: str, sequence: str, values: Floats) -> Summary:
    known = values[~np.isnan(values)]
    statistics = (
        (known.mean(), np.median(known), np.percentile(known, 90))
        if len(known)
        else (np.nan, np.nan, np.nan)
    )
    counts = (len(known), len(values) - len(known))
    labels = (errors.method, errors.metric, errors.unit, group, sequence)
    return Summary(*labels, *counts, *map(float, statistics))


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
