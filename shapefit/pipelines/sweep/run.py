"""`sweep`: the chain of the other commands for each value of one key, and the error against it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from shapefit import __version__
from shapefit.config import SweepConfig, ViewConfig
from shapefit.config.commands.sweep import Value
from shapefit.errors import input_error
from shapefit.evaluation.metric_table import of_labels
from shapefit.evaluation.plots.style import writers as drawings
from shapefit.evaluation.plots.sweep_plots import sweep_plot
from shapefit.evaluation.summary import ImageErrors
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
from shapefit.evaluation.tables.csv_json import write_per_image
from shapefit.io import (
    ResultSet,
    digests,
    open_landmarks,
    read_results,
    read_shapes,
)
from shapefit.io.extras import CORRUPTED
from shapefit.io.whole.folder import Write, check_folder, write_folder
from shapefit.pipelines.drawing import draws_plots, plots_left_out
from shapefit.pipelines.evaluate.image_errors import find_grouping, image_errors
from shapefit.pipelines.evaluate.judgement import judge
from shapefit.pipelines.evaluate.report_pages import report_pages
from shapefit.pipelines.outcome import Failure, Outcome
from shapefit.pipelines.sweep.steps import Files, fit_value, named, prepare, setting, value_folder


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
    truth = read_shapes(config.truth, gaps=True)
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
        judgement = judge(result, results, truth, config.match, _metrics(config, value, results))
        new = (Failure(i, why) for i, why in judgement.failures.items() if i not in failed)
        errors = _in_first_units(image_errors(value_text(value), judgement))
        grouping, ungrouped = find_grouping(config.groups, errors)
        yield Outcome(
            failures=named(new, setting(config, value)),
            warnings=judgement.warnings + ungrouped,
        )
        seconds = 1 / float(results.attributes["images_per_second"])
        judged += errors
        found += [point for e in errors for point in points(value, e, grouping, seconds)]
    sweep = Sweep(config.key, tuple(found), _provenance(config))
    writers = _writers(sweep, judged, with_plot=draws)
    best = best_value(sweep)
    pages = report_pages(
        "sweep",
        document(sweep),
        writers,
        [e for e in judged if e.method == value_text(best)],
        _view_of(config, best) if config.view else None,
        sweep.provenance,
    )
    written = write_folder(config.output, writers | pages.writers)
    warnings = plots_left_out(config.plots) + pages.warnings
    yield Outcome(note=markdown(sweep).rstrip(), warnings=warnings, written=written)


def best_value(sweep: Sweep) -> Value:
    """Return the value with the least mean error in the first metric, over its groups."""
    first = next(iter(sweep.of_metric().values()))
    means: dict[Value, list[float]] = {}
    for point in (point for found in first.values() for point in found):
        means.setdefault(point.value, []).append(point.mean)
    known = {value: sum(each) / len(each) for value, each in means.items()}
    return min(known, key=lambda value: (math.isnan(known[value]), known[value]))


def _view_of(config: SweepConfig, value: Value) -> ViewConfig | None:
    """Return what the viewer shows: the fit at one value. None where the truth was a pipe."""
    if not all(file.is_file() for file in config.truth):
        return None
    result = value_folder(config, value) / "result.h5"
    return ViewConfig(files={value_text(value): (result,)}, truth=config.truth, match=config.match)


def _check_match(config: SweepConfig, landmarks: Sequence[Path]) -> None:
    """Raise InputError where the landmarks have no dataset that names the truth of an image."""
    with open_landmarks(landmarks) as source:
        if config.match not in ("item", *source.head.extras):
            found = f"the landmarks have no dataset '{config.match}'"
            raise input_error("match", found, "name one that holds items of the truth, or `item`")


def _metrics(config: SweepConfig, value: Value, results: ResultSet) -> Sequence[str]:
    """Return the metrics of the config, and those of labels where the truth of labels is known."""
    labelled = config.steps(value).fit.labels_outliers and CORRUPTED in results.extras
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
        "per_image.csv": lambda path: write_per_image(path, judged, of="value"),
        "sweep.csv": lambda path: write_csv(path, sweep),
        "sweep.json": lambda path: path.write_text(sweep_json(sweep), encoding="utf-8"),
    }
    return writers | (drawings("sweep", sweep_plot(sweep)) if with_plot else {})
