"""`eval`: results against the truth, image by image, summed up in tables and plots."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from shapefit import __version__
from shapefit.config import EvalConfig, ViewConfig
from shapefit.errors import counted, input_error, path_text, printable
from shapefit.evaluation.calibration import ErrorBars, cover, image_shares, join
from shapefit.evaluation.metric_table import METRICS
from shapefit.evaluation.plots import bars as plots
from shapefit.evaluation.plots.box_plots import box_plot
from shapefit.evaluation.plots.calibration_plot import calibration_plot
from shapefit.evaluation.report import NORMALISED, Method, Report
from shapefit.evaluation.solving import Run, sum_up
from shapefit.evaluation.summary import ImageErrors, summarise
from shapefit.evaluation.tables import csv_json as tables
from shapefit.evaluation.tables.errors_document import document, markdown
from shapefit.evaluation.trust import keep_trusted
from shapefit.io import ResultSet, ShapeSet, read_results, read_shapes
from shapefit.io.whole.atomic import digests
from shapefit.io.whole.report_folder import Writer, check_folder, write_folder
from shapefit.pipelines.drawing import check_can_draw, draws_plots, plots_left_out
from shapefit.pipelines.evaluate.error_bars import find_plausibility, judge_error_bars
from shapefit.pipelines.evaluate.examples import Lifted, check_examples, examples_picture, keep
from shapefit.pipelines.evaluate.floors import Shown, floor_errors, shown_in
from shapefit.pipelines.evaluate.image_errors import find_grouping, image_errors
from shapefit.pipelines.evaluate.judgement import Judgement, judge
from shapefit.pipelines.evaluate.report_pages import contact_sheets, report_pages
from shapefit.pipelines.evaluate.visible_enough import visible_enough
from shapefit.pipelines.outcome import Failure, Outcome
from shapefit.pipelines.reading import input_options

MOST_FAILURES = 200
"""Failed items a method that the report lists; its JSON lists them all."""


def run(config: EvalConfig) -> Iterator[Outcome]:
    """Judge every result file, then write the tables and plots to the output folder.

    One outcome a result file, with the images that failed, and a last one with the Markdown
    tables as its note. Nothing is written before all results were judged. Raises InputError for
    files that cannot be read or compared, images that leave every metric undefined, a dictionary
    that gives no floors, groups that no sequence belongs to, examples that cannot be drawn, an
    output folder that cannot be written, and plots that are asked for without matplotlib.
    """
    check_folder(config.output)
    draws = draws_plots(config.plots)
    examples = config.examples if config.plots else 0
    if examples:
        check_can_draw("examples")
    truth = read_shapes(config.truth, input_options(config.input), gaps=True)
    check_examples(examples, truth, config.truth)
    found = _Found(warnings=count_gaps(truth))
    if found.warnings:
        yield Outcome(warnings=tuple(found.warnings))
    yield from _judge_all(config, truth, found, keep_all=bool(examples))
    errors = found.errors
    if not errors:
        nothing = f"no image has anything to judge in {', '.join(config.metrics)}"
        raise input_error("metrics", nothing, "add `similarity`, which every shape has")
    if config.floors:
        errors = errors + floor_errors(config.floors.dictionary, truth, found.shown)
    grouping, ungrouped = find_grouping(config.groups, errors)
    coverage = [c for bars in found.bars for c in cover(bars, grouping)]
    report = Report(
        methods=tuple(found.methods),
        summaries=tuple(s for e in errors for s in summarise(e, grouping)),
        warnings=tuple(map(printable, (*found.warnings, *ungrouped))),
        coverage=tuple(coverage),
        kept=tuple(
            kept
            for e in found.errors
            if e.method in found.plausibility and not METRICS[e.metric].of_labels
            for kept in keep_trusted(e, found.plausibility[e.method], grouping)
        ),
        without_bars=tuple(
            m.name for m in found.methods if m.name not in {bars.method for bars in found.bars}
        ),
        parallel=tuple(bars.method for bars in found.bars if bars.parallel),
        provenance=_provenance(config),
    )
    writers = _tables([*errors, *map(image_shares, found.bars)], report)
    if draws:
        writers |= _plots(errors, grouping)
        if coverage:
            drawing = calibration_plot(found.bars, coverage, grouping)
            writers |= plots.writers("calibration", drawing)
    if examples:
        writers |= plots.writers("examples", examples_picture(examples, found.lifted, truth))
    blocks = [*document(report, MOST_FAILURES), *contact_sheets(found.fitted_with, config.output)]
    pages = report_pages("report", blocks, writers, errors, view_of(config), report.provenance)
    written = write_folder(config.output, writers | pages.writers)
    warnings = ungrouped + plots_left_out(config.plots) + pages.warnings
    yield Outcome(warnings=warnings, note=markdown(report).rstrip(), written=written)


def count_gaps(truth: ShapeSet) -> list[str]:
    """Say how many landmarks of the truth are unknown."""
    gaps = np.asarray(np.isnan(truth.shapes).any(axis=1))
    if not gaps.any():
        return []
    shapes = counted(int(gaps.any(axis=1).sum()), "shape")
    return [f"the truth lacks {counted(int(gaps.sum()), 'landmark')} of {shapes} (NaN): left out"]


def view_of(config: EvalConfig) -> ViewConfig | None:
    """Return what the viewer beside the report shows; None without it, or where a pipe was read."""
    files = [*config.truth, *(file for files in config.results.values() for file in files)]
    if not config.view or not all(file.is_file() for file in files):
        return None
    return ViewConfig(
        files=config.results, truth=config.truth, match=config.match, input=config.input
    )


@dataclass
class _Found:
    """What is known once all results were judged.

    errors and methods in the order of `results`; the warnings, each once; lifted and shown are
    what examples and floors need, where these are asked for; fitted_with the configs of the fits;
    bars and plausibility (by item) of the methods that have them.
    """

    methods: list[Method] = field(default_factory=list)
    errors: list[ImageErrors] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    lifted: dict[str, list[Lifted]] = field(default_factory=dict)
    shown: dict[str, Shown] = field(default_factory=dict)
    fitted_with: dict[str, list[str]] = field(default_factory=dict)
    bars: list[ErrorBars] = field(default_factory=list)
    plausibility: dict[str, dict[str, float]] = field(default_factory=dict)


def _judge_all(
    config: EvalConfig, truth: ShapeSet, found: _Found, *, keep_all: bool
) -> Iterator[Outcome]:
    """Judge every result file and add to what was found; one outcome per file.

    With `keep_all` the shapes stay, to draw examples of them.
    """
    for name, files in config.results.items():
        judgements, runs, lifted, bars = [], [], [], []
        plausibility: dict[str, float] = {}
        for file in files:
            results = read_results(file)
            runs.append(_run_of(results))
            fitted_with = str(results.attributes.get("config", ""))
            found.fitted_with.setdefault(name, []).append(fitted_with)
            results, too_few = visible_enough(file, results, config.least_visible)
            judgement = judge(
                file,
                results,
                truth,
                config.match,
                config.metrics,
                frame=config.truth_frame,
            )
            judgements.append(judgement)
            unjudged: tuple[str, ...] = ()
            if config.calibration:
                own, unjudged = judge_error_bars(name, results, truth, judgement)
                bars += [own] if own else []
                plausibility |= find_plausibility(judgement, results)
            if keep_all:
                lifted.append(keep(results, judgement, truth))
            if config.floors:
                found.shown |= shown_in(results, judgement, config.floors.leave_out)
            new = [w for w in (*too_few, *judgement.warnings, *unjudged) if w not in found.warnings]
            found.warnings += new
            yield Outcome(
                done=len(judgement.items),
                failures=tuple(Failure(i, f"{name}: {w}") for i, w in judgement.failures.items()),
                warnings=tuple(new),
                note=name,
            )
        _check_distinct(judgements)
        found.methods.append(_method(name, judgements, runs))
        found.errors += image_errors(name, judgements)
        found.lifted[name] = lifted
        if bars:
            found.bars.append(join(bars))
        if plausibility:
            found.plausibility[name] = plausibility


def _check_distinct(judgements: Sequence[Judgement]) -> None:
    """Raise InputError where two files of one method have the same item."""
    seen: dict[str, Path] = {}
    for judgement in judgements:
        for item in judgement.items:
            if item in seen:
                found = f"has the item '{item}', which {seen[item]} has too"
                fix = "give each file a unique name in `results`, or leave one out"
                raise input_error(judgement.file, found, fix)
        seen |= dict.fromkeys(judgement.items, judgement.file)


def _run_of(results: ResultSet) -> Run:
    seconds = results.attributes.get("solve_seconds")
    return Run(
        images=len(results),
        objective=results.objective,
        status=results.status,
        seconds=_seconds(seconds),
    )


def _seconds(stated: object) -> float | None:
    """Return what a file states; None where that is no time."""
    if isinstance(stated, int | float) and math.isfinite(stated) and stated >= 0:
        return float(stated)
    return None


def _method(name: str, judgements: Sequence[Judgement], runs: Sequence[Run]) -> Method:
    return Method(
        name=name,
        files=tuple(path_text(j.file) for j in judgements),
        images=sum(len(j.items) for j in judgements),
        failures={item: why for j in judgements for item, why in j.failures.items()},
        solving=sum_up(runs),
    )


def _provenance(config: EvalConfig) -> dict[str, object]:
    files = [*config.truth, *(file for files in config.results.values() for file in files)]
    files += [config.floors.dictionary] if config.floors else []
    return {
        "version": __version__,
        "config": json.loads(config.as_json()),
        "inputs": digests(files),
    }


def _tables(errors: Sequence[ImageErrors], report: Report) -> dict[str, Writer]:
    """Return the writers of the tables; those on error bars only where a method has some."""
    of_bars: dict[str, Writer] = {}
    if report.coverage:
        of_bars["calibration.csv"] = lambda path: tables.write_coverage(path, report.coverage)
    if report.kept:
        of_bars["trusted.csv"] = lambda path: tables.write_kept(path, report.kept)
    return of_bars | {
        "per_image.csv": lambda path: tables.write_per_image(path, errors),
        "report.csv": lambda path: tables.write_report_csv(path, report.summaries),
        "report.json": lambda path: path.write_text(tables.report_json(report), encoding="utf-8"),
    }


def _plots(
    errors: Sequence[ImageErrors], grouping: Mapping[str, tuple[str, ...]]
) -> dict[str, Writer]:
    """Draw each metric once, as bars and boxes: what is also in the unit of the truth, normalised.

    Images in no group are in neither.
    """
    drawn: dict[str, list[ImageErrors]] = {}
    for (metric, unit), of_kind in tables.by_kind(errors).items():
        if metric not in drawn or unit == NORMALISED:
            drawn[metric] = of_kind
    writers: dict[str, Writer] = {}
    for metric, of_kind in drawn.items():
        summaries = [summary for e in of_kind for summary in summarise(e, grouping)]
        if summaries:
            writers |= plots.writers(metric, plots.bar_plot(summaries))
            writers |= plots.writers(f"{metric}_boxes", box_plot(of_kind, grouping))
    return writers
