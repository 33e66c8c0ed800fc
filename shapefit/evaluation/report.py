"""What an evaluation found: all numbers of its tables, before any formatting."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from shapefit.evaluation.averages import Sliced, mean
from shapefit.evaluation.calibration import Coverage, Kept
from shapefit.evaluation.summary import Summary
from shapefit.geometry.normalisation import LARGEST


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


NORMALISED = "normalised"
"""Unit of errors against the truth scaled to unit standard deviation."""

PUBLISHED = ("similarity", NORMALISED)
"""Metric and unit of published numbers."""


@dataclass(frozen=True)
class Method:
    """One method that was judged: where its results lie, how many images, and which failed.

    `failures` maps an item to the reason; `unlisted` images failed, too, beyond those that are
    listed; `solving` sums up how the fit went.
    """

    name: str
    files: tuple[str, ...]
    images: int
    failures: Mapping[str, str]
    solving: Solving = field(default_factory=Solving)
    unlisted: int = 0

    @property
    def failed(self) -> int:
        """Number of images that failed."""
        return len(self.failures) + self.unlisted


@dataclass(frozen=True)
class Report:
    """Everything that the tables show.

    `published` maps a method to its quoted numbers, group -> error, in the metric and unit
    `PUBLISHED`; `caveats` say what to bear in mind when reading the numbers; `warnings` what the
    evaluation had to leave out; `coverage`, `kept` and `without_bars` say how true error bars and
    plausibilities are, and which methods have none; `parallel` are those whose ellipsoids are
    parallel to the axes; `provenance` is what the numbers were made from and by (version,
    config, digests of the inputs), ready for JSON.
    """

    methods: tuple[Method, ...]
    summaries: tuple[Summary, ...]
    published: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    caveats: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    coverage: tuple[Coverage, ...] = ()
    kept: tuple[Kept, ...] = ()
    without_bars: tuple[str, ...] = ()
    parallel: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
