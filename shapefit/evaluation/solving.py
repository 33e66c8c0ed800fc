"""How the fit of a method went: objective, time and success, summed up over its images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.convex.solution import Status
from shapefit.evaluation.averages import Sliced, mean
from shapefit.geometry.normalisation import LARGEST

SOLVED = (Status.OPTIMAL.value, Status.CONVERGED.value)
"""Words of the images that the method finished within its tolerance."""


@dataclass(frozen=True)
class Run:
    """What the result files of a method say about the fit of n images, None where one says nothing.

    objective (n), nan where an image failed; solved, how many are optimal or converged; seconds for
    all images.
    """

    images: int
    objective: Sliced | None = None
    solved: int | None = None
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


def count_solved(status: NDArray[Any]) -> int:
    """Count the images that are optimal or converged, by their words."""
    return int(np.isin(np.asarray(status, dtype=str), SOLVED).sum())


def sum_up(run: Run) -> Solving:
    """Sum up a method; each image weighs the same."""
    return Solving(
        mean_objective=None if run.objective is None else _mean(run.objective),
        milliseconds=None if run.seconds is None else 1000 * run.seconds / run.images,
        solved=None if run.solved is None else run.solved / run.images,
    )


def _mean(objective: Sliced) -> float | None:
    """Mean of the objectives that are known."""
    values = objective[:]
    known = values[np.abs(values) <= LARGEST]
    return mean(known) if len(known) else None
