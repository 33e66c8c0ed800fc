"""`eval`: results against the truth, image by image, summed up in tables and one plot."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shapefit import __version__
from shapefit.arrays import Floats
from shapefit.config import EvalConfig
from shapefit.errors import counted, input_error, listed, parse_json, path_text, printable
from shapefit.evaluation import calibration, report
from shapefit.evaluation.metrics import METRICS, SHARE
from shapefit.evaluation.plots import draw_errors
from shapefit.evaluation.report import Method, Report
from shapefit.evaluation.summaries import NORMALISED, group_sequences, members_of, summarise
from shapefit.geometry.normalisation import LARGEST
from shapefit.io import open_shapes
from shapefit.io.atomic import check_folder, digests, staged_files
from shapefit.io.detect import detect_format
from shapefit.io.formats import check_holds
from shapefit.io.layout import FRAME
from shapefit.io.listing import OPTIONAL
from shapefit.io.options import input_options
from shapefit.io.records import ResultSet
from shapefit.io.source import open_results
from shapefit.pipelines.evaluate.measure import Measured, Truth, join, measure, with_shapes_of
from shapefit.pipelines.items import keys_of
from shapefit.pipelines.outcome import Failure, Outcome

ERROR_BARS = "error_bars.json"
"""File of the report that `prior.calibration` of fit takes."""
PLOT = "errors.svg"
READ = {"status", "objective", "scale", "shape_sd"}
READ |= {dataset.name for metric in METRICS.values() for dataset in metric.needs}
"""Datasets of results that are read, beside those that every result has."""
INSIDE = f"inside_{100 * calibration.WIDTH_OF:.0f}"
"""What the share of the landmarks of an image that are inside their error bars is called."""


def run(config: EvalConfig) -> Iterator[Outcome]:
    """Measure every result file, then write the tables and the plot to the output folder.

    One outcome a result file, with the images that failed, and a last one with the errors in a few
    lines as its note. The true shapes, one result file at a time and the errors of all images are
    in memory. The folder has nothing new before all is written. Raises InputError for files that
    cannot be read or compared, images that leave every metric undefined, groups that no sequence
    belongs to, and an output folder that cannot be written.
    """
    check_folder(config.output)
    truth, gaps = read_truth(config)
    yield Outcome(warnings=gaps)
    inputs, warnings = digests(config.truth), dict.fromkeys(gaps)
    methods: dict[str, list[Measured]] = {name: [] for name in config.results}
    with staged_files(config.output) as folder:
        with (folder / "per_image.csv").open("wb") as per_image:
            per_image.write(f"{','.join(report.PER_IMAGE)}\n".encode())
            for name, file in ((key, file) for key in methods for file in config.results[key]):
                results = with_shapes_of(read_any(file), truth.shapes.landmark_names)
                measured = measure(file, results, truth, config)
                _check_distinct(measured, methods[name])
                methods[name].append(measured)
                errors = dict(measured.errors)
                if measured.bars is not None:
                    shares = measured.bars.shares()
                    errors[INSIDE, SHARE] = np.where(np.isnan(shares), np.inf, shares)
                for rows in report.per_image_rows(name, measured.sequences, measured.items, errors):
                    per_image.write(rows)
                training = used_in_training(name, results.attributes, inputs)
                new = [w for w in (*training, *measured.warnings) if w not in warnings]
                warnings |= dict.fromkeys(new)
                yield Outcome(
                    done=len(measured.items),
                    failures=tuple(
                        Failure(item, f"{name}: {why}") for item, why in measured.failures.items()
                    ),
                    warnings=tuple(new),
                    note=name,
                )
        inputs |= digests(file for files in config.results.values() for file in files)
        joined = {name: join(files) for name, files in methods.items()}
        summed, ungrouped = sum_up(config, joined, [*warnings], inputs)
        contents = {"report.csv": report.report_csv(summed)}
        contents["report.json"] = report.report_json(summed)
        if summed.factors:
            contents[ERROR_BARS] = json.dumps(summed.factors)
        contents["report.md"] = report.report_markdown(summed, PLOT if config.plots else "")
        if config.plots:
            contents[PLOT] = _plot(summed, joined)
        for name, content in contents.items():
            (folder / name).write_bytes(content.encode("utf-8", "xmlcharrefreplace"))
    yield Outcome(
        warnings=tuple(ungrouped),
        note="\n".join(report.short_lines(summed)),
        written=tuple(config.output / name for name in ("per_image.csv", *contents)),
        data=lambda: json.loads(contents["report.json"]),
    )


def read_truth(config: EvalConfig) -> tuple[Truth, tuple[str, ...]]:
    """Read the true shapes; return them and a warning about what they lack."""
    with open_shapes(config.truth, input_options(config), gaps=True) as source:
        shapes = source.whole()
    unknown = np.isnan(shapes.shapes.sum(axis=1))
    lacking = int(np.count_nonzero(unknown.any(axis=1)))
    number = f"{counted(int(unknown.sum()), 'landmark')} of {counted(lacking, 'shape')}"
    gaps = (f"the truth lacks {number} (NaN): left out",) if lacking else ()
    return Truth(shapes, keys_of([shapes])), gaps


def read_any(file: Path) -> ResultSet:
    """Read a result, or shapes in any format, such as TRC, as one without anything beside them."""
    known = detect_format(file)
    if known.read_poses is None:
        check_holds(file, "result", known)
        with open_results([file], OPTIONAL - READ) as results:
            return results.whole()
    with open_shapes([file], gaps=True) as source:
        shapes = source.whole()
    return ResultSet(
        shapes.shapes,
        shapes.landmark_names,
        shapes.items,
        shapes.sequences,
        unit=shapes.unit,
        frame_rate=shapes.frame_rate,
        columns={name: values for name, values in shapes.per_item.items() if name == FRAME},
    )


def sum_up(
    config: EvalConfig,
    methods: Mapping[str, Measured],
    warnings: Sequence[str],
    inputs: Mapping[str, str],
) -> tuple[Report, list[str]]:
    """Sum up the errors, method by method, over sequences and groups; and warn about groups.

    Raises InputError where nothing was measured, and where no sequence is in any group.
    """
    if all(np.isinf(v).all() for each in methods.values() for v in each.errors.values()):
        nothing = f"no image has anything to judge in {', '.join(config.metrics)}"
        raise input_error("metrics", nothing, "add `similarity`, which every shape has")
    sequences = (name for measured in methods.values() for name in measured.sequences)
    grouping, ungrouped = group_sequences(config.groups, sequences)
    bars = {name: measured.bars for name, measured in methods.items() if measured.bars}
    summed = Report(
        methods=tuple(
            Method(
                name=name,
                files=tuple(map(path_text, measured.files)),
                images=len(measured.items),
                failures=measured.failures,
                mean_objective=_mean_objective(measured.objective),
            )
            for name, measured in methods.items()
        ),
        summaries=tuple(
            summary
            for name, measured in methods.items()
            for summary in summarise(name, measured.sequences, measured.errors, grouping)
        ),
        warnings=tuple(map(printable, (*warnings, *ungrouped))),
        coverage=tuple(
            row
            for name, own in bars.items()
            for row in calibration.cover(name, own, members_of(methods[name].sequences, grouping))
        ),
        factors={name: calibration.bar_scale_factors(own) for name, own in bars.items()},
        provenance={
            "version": __version__,
            "config": json.loads(config.as_json()),
            "inputs": inputs,
        },
    )
    return summed, ungrouped


def _mean_objective(objective: Floats | None) -> float | None:
    """Mean of the objectives (n,) that are numbers; None of none."""
    finite = np.empty(0) if objective is None else objective[np.abs(objective) <= LARGEST]
    return float(finite.mean()) if len(finite) else None


def used_in_training(
    method: str, attributes: Mapping[str, Any], truth: Mapping[str, str]
) -> list[str]:
    """Warn where a file of the truth is one that the dictionary learned from, by their digests.

    A fit with `leave_one_out` ignores, in each image, the atoms of the shape that it shows.
    """
    try:
        training, config = (
            parse_json(attributes.get(name, "{}")) for name in ("training_inputs", "config")
        )
    except ValueError:
        return []
    same = [file for file, digest in truth.items() if digest in training.values()]
    if not same or config.get("leave_one_out"):
        return []
    return [
        f"{method}: the dictionary was learned from the truth, {listed(same, 'and')}, so these are "
        "errors on shapes that it has seen: give shapes that took no part in learning"
    ]


def _check_distinct(measured: Measured, before: Sequence[Measured]) -> None:
    """Raise InputError where an earlier file of the method has the same item."""
    for other in before:
        if same := set(measured.items).intersection(other.items):
            found = f"has the item '{min(same)}', which {other.files[0]} has too"
            fix = "give each file a unique name in `results`, or leave one out"
            raise input_error(measured.files[0], found, fix)


def _plot(summed: Report, methods: Mapping[str, Measured]) -> str:
    """Draw the first metric that is an error, normalised if it is a length."""
    kinds = [(s.metric, s.unit) for s in summed.summaries]
    metric, unit = next((k for k in kinds if not METRICS[k[0]].of_labels), kinds[0])
    unit = NORMALISED if (metric, NORMALISED) in kinds else unit
    errors = {name: m.errors.get((metric, unit)) for name, m in methods.items()}
    finite = {name: v[~np.isinf(v)] for name, v in errors.items() if v is not None}
    return draw_errors(METRICS[metric].title, unit, finite)
