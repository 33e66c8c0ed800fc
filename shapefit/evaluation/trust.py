"""What plausibility is worth: the error of the images that are kept without the least plausible."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from shapefit.evaluation.averages import mean
from shapefit.evaluation.summary import ImageErrors

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
    if errors.plausibility is None:
        return []
    values, trust = errors.values[:], errors.plausibility[:]
    both = ~np.isnan(values) & ~np.isnan(trust)
    found = []
    for group, members in grouping.items():
        rows = np.flatnonzero(errors.sequences.among(members) & both)
        if not len(rows):
            continue
        left_out = int(LEAST_TRUSTED * len(rows))
        rising = rows[np.argsort(trust[rows], kind="stable")]
        kept = np.sort(rising[left_out:])
        found.append(
            Kept(
                method=errors.method,
                metric=errors.metric,
                unit=errors.unit,
                group=group,
                images=len(rows),
                mean=mean(values[rows]),
                kept=len(kept),
                mean_kept=mean(values[kept]),
                plausibility=float(trust[rising[left_out]]),
            )
        )
    return found
