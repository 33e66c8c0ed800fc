"""Errors of images, and their means and percentiles over sequences and groups of sequences."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

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
    names = np.array(sequences, dtype=str)
    return {group: np.isin(names, list(members)) for group, members in grouping.items()}


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
    names, codes = np.unique(np.array(sequences, dtype=str), return_inverse=True)
    order = np.argsort(codes, kind="stable")
    starts = np.searchsorted(codes[order], np.arange(1, len(names)))
    for (metric, unit), values in errors.items():
        parts = np.split(values[order], starts)
        rows = {name: _statistics(part) for name, part in zip(names.tolist(), parts, strict=True)}
        for group, members in grouping.items():
            inside = {name: rows[name] for name in members if name in rows and any(rows[name][:2])}
            if not inside:
                continue
            table = np.array(list(inside.values()))
            fitted = table[table[:, 0] > 0, 2:]
            mean = fitted.mean(axis=0) if len(fitted) else np.full(3, np.nan)
            whole = (*table[:, :2].sum(axis=0), *mean)
            for name, (count, failed, *numbers) in ((None, whole), *inside.items()):
                counts = int(count), int(failed)
                yield Summary(method, metric, unit, group, name, *counts, *map(float, numbers))


def _statistics(values: Floats) -> tuple[float, ...]:
    """Return how many errors are finite and nan, and mean, median and 90th percentile of them."""
    finite = np.sort(values[np.isfinite(values)])
    numbers = (np.nan,) * 3
    if n := len(finite):
        places = np.array([0.5, 0.9]) * (n - 1)
        numbers = (finite.mean(), *np.interp(places, np.arange(n), finite))
    return n, int(np.isnan(values).sum()), *numbers
