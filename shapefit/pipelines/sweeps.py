"""`sweep`: the chain of the other commands for each value of one key, and the error against it."""

from __future__ import annotations

import json
import re
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from shapefit import __version__
from shapefit.config import EvalConfig, SweepConfig
from shapefit.config.commands.fit_sections import ExportConfig, PicturesConfig
from shapefit.config.commands.sweep import CorruptionConfig, Value
from shapefit.errors import input_error
from shapefit.evaluation.experiment_plots import sweep_plot
from shapefit.evaluation.metric_table import of_labels
from shapefit.evaluation.plots import writers as drawings
from shapefit.evaluation.report import as_markdown
from shapefit.evaluation.summaries import ImageErrors, group_sequences
from shapefit.evaluation.sweep import (
    Point,
    Sweep,
    document,
    markdown,
    points,
    sweep_json,
    value_text,
    write_csv,
)
from shapefit.io import (
    LandmarkSet,
    ResultSet,
    digests,
    landmark_writer,
    open_landmarks,
    read_dictionary,
    read_results,
    read_shapes,
)
from shapefit.io.csv.writing import per_image_header, per_image_rows
from shapefit.io.layout import CORRUPTED
from shapefit.io.whole.folder import Write, check_folder, write_folder
from shapefit.pipelines import projection as project
from shapefit.pipelines.drawing import draws_plots, plots_left_out
from shapefit.pipelines.evaluate.judge import Truth, judge
from shapefit.pipelines.fit import run as fit
from shapefit.pipelines.imperfections import BATCH, Purpose, corrupt, stream
from shapefit.pipelines.learn_dict import run as learn_dict
from shapefit.pipelines.outcome import Failure, Outcome

WARM_UP = 8
"""Images of the file to warm up with."""


MARGIN = 0.1
"""By what share of its size the box in which wrong points lie is grown on each side."""


@dataclass(frozen=True)
class Choice:
    """Every n-th image, from the one at `offset` on, of those with so many visible landmarks."""

    least_visible: int
    offset: int
    every: int


def choose_images(
    landmarks: Sequence[Path],
    choice: Choice,
    corruption: CorruptionConfig | None,
    names: Sequence[str],
    chosen: Path,
    warm_up: Path,
) -> None:
    """Write the chosen images to one file, and the first few of them to one to warm up with.

    With `corruption` their landmarks are arranged as `names`, and the images get the dataset
    `corrupted`. What is drawn for an image depends on its place in the landmark files, not on
    the choice. Raises InputError where no image is left.
    """
    enough, written = 0, 0
    with (
        open_landmarks(landmarks) as source,
        landmark_writer(chosen) as writer,
        landmark_writer(warm_up) as first_ones,
    ):
        for batch, images in enumerate(source.batches(BATCH)):
            visible = images.seen().sum(axis=1)
            rows = np.flatnonzero(visible >= choice.least_visible)
            number = enough + np.arange(len(rows)) - choice.offset
            enough += len(rows)
            rows = rows[(number >= 0) & (number % choice.every == 0)]
            if corruption is not None:
                images = corrupted(images.arrange(names), corruption, batch)
            kept = images.take(rows)
            writer.append(kept)
            if written < WARM_UP:
                first_ones.append(kept.take(slice(WARM_UP - written)))
            written += len(rows)
        if not written:
            found = f"{enough} images with {choice.least_visible} visible landmarks or more"
            fix = "lower `least_visible` or `offset`: no image is left to fit"
            raise input_error(", ".join(map(str, landmarks)), found, fix)


def corrupted(images: LandmarkSet, config: CorruptionConfig, batch: int) -> LandmarkSet:
    """Return the images of a batch with some landmarks replaced, and the dataset that says so."""
    rng = stream(config.seed, Purpose.CORRUPTION, batch)
    seen = images.seen()
    landmarks, wrong = corrupt(images.landmarks, seen, config.share, MARGIN, rng)
    before = images.columns.get(CORRUPTED)
    wrong = wrong if before is None else wrong | np.asarray(before, bool)
    return images.with_columns({"landmarks": landmarks, CORRUPTED: wrong})


