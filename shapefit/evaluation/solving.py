"""How the fit of a method went: objective, time and success, summed up over its images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.solution import Status
from shapefit.geometry.normalisation import LARGEST

Floats = NDArray[np.float64]

SOLVED = (Status.OPTIMAL.value, Status.CONVERGED.value)
"""Words of the images that the method finished within its tolerance."""


@dataclass(frozen=True)
class Run:
    """What one result file says about the fit of its n images, None where it says nothing.

    objective (n), nan where an image failed; status (n) of texts; seconds for all images.
    """

    images: int
    objective: Floats | None = None
    status: NDArray[Any] | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class Solving:
    """How one method solved its images; None where not all of its files say it.

    Mean objective over the images that have one, milliseconds per image, and the share of images
    that are optimal or converged.
    """

    mean_objective: float | None = None
    milliseconds: float | None = None
    solved: float | None = None

    @property
    def images_per_second(self) -> float | None:
        """Return 1000 / milliseconds; None where that is unknown or too short to measure."""
        return 1000 / self.milliseconds if self.milliseconds else None


def sum_up(runs: Sequence[Run]) -> Solving:
    """Sum up the files of one method; each image weighs the same."""
    images = sum(run.images for run in runs)
    objectives = [run.objective for run in runs if run.objective is not None]
    statuses = [run.status for run in runs if run.status is not None]
    seconds = [run.seconds for run in runs if run.seconds is not None]
    known = np.concatenate(objectives) if len(objectives) == len(runs) else np.empty(0)
    known = known[np.abs(known) <= LARGEST]
    solved = [np.isin(np.asarray(status, dtype=str), SOLVED).sum() for status in statuses]
    return Solving(
        mean_objective=float(known.mean()) if len(known) else None,
        milliseconds=1000 * sum(seconds) / images if len(seconds) == len(runs) else None,
        solved=float(sum(solved) / images) if len(statuses) == len(runs) else None,
    )
