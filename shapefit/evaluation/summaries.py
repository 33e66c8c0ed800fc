"""Errors of images, and their means and percentiles over sequences and groups of sequences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, input_error

ALL = "all"
"""Name of the one group, and of the one sequence, where none are named."""

NORMALISED = "normalised"
"""Unit of errors against the truth scaled to unit standard deviation."""

Kind = tuple[str, str]
"""A metric and its unit."""


@dataclass(frozen=True)
class Labels:
    """Names of n values: each name once, and codes (n,), the place of each value's among them."""

    names: tuple[str, ...]
    codes: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.codes)

    def among(self, names: Iterable[str]) -> NDArray[np.bool_]:
        """Whether the name of each value (n,) is one of these."""
        wanted = frozenset(names)
        return np.array([name in wanted for name in self.names], dtype=np.bool_)[self.codes]


def labels_of(names: Sequence[str]) -> Labels:
    """Return names as labels, in order of first appearance."""
    places = {name: place for place, name in enumerate(dict.fromkeys(names))}
    codes = np.fromiter(map(places.__getitem__, names), np.int32, len(names))
    return Labels(tuple(places), codes)


@dataclass(frozen=True)
class ImageErrors:
    """Errors of one method in one metric and unit, one per image; nan = failed.

    items, sequences and values (n).
    """

    method: str
    metric: str
    unit: str
    items: Sequence[str]
    sequences: Labels
    values: Floats

    def __post_init__(self) -> None:
        """Take the sequences as a tuple of names, too."""
        if not isinstance(self.sequences, Labels):
            object.__setattr__(self, "sequences", labels_of(self.sequences))

    @property
    def kind(self) -> Kind:
        """The metric and its unit."""
        return self.metric, self.unit

    def take(self, rows: NDArray[np.intp]) -> ImageErrors:
        """Return the errors of these images."""
        return replace(
            self,
            items=[self.items[row] for row in rows.tolist()],
            sequences=Labels(self.sequences.names, self.sequences.codes[rows]),
            values=self.values[rows],
        )


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
    outside = [name for name in names if name not in grouped]
    if outside:
        warnings.append(f"sequences in no group, only in per_image.csv: {abbreviate(outside)}")
    return grouping, warnings


def of_sequences(errors: ImageErrors) -> dict[str, Floats]:
    """Return the errors of each sequence that has any, in the order of the images."""
    codes, names = errors.sequences.codes, errors.sequences.names
    sizes = np.bincount(codes, minlength=len(names))
    ordered = np.split(errors.values[np.argsort(codes, kind="stable")], np.cumsum(sizes)[:-1])
    return {name: own for name, own in zip(names, ordered, strict=True) if len(own)}


def summarise(errors: ImageErrors, grouping: Mapping[str, Sequence[str]]) -> list[Summary]:
    """Sum up one set of errors: each group followed by its sequences.

    A sequence or group of which the errors have no image at all is left out.
    """
    of_sequence = {name: _sum_up(errors, name, own) for name, own in of_sequences(errors).items()}
    summaries = []
    for group, members in grouping.items():
        rows = [replace(of_sequence[s], group=group) for s in members if s in of_sequence]
        if rows:
            summaries += [_mean_of_sequences(rows), *rows]
    return summaries


def _sum_up(errors: ImageErrors, sequence: str, values: Floats) -> Summary:
    """Sum up the errors of a sequence; its group is not known yet."""
    known = without_nan(values)
    labels = (errors.method, errors.metric, errors.unit, "", sequence)
    statistics = (np.nan,) * 3
    if len(known):
        statistics = (known.mean(), np.median(known), np.percentile(known, 90))
    return Summary(*labels, len(known), len(values) - len(known), *map(float, statistics))


def _mean_of_sequences(rows: Sequence[Summary]) -> Summary:
    known = [(row.mean, row.median, row.p90) for row in rows if row.images]
    mean, median, p90 = np.mean(known, axis=0).tolist() if known else (np.nan,) * 3
    images, failed = sum(row.images for row in rows), sum(row.failed for row in rows)
    whole = replace(rows[0], sequence=None, images=images, failed=failed)
    return replace(whole, mean=mean, median=median, p90=p90)


def without_nan(values: Floats) -> Floats:
    """Return the values that are not nan, in their order."""
    return values[~np.isnan(values)]
