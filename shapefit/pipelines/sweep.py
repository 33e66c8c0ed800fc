"""`sweep`: the chain of the other commands for each value of one key, and the error against it."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from shapefit import __version__
from shapefit.config import EvalConfig, SweepConfig
from shapefit.config.sweep import Value
from shapefit.evaluation import plots
from shapefit.evaluation.report import NORMALISED
from shapefit.evaluation.summary import ImageErrors, group_sequences
from shapefit.evaluation.sweep import Point, Sweep, markdown, points, sweep_json, write_csv
from shapefit.evaluation.sweep_plots import sweep_plot
from shapefit.io import digest, landmark_writer, open_landmarks, read_results
from shapefit.pipelines import evaluate, fit, learn_dict, project
from shapefit.pipelines.outcome import Failure, Outcome
from shapefit.pipelines.report_folder import Writer, check_folder, write_folder

METRIC: Literal["similarity"] = "similarity"

CHUNK = 4096
"""Images held in memory at a time while landmarks are thinned out."""

WARM_UP = 8
"""Images fitted before the clock runs, so that nothing is compiled while it does."""


@dataclass(frozen=True)
class Files:
    """What the steps before `fit` made."""

    dictionary: Path
    landmarks: Path
    warm_up: Path


def run(config: SweepConfig) -> Iterator[Outcome]:
    """Run the chain for each value, then write the tables and the plot to the output folder.

    A step that the key has no say in is done once, for all values. The files between stand in the
    folder `work` of the output. One outcome a stretch of the fits, and a last one with the
    Markdown table as its note. Raises InputError as the commands of the chain do, for an output
    folder that cannot be written, and plots without matplotlib.
    """
    check_folder(config.output)
    if config.plots:
        plots.require_matplotlib()
    work = config.output / "work"
    files: Files | None = None
    found: list[Point] = []
    for number, value in enumerate(config.values, start=1):
        folder = work / f"{number}_{_file_name(value)}"
        folder.mkdir(parents=True, exist_ok=True)
        files = yield from _prepare(config, value, files, folder, work)
        result = folder / "result.h5"
        failed = yield from _fit(config, value, files, result)
        errors = yield from _judge(config, value, result, failed)
        seconds = 1 / float(read_results(result).attributes["images_per_second"])
        grouping = group_sequences(config.groups, dict.fromkeys(errors.sequences))
        found += points(value, errors, grouping, seconds)
    sweep = Sweep(config.key, tuple(found), config.caveats, _provenance(config))
    written = tuple(write_folder(config.output, _writers(sweep, with_plot=config.plots)))
    yield Outcome(note=markdown(sweep).rstrip(), written=written)


def _prepare(
    config: SweepConfig, value: Value, before: Files | None, folder: Path, work: Path
) -> Generator[Outcome, None, Files]:
    """Learn and project where this value is the first, or has a say in it."""
    steps = config.steps(value)

    def place(section: str) -> Path | None:
        if config.varied_section == section:
            return folder
        return None if before else work

    dictionary = before.dictionary if before else steps.fit.dictionary
    at = place("learn_dict")
    if steps.learn_dict and at:
        dictionary = at / "dictionary.h5"
        learning = steps.learn_dict.model_copy(update={"output": dictionary})
        yield from _as_preparation(learn_dict.run(learning), f"{config.key}={value}: learn-dict")
    at = place("project")
    if before and not at:
        return replace(before, dictionary=dictionary)
    at = at or work
    landmarks = steps.fit.landmarks
    if steps.project:
        landmarks = (at / "all_landmarks.h5",)
        seeing = steps.project.model_copy(update={"output": landmarks[0]})
        yield from _as_preparation(project.run(seeing), f"{config.key}={value}: project")
    files = Files(dictionary, at / "landmarks.h5", at / "warm_up.h5")
    _thin_out(landmarks, config.frames, files)
    return files


def _as_preparation(outcomes: Iterable[Outcome], name: str) -> Iterator[Outcome]:
    """Pass on what went wrong in a step before `fit`; its items are not the images that count."""
    for outcome in outcomes:
        failures = _named(outcome.failures, name)
        yield Outcome(failures=failures, warnings=outcome.warnings, note=name)


def _thin_out(landmarks: Sequence[Path], every: int, files: Files) -> None:
    """Write every n-th image to a file, and the first few of them to one to warm up with."""
    with (
        open_landmarks(landmarks) as source,
        landmark_writer(files.landmarks) as writer,
        landmark_writer(files.warm_up) as warm_up,
    ):
        seen = 0
        for chunk in source.chunks(CHUNK):
            kept = chunk.take(slice(-seen % every, None, every))
            writer.append(kept)
            if not seen:
                warm_up.append(kept.take(slice(WARM_UP)))
            seen += len(chunk)


def _fit(
    config: SweepConfig, value: Value, files: Files, result: Path
) -> Generator[Outcome, None, set[str]]:
    """Fit the images at one value, once all it takes is compiled; return the items that failed."""
    fitting = config.steps(value).fit.model_copy(
        update={"landmarks": (files.warm_up,), "dictionary": files.dictionary, "output": result}
    )
    for _ in fit.run(fitting):
        pass
    failed: set[str] = set()
    for outcome in fit.run(fitting.model_copy(update={"landmarks": (files.landmarks,)})):
        failed |= {failure.item for failure in outcome.failures}
        yield Outcome(
            done=outcome.done,
            total=outcome.total and outcome.total * len(config.values),
            failures=_named(outcome.failures, f"{config.key}={value}"),
            warnings=outcome.warnings,
            note=f"{config.key}={value}",
        )
    return failed


def _judge(
    config: SweepConfig, value: Value, result: Path, failed: Collection[str]
) -> Generator[Outcome, None, ImageErrors]:
    """Compare the result at one value with the truth; return the errors of its images.

    The items in `failed` have been reported already.
    """
    judging = EvalConfig(
        results={str(value): (result,)},
        truth=config.truth,
        groups=config.groups,
        metrics=(METRIC,),
        output=result.with_name("report"),
        plots=False,
    )
    for outcome in evaluate.run(judging):
        new = tuple(failure for failure in outcome.failures if failure.item not in failed)
        failures = _named(new, f"{config.key}={value}")
        yield Outcome(failures=failures, warnings=outcome.warnings)
    return _read_errors(judging.output / "per_image.csv")


def _named(failures: Iterable[Failure], name: str) -> tuple[Failure, ...]:
    return tuple(Failure(f"{name}: {failure.item}", failure.reason) for failure in failures)


def _read_errors(per_image: Path) -> ImageErrors:
    """Read the normalised errors of one method from what `eval` wrote."""
    import polars as pl

    table = pl.read_csv(per_image, schema_overrides={"item": pl.String, "sequence": pl.String})
    table = table.filter(unit=NORMALISED)
    return ImageErrors(
        method=table["method"].cast(pl.String)[0],
        metric=METRIC,
        unit=NORMALISED,
        items=tuple(table["item"]),
        sequences=tuple(table["sequence"]),
        values=table["error"].cast(pl.Float64).fill_null(np.nan).to_numpy(),
    )


def _file_name(value: Value) -> str:
    return re.sub(r"[^\w.+-]", "_", str(value))


def _provenance(config: SweepConfig) -> dict[str, object]:
    last = config.steps(config.values[-1])
    files = [*config.truth, *(last.learn_dict.shapes if last.learn_dict else ())]
    files += last.project.shapes if last.project else last.fit.landmarks
    files += () if last.learn_dict else (last.fit.dictionary,)
    return {
        "version": __version__,
        "config": json.loads(config.as_json()),
        "inputs": {str(file): digest(file) for file in dict.fromkeys(files)},
    }


def _writers(sweep: Sweep, *, with_plot: bool) -> dict[str, Writer]:
    writers: dict[str, Writer] = {
        "sweep.csv": lambda path: write_csv(path, sweep),
        "sweep.json": lambda path: path.write_text(sweep_json(sweep), encoding="utf-8"),
        "sweep.md": lambda path: path.write_text(markdown(sweep), encoding="utf-8"),
    }
    return writers | (plots.writers("sweep", sweep_plot(sweep)) if with_plot else {})
