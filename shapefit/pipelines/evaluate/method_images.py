"""All images of one method, gathered file by file: their names and errors, on disk when many."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.convex.solution import Status
from shapefit.errors import input_error, path_text
from shapefit.evaluation.averages import Coder, Labels
from shapefit.evaluation.calibration import INSIDE
from shapefit.evaluation.metric_table import SHARE
from shapefit.evaluation.report import Method, Run, sum_up
from shapefit.evaluation.summary import ImageErrors
from shapefit.io.columns import Column, Texts
from shapefit.io.name_index import find_equal_names
from shapefit.io.records import ResultSet
from shapefit.pipelines.evaluate.judgement import Judgement, rows_judged
from shapefit.pipelines.evaluate.measurement import Kind

SOLVED = (Status.OPTIMAL.value, Status.CONVERGED.value)
"""Words of the images that the method finished within its tolerance."""

MOST_LISTED = 10_000
"""Failed images of a method that are listed with their reasons; more are counted."""


@dataclass(frozen=True)
class Picked:
    """Some rows (ascending, in a column of their own) of a column, read by slices like it."""

    column: Any
    rows: Column

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, rows: slice) -> Any:
        return self.column.take(self.rows[rows])


class _Errors(NamedTuple):
    """Errors in one metric and unit, and the rows of their images."""

    values: Column
    rows: Column


class MethodImages:
    """The images of the result files of one method, in their order.

    items and failed (whether an image lacks an error) have a row for each.
    """

    def __init__(self, name: str, folder: Path | None) -> None:
        self.name = name
        self.items = Texts(folder)
        self.failed = Column(folder, np.bool_)
        self.files: list[Path] = []
        self._folder = folder
        self._ends: list[int] = []
        self._coder, self._codes = Coder(), Column(folder, np.int32)
        self._plausibility = Column(folder, np.float64)
        self._objective = Column(folder, np.float64)
        self._errors: dict[Kind, _Errors] = {}
        self._shares: dict[Kind, _Errors] = {}
        self._failures: dict[str, str] = {}
        self._unlisted = 0
        self._runs: list[Run] = []
        self._knows_plausibility, self._all_objectives = False, True

    def __len__(self) -> int:
        return len(self.items)

    def add(
        self,
        judgement: Judgement,
        results: ResultSet,
        plausibility: Floats | None = None,
        shares: tuple[NDArray[np.intp], Floats] | None = None,
    ) -> None:
        """Add the images of one file; shares as `image_shares` gives them."""
        run = _run_of(results)
        before, n = len(self), len(judgement.items)
        failed = judgement.failed()
        for kind, values in judgement.errors.items():
            rows = rows_judged(kind, values, failed)
            self._add_errors(self._errors, kind, before + rows, values[rows])
        if shares is not None:
            rows, values = shares
            self._add_errors(self._shares, (INSIDE, SHARE), before + rows, values)
        self.items.append(judgement.items)
        self.failed.append(failed)
        self.files.append(judgement.file)
        self._ends.append(before + n)
        self._codes.append(self._coder(judgement.sequences))
        self._plausibility.append(np.full(n, np.nan) if plausibility is None else plausibility)
        self._knows_plausibility |= plausibility is not None
        self._all_objectives &= run.objective is not None
        if run.objective is not None:
            self._objective.append(run.objective[:])
        room = MOST_LISTED - len(self._failures)
        self._failures |= dict(list(judgement.failures.items())[:room])
        self._unlisted += max(len(judgement.failures) - room, 0)
        self._runs.append(Run(run.images, None, run.solved, run.seconds))

    def errors(self) -> list[ImageErrors]:
        """Return the errors in each metric and unit that any image has."""
        return self._joined(self._errors)

    def shares(self) -> list[ImageErrors]:
        """Return the shares of landmarks inside the error bars, where the method has these."""
        return self._joined(self._shares)

    def _joined(self, kinds: Mapping[Kind, _Errors]) -> list[ImageErrors]:
        found = []
        for kind, own in kinds.items():
            if not len(own.values):
                continue
            every = len(own.values) == len(self)
            columns: tuple[Any, ...] = (self.items, self._codes, self._plausibility)
            names, codes, trust = (
                column if every else Picked(column, own.rows) for column in columns
            )
            labels = Labels(self._coder.names, codes)
            known = trust if self._knows_plausibility else None
            found.append(ImageErrors(self.name, *kind, names, labels, own.values, known))
        return found

    def method(self) -> Method:
        """Return what the report says of the method as a whole."""
        runs = self._runs
        seconds = [run.seconds for run in runs if run.seconds is not None]
        solved = [run.solved for run in runs if run.solved is not None]
        whole = Run(
            images=sum(run.images for run in runs),
            objective=self._objective if self._all_objectives else None,
            solved=sum(solved) if len(solved) == len(runs) else None,
            seconds=sum(seconds) if len(seconds) == len(runs) else None,
        )
        return Method(
            name=self.name,
            files=tuple(map(path_text, self.files)),
            images=len(self),
            failures=self._failures,
            solving=sum_up(whole),
            unlisted=self._unlisted,
        )

    def place(self, row: int) -> tuple[Path, int]:
        """Return the file of an image, and its row among those of the file that are judged."""
        number = bisect_right(self._ends, row)
        return self.files[number], row - (self._ends[number - 1] if number else 0)

    def check_distinct(self) -> None:
        """Raise InputError where two files have the same item."""
        starts = [0, *self._ends]
        blocks = {
            file: partial(self.items.blocks, start, end)
            for file, start, end in zip(self.files, starts, self._ends, strict=False)
        }
        for item, first, second in find_equal_names(blocks).examples[:1]:
            found = f"has the item '{item}', which {first} has too"
            fix = "give each file a unique name in `results`, or leave one out"
            raise input_error(second, found, fix)

    def _add_errors(
        self, kinds: dict[Kind, _Errors], kind: Kind, rows: NDArray[np.intp], values: Floats
    ) -> None:
        """Add errors of these rows."""
        if kind not in kinds:
            kinds[kind] = _Errors(Column(self._folder, np.float64), Column(self._folder, np.int64))
        own = kinds[kind]
        own.rows.append(rows)
        own.values.append(values)


def count_solved(status: NDArray[Any]) -> int:
    """Count the images that are optimal or converged, by their words."""
    return int(np.isin(np.asarray(status, dtype=str), SOLVED).sum())


def _run_of(results: ResultSet) -> Run:
    seconds = results.attributes.get("solve_seconds")
    return Run(
        images=len(results),
        objective=results.objective,
        solved=None if results.status is None else count_solved(results.status),
        seconds=_seconds(seconds),
    )


def _seconds(stated: object) -> float | None:
    """Return what a file states; None where that is no time."""
    if isinstance(stated, int | float) and math.isfinite(stated) and stated >= 0:
        return float(stated)
    return None