@dataclass(frozen=True)
class Files:
    """What the steps before `fit` made.

    `warm_up` holds images to fit before the clock runs, so that nothing is compiled while it does.
    """

    dictionary: Path
    seen: tuple[Path, ...]
    landmarks: Path
    warm_up: Path


def prepare(
    config: SweepConfig, value: Value, before: Files | None, folder: Path, work: Path
) -> Generator[Outcome, None, Files]:
    """Learn and project for the first value, and where the value matters."""
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
        yield from _as_preparation(
            learn_dict.run(learning), f"{setting(config, value)}: learn-dict"
        )
    at = place("project")
    seen = before.seen if before else steps.fit.landmarks
    if steps.project and at:
        seen = (at / "all_landmarks.h5",)
        seeing = steps.project.model_copy(update={"output": seen[0]})
        yield from _as_preparation(project.run(seeing), f"{setting(config, value)}: project")
    if config.varied_section in ("project", "corrupt"):
        at = folder
    elif before:
        return replace(before, dictionary=dictionary)
    else:
        at = work
    files = Files(dictionary, seen, at / "landmarks.h5", at / "warm_up.h5")
    choose_images(
        seen,
        Choice(config.least_visible, config.offset, config.every),
        steps.corrupt if config.corrupts else None,
        read_dictionary(dictionary).marked(()).landmark_names,
        files.landmarks,
        files.warm_up,
    )
    return files


def _as_preparation(outcomes: Iterable[Outcome], name: str) -> Iterator[Outcome]:
    """Pass on what went wrong in a step before `fit`; its items are not the images that count."""
    for outcome in outcomes:
        failures = named(outcome.failures, name)
        yield Outcome(failures=failures, warnings=outcome.warnings, note=name)


def fit_value(
    config: SweepConfig, value: Value, files: Files, result: Path
) -> Generator[Outcome, None, set[str]]:
    """Fit the images at one value, once all it takes is compiled; return the items that failed."""
    fitting = config.steps(value).fit.model_copy(
        update={
            "landmarks": (files.warm_up,),
            "dictionary": files.dictionary,
            "output": result,
            # each value would write over the meshes and pictures of the one before
            "export": ExportConfig(),
            "pictures": PicturesConfig(),
        }
    )
    # the few images to warm up with may all be of models that the dictionary does not have
    for _ in fit.run(fitting.model_copy(update={"leave_out": None})):
        pass
    failed: set[str] = set()
    for outcome in fit.run(fitting.model_copy(update={"landmarks": (files.landmarks,)})):
        failed |= {failure.item for failure in outcome.failures}
        yield Outcome(
            done=outcome.done,
            total=outcome.total and outcome.total * len(config.values),
            failures=named(outcome.failures, setting(config, value)),
            warnings=outcome.warnings,
            note=setting(config, value),
        )
    return failed


def value_folder(config: SweepConfig, value: Value) -> Path:
    """Return the folder of the files between, of one value."""
    number = config.values.index(value) + 1
    return config.output / "work" / f"{number}_{_file_name(value)}"


def named(failures: Iterable[Failure], name: str) -> tuple[Failure, ...]:
    """Return the failures with the name of the step, or of the value, before their items."""
    return tuple(Failure(f"{name}: {failure.item}", failure.reason) for failure in failures)


def setting(config: SweepConfig, value: Value) -> str:
    """Return `key=value`, the name of one fit in messages."""
    return f"{config.key}={value_text(value)}"


def _file_name(value: Value) -> str:
    return re.sub(r"[^\w.+-]", "_", value_text(value))


