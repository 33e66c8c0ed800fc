"""What an evaluation found: all numbers of its tables, before any formatting."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from shapefit.evaluation.calibration import Coverage
from shapefit.evaluation.solving import Solving
from shapefit.evaluation.summary import Summary
from shapefit.evaluation.trust import Kept

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
