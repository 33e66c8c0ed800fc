"""What each step of an evaluation gets; none of them sees the config."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from shapefit.config import EvalConfig, ViewConfig
from shapefit.config.commands.evaluate import FloorsConfig
from shapefit.io.columns import nearest_folder
from shapefit.io.options import InputOptions, input_options
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

    results are files by method; folder is that of temporary files.
    """

    results: Mapping[str, tuple[Path, ...]]
    match: str
    metrics: tuple[str, ...]
    truth_frame: Frame
    least_visible: int
    calibration: bool
    groups: Mapping[str, str]
    floors: FloorsConfig | None
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


def _view(config: EvalConfig) -> ViewConfig:
    return ViewConfig(
        files=config.results, truth=config.truth, match=config.match, input=config.input
    )