def run(config: SweepConfig) -> Iterator[Outcome]:
    """Run the chain for each value, then write the tables and the plot to the output folder.

    A step that does not depend on the key is done once, for all values. Files in between are in the
    folder `work` of the output. One outcome per stretch of the fits, and a last one with the
    Markdown table as its note. Raises InputError as the commands of the chain do, for an output
    folder that cannot be written, and plots that are asked for without matplotlib.
    """
    check_folder(config.output)
    draws = draws_plots(config.plots)
    if not config.project:
        _check_match(config, config.fit.landmarks)
    work = config.output / "work"
    files: Files | None = None
    true = read_shapes(config.truth, gaps=True)
    truth = Truth(true, true.items, true.take)
    judged: list[ImageErrors] = []
    found: list[Point] = []
    for value in config.values:
        folder = value_folder(config, value)
        folder.mkdir(parents=True, exist_ok=True)
        files = yield from prepare(config, value, files, folder, work)
        _check_match(config, (files.landmarks,))
        result = folder / "result.h5"
        failed = yield from fit_value(config, value, files, result)
        results = read_results(result)
        metrics = _metrics(config, value, results)
        asked = EvalConfig.model_construct(match=config.match, metrics=metrics, calibration=False)
        judgement = judge(result, results, truth, asked)
        new = (Failure(i, why) for i, why in judgement.failures.items() if i not in failed)
        errors = _in_first_units(judgement.image_errors(value_text(value)))
        sequences = (name for each in errors for name in each.sequences.names)
        grouping, ungrouped = group_sequences(config.groups, sequences)
        yield Outcome(
            failures=named(new, setting(config, value)),
            warnings=(*judgement.warnings, *ungrouped),
        )
        seconds = 1 / float(results.attributes["images_per_second"])
        judged += errors
        found += [point for e in errors for point in points(value, e, grouping, seconds)]
    sweep = Sweep(config.key, tuple(found), _provenance(config))
    writers = _writers(sweep, judged, with_plot=draws)
    page = as_markdown([*document(sweep), *(["![sweep](sweep.png)"] if draws else [])])
    writers["sweep.md"] = lambda path: path.write_text(page, encoding="utf-8")
    written = write_folder(config.output, writers)
    note, warnings = markdown(sweep).rstrip(), plots_left_out(config.plots)
    yield Outcome(note=note, warnings=warnings, written=written)


def _check_match(config: SweepConfig, landmarks: Sequence[Path]) -> None:
    """Raise InputError where the landmarks have no dataset that names the truth of an image."""
    with open_landmarks(landmarks) as source:
        if config.match not in ("item", *source.head.further):
            found = f"the landmarks have no dataset '{config.match}'"
            raise input_error("match", found, "name one that holds items of the truth, or `item`")


def _metrics(config: SweepConfig, value: Value, results: ResultSet) -> Sequence[str]:
    """Return the metrics of the config, and those of labels where the truth of labels is known."""
    labelled = config.steps(value).fit.labels_outliers and CORRUPTED in results.columns
    return config.metrics + (of_labels() if labelled else ())


def _in_first_units(errors: Iterable[ImageErrors]) -> list[ImageErrors]:
    """Return the errors in each metric, in its first unit where it has several."""
    found: dict[str, ImageErrors] = {}
    for each in errors:
        found.setdefault(each.metric, each)
    return list(found.values())


def _provenance(config: SweepConfig) -> dict[str, object]:
    last = config.steps(config.values[-1])
    files = [*config.truth, *(last.learn_dict.shapes if last.learn_dict else ())]
    files += last.project.shapes if last.project else last.fit.landmarks
    files += () if last.learn_dict else (last.fit.dictionary,)
    return {
        "version": __version__,
        "config": json.loads(config.as_json()),
        "inputs": digests(files),
    }


def _writers(sweep: Sweep, judged: Sequence[ImageErrors], *, with_plot: bool) -> dict[str, Write]:
    writers: dict[str, Write] = {
        "per_image.csv": lambda path: path.write_bytes(
            b"".join(
                [
                    b"value,",
                    per_image_header().partition(b",")[2],
                    *(rows for e in judged for rows in per_image_rows(e)),
                ]
            )
        ),
        "sweep.csv": lambda path: write_csv(path, sweep),
        "sweep.json": lambda path: path.write_text(sweep_json(sweep), encoding="utf-8"),
    }
    return writers | (drawings("sweep", sweep_plot(sweep)) if with_plot else {})
