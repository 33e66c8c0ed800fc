"""`eval`: results against the truth, image by image, in tables, a page and figures."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import orjson

from shapefit import __version__
from shapefit.arrays import evenly, finite_median
from shapefit.config import EvalConfig
from shapefit.errors import input_error, listed, parse_json, path_text, printable
from shapefit.evaluation import report
from shapefit.evaluation.calibration import (
    WIDTH_SHARE,
    WIDTH_SQUARED_RADIUS,
    ErrorBars,
    bar_scale_factors,
    summarise_coverage,
)
from shapefit.evaluation.metrics import METRICS, SHARE
from shapefit.evaluation.page import PageFacts, report_page
from shapefit.geometry.normalisation import MAX_COORDINATE
from shapefit.io import open_shapes
from shapefit.io.atomic import check_folder, digests, staged_files, storage_errors
from shapefit.io.csv_rows import format_rows
from shapefit.io.detect import detect_format
from shapefit.io.formats import check_our_format
from shapefit.io.layout import OF_FILE
from shapefit.io.options import input_options
from shapefit.io.source import (
    OPTIONAL_DATASETS,
    ResultSource,
    ShapeSource,
    open_results,
)
from shapefit.pipelines.evaluate.drawing import (
    CAPTIONS,
    FIGURE_FORMATS,
    Figures,
    draw_figures,
)
from shapefit.pipelines.evaluate.measure import (
    MatchedResults,
    MethodErrors,
    match_results,
    measure_matched,
    with_shapes_of,
)
from shapefit.pipelines.result import Failure, Note, Numbers, Result
from shapefit.pipelines.unfinished import describe_unfinished
from shapefit.records import Fit, Shapes

ERROR_BARS_FILE = "error_bars.json"
"""File of the report that `prior.calibration` of fit takes."""

PER_IMAGE_FILE = "per_image.csv"
"""File of the report with the errors of all images."""

PER_ANGLE_FILE = "per_angle.csv"
"""File of the report with the errors of each joint angle, of people."""

PAGE_FILE = "report.html"
"""The page of the report."""

WITHOUT_MATPLOTLIB = (
    "The report has no figures, which need matplotlib: pip install matplotlib (or leave"
    " them out: plots: none)"
)
"""Note where figures are wanted and cannot be drawn."""

SHAPES_FOR_EXTENT = 500
"""By which the page says how large the objects are."""

METRIC_COLUMNS = {dataset for metric in METRICS.values() for dataset in metric.needs}
METRIC_COLUMNS |= {"status", "objective", "scale", "shape_sd", "landmarks", "edges"}
"""Datasets of results that metrics and the report need."""

SKIPPED_COLUMNS = (OPTIONAL_DATASETS - METRIC_COLUMNS) | OF_FILE.keys()
"""Datasets that no metric needs: they may differ between the files of a method."""


def evaluate_results(config: EvalConfig) -> Iterator[Result]:
    """Measure the results of every method, then write tables, page and figures.

    At first how many images there are, then one result a method, with the images that
    failed, and a last one with the errors in a few lines as its note. The folder has
    nothing new before all is written. Raises InputError for files that cannot be read
    or compared, images that leave every metric undefined, groups that no sequence
    belongs to, and an output folder that cannot be written.
    """
    check_folder(config.output)
    with open_shapes(config.truth, input_options(config), gaps=True) as source:
        truth = source.whole()
    inputs = digests(config.truth)
    every_file = [file for files in config.results.values() for file in files]
    warnings = [*describe_unfinished(every_file)]
    methods: dict[str, MethodErrors] = {}
    draws = config.plots != "none" and not _lacks_matplotlib(config)
    pictured: MatchedResults | None = None
    with ExitStack() as open_files:
        sources: dict[str, ResultSource | ShapeSource] = {}
        for name, files in config.results.items():
            sources[name] = open_method(files)
            open_files.callback(sources[name].close)
        total = sum(source.count for source in sources.values())
        yield Result(total=total, warnings=tuple(warnings))
        for name, opened in sources.items():
            file = config.results[name][0]
            results = with_shapes_of(read_whole(opened), truth.landmark_names)
            matched = match_results(file, results, truth, config)
            measured = measure_matched(file, matched, truth, config)
            if draws and not methods:
                pictured = matched
            methods[name] = measured
            doubts = warn_of_training_on_truth(name, results.attributes, inputs)
            new = [*doubts, *measured.warnings]
            warnings += new
            failures = [
                Failure(item, f"{name}: {reason}")
                for item, reason in measured.failures.items()
            ]
            yield Result(
                done=len(measured.items),
                failures=tuple(failures),
                warnings=tuple(new),
                note=name,
            )
    inputs |= digests(every_file)
    document = make_document(config, methods, warnings, inputs)
    figures = Figures((), {})
    if pictured is not None:
        figures = draw_figures(document, methods, pictured, truth, config)
    texts = _report_texts(document, methods, truth, figures, config)
    with staged_files(config.output) as folder, storage_errors(config.output, None):
        for name, text in texts.items():
            (folder / name).write_bytes(text.encode("utf-8", "xmlcharrefreplace"))
        write_per_image(folder / PER_IMAGE_FILE, methods)
        for name, data in figures.files.items():
            (folder / name).write_bytes(data)
    names = (*texts, PER_IMAGE_FILE, *figures.files)
    last_warnings = warn_of_earlier_files(config.output, names)
    if _lacks_matplotlib(config):
        last_warnings.append(Note(WITHOUT_MATPLOTLIB))
    yield Result(
        note="\n".join(report.short_lines(document)),
        warnings=tuple(last_warnings),
        written=tuple(config.output / name for name in names),
        numbers=eval_numbers(methods),
        data=lambda: json.loads(texts["report.json"]),
    )


def warn_of_earlier_files(folder: Path, written: Sequence[str]) -> list[str]:
    """Return a warning of files of an earlier report that this one has not replaced.

    folder: of the report; written: the names of its files.
    """
    optional = {PER_ANGLE_FILE, ERROR_BARS_FILE}
    optional |= {f"{name}.{kind}" for name in CAPTIONS for kind in FIGURE_FORMATS}
    others = optional.difference(written)
    earlier = sorted(name for name in others if (folder / name).exists())
    if not earlier:
        return []
    verb = "is" if len(earlier) == 1 else "are"
    names = listed(earlier, "and")
    return [
        f"{path_text(folder)}: {names} {verb} of an earlier report; delete old ones"
    ]


def _lacks_matplotlib(config: EvalConfig) -> bool:
    """Whether figures are wanted and cannot be drawn."""
    return config.plots != "none" and find_spec("matplotlib") is None


def eval_numbers(methods: Mapping[str, MethodErrors]) -> Numbers:
    """Return the number of images compared, and coverage of error bars by method."""
    images = sum(len(measured.items) for measured in methods.values())
    shares = {name: share_inside(measured.bars) for name, measured in methods.items()}
    return Numbers(images=images, share_inside_regions=shares)


def share_inside(bars: ErrorBars | None) -> float | None:
    """Return the share of landmarks inside their 90% regions, None without regions."""
    if bars is None:
        return None
    squares = bars.square[~np.isnan(bars.square)]
    return float((squares <= WIDTH_SQUARED_RADIUS).mean()) if len(squares) else None


def _report_texts(
    document: report.Document,
    methods: Mapping[str, MethodErrors],
    truth: Shapes,
    figures: Figures,
    config: EvalConfig,
) -> dict[str, str]:
    """Return file name -> text of the files of the report but per_image.csv."""
    options = orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE
    texts = {
        PAGE_FILE: "",
        "report.csv": report.report_csv(document),
        "report.json": orjson.dumps(document, option=options).decode(),
        "per_landmark.csv": report.parts_csv(document["landmarks"], "landmark"),
    }
    if document["angles"]:
        texts[PER_ANGLE_FILE] = report.parts_csv(document["angles"], "angle")
    if document["factors"]:
        texts[ERROR_BARS_FILE] = json.dumps(document["factors"])
    files = (*texts, PER_IMAGE_FILE, *figures.files)
    facts = PageFacts(
        extent=_usual_extent(truth),
        note=WITHOUT_MATPLOTLIB if _lacks_matplotlib(config) else "",
        files=[name for name in files if name != PAGE_FILE],
    )
    texts[PAGE_FILE] = report_page(document, figures.of_page, facts)
    return texts


def _usual_extent(truth: Shapes) -> float | None:
    """Return the median of the largest distances across true shapes along an axis."""
    some = truth.shapes[evenly(len(truth), SHAPES_FOR_EXTENT)]
    known = np.isfinite(some)
    highest = np.where(known, some, -np.inf).max(axis=1)
    lowest = np.where(known, some, np.inf).min(axis=1)
    extent = finite_median((highest - lowest).max(axis=1))
    return extent if extent > 0 else None


def open_method(files: Sequence[Path]) -> ResultSource | ShapeSource:
    """Open the files of a method: results, or shapes in any format, such as TRC."""
    file_format = detect_format(files[0])
    if file_format.read_poses is not None:
        return open_shapes(files, gaps=True)
    check_our_format(files[0], "result", file_format)
    return open_results(files, SKIPPED_COLUMNS)


def read_whole(source: ResultSource | ShapeSource) -> Fit:
    """Read all of a source as one Fit; of shapes, one that has nothing else."""
    record = source.whole()
    return record if isinstance(record, Fit) else Fit.of_shapes(record)


def warn_of_training_on_truth(
    method: str, attributes: Mapping[str, Any], truth: Mapping[str, str]
) -> list[str]:
    """Return a warning where the dictionary learned from a file of the truth.

    Files are compared by their digests. A fit with `leave_one_out` ignores, in each
    image, the atoms of the shape that it shows.
    """
    training = parse_json(attributes.get("training_inputs", "{}"))
    config = parse_json(attributes.get("config", "{}"))
    same = [file for file, digest in truth.items() if digest in training.values()]
    if not same or config.get("leave_one_out"):
        return []
    return [
        f"{method}: the dictionary was learned from the truth, {listed(same, 'and')},"
        " so these are errors on training shapes: give shapes that took no part in"
        " learning"
    ]


def make_document(
    config: EvalConfig,
    methods: Mapping[str, MethodErrors],
    warnings: Sequence[str],
    inputs: Mapping[str, str],
) -> report.Document:
    """Return the report: errors of each method, summed up over sequences and groups.

    Raises InputError where nothing was measured, and where no sequence is in any group.
    """
    every_error = [
        errors for measured in methods.values() for errors in measured.errors.values()
    ]
    if all(np.isinf(errors).all() for errors in every_error):
        nothing = f"no image has anything to measure in {', '.join(config.metrics)}"
        raise input_error("metrics", nothing, "add `similarity`, which every shape has")
    names = [name for measured in methods.values() for name in measured.sequences]
    grouping = report.group_sequences(config.groups, names)
    document: report.Document = {
        "methods": [],
        "summaries": [],
        "landmarks": [],
        "angles": [],
        "calibration": [],
        "factors": {},
        "warnings": [printable(warning) for warning in warnings],
        "version": __version__,
        "config": json.loads(config.as_json()),
        "inputs": dict(inputs),
    }
    for name, measured in methods.items():
        files = [path_text(file) for file in config.results[name]]
        document["methods"].append(_method_outcome(name, files, measured))
        document["summaries"] += report.summarise_errors(
            name, measured.sequences, measured.errors, grouping
        )
        document["landmarks"] += report.summarise_parts(name, *measured.landmarks)
        document["angles"] += report.summarise_parts(name, *measured.angles)
        if measured.bars is not None:
            document["calibration"] += summarise_coverage(
                name, measured.bars, measured.sequences, grouping
            )
            document["factors"][name] = bar_scale_factors(measured.bars)
    return document


def _method_outcome(
    name: str, files: list[str], measured: MethodErrors
) -> report.MethodOutcome:
    """Return the entry of a method in the report: files, images and failures."""
    mean_objective = None
    if measured.objective is not None:
        finite = measured.objective[np.abs(measured.objective) <= MAX_COORDINATE]
        if len(finite):
            mean_objective = float(finite.mean())
    return {
        "name": name,
        "method": measured.method,
        "files": files,
        "images": len(measured.items),
        "failures": [
            {"item": item, "reason": reason}
            for item, reason in measured.failures.items()
        ],
        "mean_objective": mean_objective,
        "failed": len(measured.failures),
    }


def write_per_image(path: Path, methods: Mapping[str, MethodErrors]) -> None:
    """Write the errors of all images, and the share of landmarks inside the error bars.

    That of a failed image is empty; one that does not count, which is infinite, has no
    row.
    """
    header = ("method", "sequence", "item", "metric", "error", "unit")
    with path.open("wb") as file:
        file.write(f"{','.join(header)}\n".encode())
        for name, measured in methods.items():
            for rows in _rows_per_image(name, measured):
                file.write(rows)


def _rows_per_image(name: str, measured: MethodErrors) -> Iterator[memoryview]:
    """Yield rows of CSV: method, sequence, item, metric, error, unit; by metric.

    They are many, one for each image and metric: what several share is quoted once.
    """
    errors = dict(measured.errors)
    if measured.bars is not None:
        coverage = measured.bars.coverage_by_image()
        inside = f"inside_{100 * WIDTH_SHARE:.0f}"
        errors[inside, SHARE] = np.where(np.isnan(coverage), np.inf, coverage)
    images = zip(measured.sequences, measured.items, strict=True)
    of_images = _csv_lines((name, sequence, item) for sequence, item in images)
    n = len(of_images)
    for (metric, unit), values in errors.items():
        counted = np.flatnonzero(values != np.inf)
        texts = [*of_images, *_csv_lines([(metric,), (unit,)])]
        cells = np.column_stack(
            [counted, np.full_like(counted, n), np.full_like(counted, n + 1)]
        )
        yield format_rows(
            texts, cells, values[counted, None], leading=2, as_python=True
        )


def _csv_lines(rows: Iterable[tuple[str, ...]]) -> list[bytes]:
    """Return rows as CSV, quoted where need be, without the ends of lines."""
    lines: list[str] = []
    table = csv.writer(SimpleNamespace(write=lines.append), lineterminator="\n")
    table.writerows(rows)
    return [line[:-1].encode("utf-8", "surrogateescape") for line in lines]
