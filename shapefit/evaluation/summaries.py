"""Errors of images, and their means and percentiles over sequences and groups of sequences."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.errors import abbreviate, input_error

ALL = "all"
"""Name of the one group, and of the one sequence, where none are named."""

NORMALISED = "normalised"
"""Unit of errors against the truth scaled to unit standard deviation."""

Kind = tuple[str, str]
"""A metric and its unit."""


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
) -> tuple[dict[str, tuple[str, ...]], list[str]]:
    """Sequences of each group (name -> glob), and warnings about what matches nothing.

    Without groups all are in the group `all`. Sequences keep their order; one that several globs
    match is in several groups. Raises InputError where no sequence is in any group.
    """
    names = tuple(dict.fromkeys(filter(None, sequences)))
    if not groups:
        return {ALL: names}, []
    grouping = {
        group: tuple(name for name in names if fnmatchcase(name, glob))
        for group, glob in groups.items()
    }
    if not any(grouping.values()):
        found = f"no sequence matches any group; the sequences are {abbreviate(list(names))}"
        raise input_error("groups", found, "correct the globs, or leave `groups` out")
    warnings = [
        f"group {group}: no sequence matches {groups[group]!r}"
        for group, members in grouping.items()
        if not members
    ]
    grouped = {member for members in grouping.values() for member in members}
    if outside := [name for name in names if name not in grouped]:
        warnings.append(f"sequences in no group, only in per_image.csv: {abbreviate(outside)}")
    return grouping, warnings


def members_of(sequences: Sequence[str], grouping: Mapping[str, Sequence[str]]) -> dict[str, Flags]:
    """Return which of n images, of these sequences (n,), are in each group (n,)."""
    names, codes = codes_of(sequences)
    return {group: np.isin(names, list(members))[codes] for group, members in grouping.items()}


def codes_of(names: Sequence[str]) -> tuple[list[str], NDArray[np.intp]]:
    """Return each name once, in order of appearance, and the place of each of n among them."""
    places = {name: place for place, name in enumerate(dict.fromkeys(names))}
    return [*places], np.fromiter(map(places.__getitem__, names), np.intp, len(names))


def summarise(
    method: str,
    sequences: Sequence[str],
    errors: Mapping[Kind, Floats],
    grouping: Mapping[str, Sequence[str]],
) -> Iterator[Summary]:
    """Sum up errors (n,) by metric and unit: each group followed by its sequences (n,).

    nan is a failed image; an infinite error does not count. A sequence or group without an image
    that counts is left out.
    """
    names, codes = codes_of(sequences)
    for (metric, unit), values in errors.items():
        rows = dict(zip(names, statistics_of(values, codes, len(names)).tolist(), strict=True))
        for group, members in grouping.items():
            inside = {name: rows[name] for name in members if name in rows and any(rows[name][:2])}
            if not inside:
                continue
            table = np.array(list(inside.values()))
            fitted = table[table[:, 0] > 0, 2:]
            mean = fitted.mean(axis=0) if len(fitted) else np.full(3, np.nan)
            whole = [*table[:, :2].sum(axis=0), *mean]
            for name, row in ((None, whole), *inside.items()):
                count, failed, *numbers = map(float, row)
                yield Summary(method, metric, unit, group, name, int(count), int(failed), *numbers)


def statistics_of(values: Floats, codes: NDArray[np.intp], count: int) -> Floats:
    """Return (count, 5) of values (n,) by their codes: known, nan, mean, median, 90th percentile.

    Infinite values do not count.
    """
    failed = np.bincount(codes[np.isnan(values)], minlength=count)
    fine = np.isfinite(values)
    values, codes = values[fine], codes[fine]
    order = np.lexsort((values, codes))
    values, sizes = values[order], np.bincount(codes, minlength=count)
    starts = np.cumsum(sizes) - sizes
    table = np.full((count, 5), np.nan)
    table[:, 0], table[:, 1] = sizes, failed
    some = np.flatnonzero(sizes)
    if len(some):
        table[some, 2] = np.add.reduceat(values, starts[some]) / sizes[some]
        for column, share in ((3, 0.5), (4, 0.9)):
            place = starts[some] + share * (sizes[some] - 1)
            low = np.floor(place).astype(np.intp)
            high = np.ceil(place).astype(np.intp)
            table[some, column] = values[low] + (place - low) * (values[high] - values[low])
    return table
