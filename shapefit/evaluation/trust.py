"""What plausibility is worth: the error of the images that are kept without the least plausible."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

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


def keep_trusted(
    errors: ImageErrors, plausibility: Mapping[str, float], grouping: Mapping[str, Sequence[str]]
) -> list[Kept]:
    """Leave out the least plausible tenth of each group, rounded down; ties by order of images.

    plausibility of an image by its item. Images without an error or a plausibility do not count,
    nor do groups without any other.
    """
    trust = np.array([plausibility.get(item, np.nan) for item in errors.items])
    known = ~np.isnan(errors.values) & ~np.isnan(trust)
    sequences = np.array(errors.sequences, dtype=str)
    found = []
    for group, members in grouping.items():
        rows = np.flatnonzero(known & np.isin(sequences, np.array(members, dtype=str)))
        if not len(rows):
            continue
        order = rows[np.argsort(trust[rows], kind="stable")]
        kept = order[int(LEAST_TRUSTED * len(order)) :]
        found.append(
            Kept(
                method=errors.method,
                metric=errors.metric,
                unit=errors.unit,
                group=group,
                images=len(order),
                mean=float(errors.values[order].mean()),
                kept=len(kept),
                mean_kept=float(errors.values[kept].mean()),
                plausibility=float(trust[kept[0]]),
            )
        )
    return found
