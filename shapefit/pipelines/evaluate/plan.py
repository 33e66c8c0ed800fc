"""What each step of an evaluation gets: its options, for none sees the config, and the truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.config import EvalConfig, ViewConfig
from shapefit.config.commands.evaluate import FloorsConfig
from shapefit.errors import counted, input_error
from shapefit.io import ShapeSource, open_shapes
from shapefit.io.columns import Texts, nearest_folder
from shapefit.io.name_index import NameIndex
from shapefit.io.options import InputOptions, input_options
from shapefit.io.records import ShapeSet
from shapefit.io.whole.folder import check_folder
from shapefit.pipelines.drawing import check_can_draw, draws_plots, plots_left_out
from shapefit.pipelines.evaluate.judgement import Frame


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """Where the truth is, and how its files are read."""

    truth: tuple[Path, ...]
    how: InputOptions


@dataclass(frozen=True, kw_only=True)
class MeasuringOptions:
    """How results are matched with the truth and measured; keys of the config of the same names.

    results are files by method; truth the files whose digests are compared with the training data;
    folder is that of temporary files.
    """

    results: Mapping[str, tuple[Path, ...]]
    match: str
    metrics: tuple[str, ...]
    truth_frame: Frame
    least_visible: int
    calibration: bool
    groups: Mapping[str, str]
    floors: FloorsConfig | None
    truth: tuple[Path, ...]
    folder: Path | None


@dataclass(frozen=True, kw_only=True)
class WritingOptions:
    """What the report has, and where it goes.

    draws: whether plots are drawn; examples: how many images, or which; view: what the page of the
    viewer shows, None without it; inputs: the files whose digests are stated, and config, as JSON.
    """

    output: Path
    groups: Mapping[str, str]
    metrics: tuple[str, ...]
    draws: bool
    examples: int | tuple[str, ...]
    view: ViewConfig | None
    inputs: tuple[Path, ...]
    config: str
    warnings: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The options of the steps, in their order."""

    reading: ReadingOptions
    measuring: MeasuringOptions
    writing: WritingOptions


def plan_evaluation(config: EvalConfig) -> Plan:
    """Return the options of each step.

    Raises InputError for an output folder that cannot be written, and for plots that are asked for
    without matplotlib.
    """
    examples = config.examples if config.plots else 0
    if examples:
        check_can_draw("examples")
    draws, how = draws_plots(config.plots), input_options(config.input)
    check_folder(config.output)
    inputs = (*config.truth, *(file for files in config.results.values() for file in files))
    shown = config.view and all(file.is_file() for file in inputs)
    floors = () if config.floors is None else (config.floors.dictionary,)
    return Plan(
        reading=ReadingOptions(truth=config.truth, how=how),
        measuring=MeasuringOptions(
            results=config.results,
            match=config.match,
            metrics=config.metrics,
            truth_frame=config.truth_frame,
            least_visible=config.least_visible,
            calibration=config.calibration,
            groups=config.groups,
            floors=config.floors,
            truth=config.truth,
            folder=nearest_folder(config.output),
        ),
        writing=WritingOptions(
            output=config.output,
            groups=config.groups,
            metrics=config.metrics,
            draws=draws,
            examples=examples,
            view=_view(config) if shown else None,
            inputs=(*inputs, *floors),
            config=config.as_json(),
            warnings=plots_left_out(config.plots),
        ),
    )


def check_examples(wanted: int | Sequence[str], truth: ShapeSet, files: Sequence[Path]) -> None:
    """Raise InputError where examples are wanted and the truth has no edges to draw."""
    if wanted and truth.edges is None:
        place = ", ".join(map(str, files))
        fix = (
            "add the dataset `edges` (e,2), pairs of landmarks joined by a line, counted from 0, "
            "to the file, or leave out `examples`"
        )
        raise input_error(place, "has no edges to draw examples with", fix)


def _view(config: EvalConfig) -> ViewConfig:
    return ViewConfig(
        files=config.results, truth=config.truth, match=config.match, input=config.input
    )


AT_A_TIME = 1 << 14
"""Shapes that are read at a time for their names, and to count what they lack."""


class Truth:
    """The true shapes of an evaluation, found by their items; lacks: what is unknown of them."""

    def __init__(self, source: ShapeSource, folder: Path | None) -> None:
        self._source = source
        self._folder = folder
        self._names = Texts(folder)
        self._next = 0
        shapes, landmarks = 0, 0
        for part in source.batches(AT_A_TIME, by_file=True):
            self._names.append(part.items)
            gaps = np.asarray(np.isnan(part.shapes).any(axis=1))
            shapes += int(gaps.any(axis=1).sum())
            landmarks += int(gaps.sum())
        number = f"{counted(landmarks, 'landmark')} of {counted(shapes, 'shape')}"
        self.lacks = [f"the truth lacks {number} (NaN): left out"] if shapes else []

    @property
    def head(self) -> ShapeSet:
        """All of the truth but its shapes."""
        return self._source.head

    @property
    def count(self) -> int:
        """Number of shapes."""
        return self._source.count

    def named(self, items: Sequence[str]) -> ShapeSet:
        """Return the shapes that are called so, each once, in the order of the truth.

        Where none is, the first shape of all, so that an error can say what they are called.
        """
        rows = self._in_order(items)
        if rows is None:
            rows = np.unique(self._index.find(items))
            rows = rows[rows >= 0]
        return self._source.take(rows if len(rows) else np.arange(min(1, self.count)))

    def _in_order(self, items: Sequence[str]) -> NDArray[np.intp] | None:
        """Return rows that are called so one after another, from the first or the next one on.

        So they are where results are files of the same images; others are found by an index.
        """
        for start in (self._next, 0):
            rows = slice(start, start + len(items))
            near = self._names[start : start + 1] == tuple(items[:1])
            if near and self._names[rows] == tuple(items):
                self._next = rows.stop
                return np.arange(start, rows.stop)
        return None

    @cached_property
    def _index(self) -> NameIndex:
        return NameIndex.of(self._names.blocks())


@contextmanager
def open_truth(options: ReadingOptions, folder: Path | None) -> Iterator[Truth]:
    """Open the truth. Raises InputError as `open_shapes` does."""
    with open_shapes(options.truth, options.how, gaps=True) as source:
        yield Truth(source, folder)
