"""Pipelines that yield what they have done, run to their ends."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import Generic, TypeVar

from shapefit.api.messages import show_progress
from shapefit.pipelines.result import Result

Made = TypeVar("Made")


class _Run(Generic[Made]):
    """Iterates over a generator, and then has its return value as `made`."""

    def __init__(self, steps: Generator[Result, None, Made]) -> None:
        self._steps = steps
        self.made: Made

    def __iter__(self) -> Iterator[Result]:
        self.made = yield from self._steps


def run_to_end(
    steps: Generator[Result, None, Made], *, progress: bool = False, unit: str = "step"
) -> tuple[Made, list[Result]]:
    """Run a generator to its end; return what it returns, and all that it yields.

    With `progress` a bar shows how far it is, in this unit.
    """
    run = _Run(steps)
    shown = show_progress(run, lambda result: result, wanted=progress, unit=unit)
    results = list(shown)
    return run.made, results
