"""`eval`: results against the truth, image by image, summed up in tables and plots."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence

from shapefit import __version__
from shapefit.config import EvalConfig, ViewConfig
from shapefit.errors import input_error, printable
from shapefit.evaluation.calibration import keep_trusted
from shapefit.evaluation.metric_table import METRICS
from shapefit.evaluation.plots.bars import bar_plot, box_plot
from shapefit.evaluation.plots.calibration_plot import calibration_plot
from shapefit.evaluation.plots.style import writers as drawings
from shapefit.evaluation.report import NORMALISED, Report
from shapefit.evaluation.summary import ImageErrors, Summary, summarise
from shapefit.evaluation.tables import csv_json as tables
from shapefit.evaluation.tables.errors_document import document, markdown
from shapefit.io.csv.writing import write_per_image
from shapefit.io.whole.atomic import digests
from shapefit.io.whole.folder import Write, write_folder
from shapefit.pipelines.evaluate.found import Found
from shapefit.pipelines.evaluate.judgement import find_grouping
from shapefit.pipelines.evaluate.plan import (
    WritingOptions,
    check_examples,
    open_truth,
    plan_evaluation,
)
from shapefit.pipelines.evaluate.report_pages import contact_sheets, report_pages
from shapefit.pipelines.outcome import Outcome

MOST_FAILURES = 200
"""Failed items a method that the report lists; its JSON lists more."""

ERROR_BARS = "error_bars.json"
"""File of the report that `posterior.calibration` of fit takes."""

MOST_VIEWED = 300_000
"""Images, and true shapes, that the page of the viewer beside the report is made of, at most."""


def run(config: EvalConfig) -> Iterator[Outcome]:
    """Judge every result file, then write the tables and plots to the output folder.

    One outcome a result file, with the images that failed, and a last one with the Markdown
    tables as its note. Nothing is written before all results were judged. One result file at a time
    is in memory, with the true shapes of its images; names and errors of all images are in an
    unnamed file beside the report once they are many. Raises InputError for
    files that cannot be read or compared, images that leave every metric undefined, a dictionary
    that gives no floors, groups that no sequence belongs to, examples that cannot be drawn, an
    output folder that cannot be written, and plots that are asked for without matplotlib.
    """
    plan = plan_evaluation(config)
    with open_truth(plan.reading, plan.measuring.folder) as truth:
        check_examples(plan.writing.examples, truth.head, plan.reading.truth)
        found = Found(plan.measuring, truth)
        yield Outcome(warnings=tuple(found.warnings))
        yield from found.judge_all(hold=bool(plan.writing.examples))
        yield _report(plan.writing, found)


def _report(options: WritingOptions, found: Found) -> Outcome:
    """Write the report on what was found."""
    errors = found.errors
    if not errors:
        nothing = f"no image has anything to judge in {', '.join(options.metrics)}"
        raise input_error("metrics", nothing, "add `similarity`, which every shape has")
    if found.floors:
        errors = errors + found.floors.errors()
    grouping, ungrouped = find_grouping(options.groups, errors)
    coverage = [c for name, own in found.bars.items() for c in own.cover(name, grouping)]
    report = Report(
        methods=tuple(images.method() for images in found.methods),
        summaries=tuple(s for e in errors for s in summarise(e, grouping)),
        warnings=tuple(map(printable, (*found.warnings, *ungrouped))),
        coverage=tuple(coverage),
        kept=tuple(
            kept
            for e in found.errors
            if not METRICS[e.metric].of_labels
            for kept in keep_trusted(e, grouping)
        ),
        without_bars=tuple(m.name for m in found.methods if m.name not in found.bars),
        parallel=tuple(name for name, own in found.bars.items() if own.parallel),
        provenance=_provenance(options),
    )
    writers = _tables([*errors, *found.shares], report)
    if found.bars:
        factors = {name: own.find_factors() for name, own in found.bars.items()}
        writers[ERROR_BARS] = lambda path: path.write_text(json.dumps(factors), encoding="utf-8")
    if options.draws:
        writers |= _plots(errors, report.summaries, grouping)
        if coverage:
            curves = {(c.method, c.group): found.bars[c.method].curve(c.group) for c in coverage}
            writers |= drawings("calibration", calibration_plot(coverage, curves))
    if options.examples:
        writers |= drawings("examples", found.draw_examples(options.examples))
    blocks = [*document(report, MOST_FAILURES), *contact_sheets(found.sheets, options.output)]
    view, too_many = view_of(options, found)
    pages = report_pages("report", blocks, writers, errors, view, report.provenance)
    written = write_folder(options.output, writers | pages.writers)
    warnings = (*ungrouped, *options.warnings, *too_many, *pages.warnings)
    return Outcome(warnings=warnings, note=markdown(report).rstrip(), written=written)


def view_of(options: WritingOptions, found: Found) -> tuple[ViewConfig | None, tuple[str, ...]]:
    """Return what the viewer beside the report shows, and a warning where that is too much."""
    most = max(found.truth.count, sum(map(len, found.methods)))
    if options.view is None or most <= MOST_VIEWED:
        return options.view, ()
    why = f"{most:,} images or shapes are more than the {MOST_VIEWED:,} that it is made of"
    return None, (f"view.html is left out: {why}; `shapefit view` shows a file of them",)


def _provenance(options: WritingOptions) -> dict[str, object]:
    return {
        "version": __version__,
        "config": json.loads(options.config),
        "inputs": digests(options.inputs),
    }


def _tables(errors: Sequence[ImageErrors], report: Report) -> dict[str, Write]:
    """Return the writers of the tables; those on error bars only where a method has some."""
    of_bars: dict[str, Write] = {}
    if report.coverage:
        of_bars["calibration.csv"] = lambda path: tables.write_coverage(path, report.coverage)
    if report.kept:
        of_bars["trusted.csv"] = lambda path: tables.write_kept(path, report.kept)
    return of_bars | {
        "per_image.csv": lambda path: write_per_image(path, errors),
        "report.csv": lambda path: tables.write_report_csv(path, report.summaries),
        "report.json": lambda path: path.write_text(tables.report_json(report), encoding="utf-8"),
    }


def _plots(
    errors: Sequence[ImageErrors],
    summaries: Sequence[Summary],
    grouping: Mapping[str, tuple[str, ...]],
) -> dict[str, Write]:
    """Draw each metric once, as bars and boxes: what is also in the unit of the truth, normalised.

    Images in no group are in neither.
    """
    drawn: dict[str, tuple[str, str]] = {}
    of_kind = tables.by_kind(errors)
    for metric, unit in of_kind:
        if metric not in drawn or unit == NORMALISED:
            drawn[metric] = metric, unit
    summed_up = tables.by_kind(summaries)
    writers: dict[str, Write] = {}
    for metric, kind in drawn.items():
        if kind in summed_up:
            writers |= drawings(metric, bar_plot(summed_up[kind]))
            writers |= drawings(f"{metric}_boxes", box_plot(of_kind[kind], grouping))
    return writers
