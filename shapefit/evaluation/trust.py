"""What plausibility is worth: the error of the images that are kept without the least plausible."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from shapefit.evaluation.statistics.samples import Floats, Sample, in_order, mean, slices
from shapefit.evaluation.summary import ImageErrors

Pairs = Callable[[], Iterator[tuple[Floats, Floats]]]
"""Reads errors and plausibilities of images anew, block by block."""

LEAST_TRUSTED = 0.1
"""Share of the images of a group that is left out, the least plausible ones."""


@dataclass(frozen=True)
class Kept:
    """Mean error over the images of a group, and over those that are kept.

    Every image has the same weight. `plausibility` is the least that was kept.
    """

    method: str
    metric: str
    unit: str
    group: str
    images: int
    mean: float
    kept: int
    mean_kept: float
    plausibility: float


def keep_trusted(errors: ImageErrors, grouping: Mapping[str, Sequence[str]]) -> list[Kept]:
    """Leave out the least plausible tenth of each group, rounded down; ties by order of images.

    Images without an error or a plausibility do not count, nor do groups without any other.
    """
    found = []
    for group, members in grouping.items():
        read = partial(_pairs, errors, errors.sequences.among(members))
        count = sum(len(values) for values, _ in read())
        if not count:
            continue
        every = Sample(count, partial(_column, read, 0))
        trust = Sample(count, partial(_column, read, 1))
        left_out = int(LEAST_TRUSTED * count)
        (least,) = in_order(trust, [left_out]).tolist()
        ties = left_out - sum(int((block < least).sum()) for block in trust.blocks())
        kept = Sample(count - left_out, partial(_kept, read, least, ties))
        found.append(
            Kept(
                method=errors.method,
                metric=errors.metric,
                unit=errors.unit,
                group=group,
                images=count,
                mean=mean(every),
                kept=kept.count,
                mean_kept=mean(kept),
                plausibility=least,
            )
        )
    return found


def _pairs(errors: ImageErrors, wanted: NDArray[np.bool_]) -> Iterator[tuple[Floats, Floats]]:
    """Error and plausibility of the images of the wanted sequences that have both."""
    if errors.plausibility is None:
        return
    for rows in slices(len(errors.values)):
        values, trust = errors.values[rows], errors.plausibility[rows]
        known = wanted[errors.sequences.codes[rows]] & ~np.isnan(values) & ~np.isnan(trust)
        yield values[known], trust[known]


def _column(read: Pairs, number: int) -> Iterator[Floats]:
    """Only errors, or only plausibilities."""
    return (pair[number] for pair in read())


def _kept(read: Pairs, least: float, ties: int) -> Iterator[Floats]:
    """Errors of the images from a plausibility on, but for the first so many that have just it."""
    for values, trust in read():
        equal = np.flatnonzero(trust == least)
        kept = trust >= least
        kept[equal[:ties]] = False
        ties -= min(ties, len(equal))
        yield values[kept]
