"""`eval`: results against the truth, image by image, summed up in tables and one plot."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from shapefit import __version__
from shapefit.config import EvalConfig
from shapefit.errors import counted, input_error, listed, parse_json, path_text, printable
from shapefit.evaluation import calibration, report
from shapefit.evaluation.calibration import image_shares
from shapefit.evaluation.metric_table import METRICS, SHARE
from shapefit.evaluation.plots import draws_plots, plots_left_out
from shapefit.evaluation.report import MOST_LISTED, Method, Report
from shapefit.evaluation.summaries import (
    NORMALISED,
    ImageErrors,
    group_sequences,
    labels_of,
    summarise,
)
from shapefit.io import open_shapes, read_results
from shapefit.io.atomic import check_folder, digests, staged_files
from shapefit.io.csv_file import per_image_header, per_image_rows
from shapefit.io.detect import detect_format
from shapefit.io.formats import check_holds
from shapefit.io.layout import FRAME
from shapefit.io.options import input_options
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.pipelines.evaluate.judge import Judged, Truth, join, judge, with_shapes_of
from shapefit.pipelines.items import keys_of
from shapefit.pipelines.outcome import Failure, Outcome

AT_A_TIME = 1 << 14
"""True shapes that are read at a time for their names, and to count what they lack."""

ERROR_BARS = "error_bars.json"
"""File of the report that `prior.calibration` of fit takes."""

PLOT = "errors.png"


def run(config: EvalConfig) -> Iterator[Outcome]:
    """Judge every result file, then write the tables and the plot to the output folder.

    One outcome a result file, with the images that failed, and a last one with the errors in a few
    lines as its note. One result file at a time is in memory, with the true shapes of its images,
    and the errors of all images; rows of per_image.csv are written as files are judged. The folder
    has nothing new before all is written. Raises InputError for files that cannot be read or
    compared, images that leave every metric undefined, groups that no sequence belongs to, an
    output folder that cannot be written, and plots that are asked for without matplotlib.
    """
    draws = draws_plots(config.plots)
    check_folder(config.output)
    methods: dict[str, list[Judged]] = {name: [] for name in config.results}
    with open_truth(config) as (truth, lacks), staged_files(config.output) as folder:
        inputs = digests(config.truth)
        yield Outcome(warnings=tuple(lacks))
        warnings = dict.fromkeys(lacks)
        with folder.opened("per_image.csv") as write:
            write(per_image_header())
            for name, file in ((key, file) for key in methods for file in config.results[key]):
                results = with_shapes_of(read_any(file), truth.head.landmark_names)
                judged = judge(file, results, truth, config)
                _check_distinct(judged, methods[name])
                methods[name].append(judged)
                for errors in (*judged.image_errors(name), *bar_shares(name, judged)):
                    for rows in per_image_rows(errors):
                        write(rows)
                training = seen_in_training(name, results.attributes, inputs)
                new = [w for w in (*training, *judged.warnings) if w not in warnings]
                warnings |= dict.fromkeys(new)
                failed = ((item, f"{name}: {why}") for item, why in judged.failures.items())
                yield Outcome(
                    done=len(judged.items),
                    failures=tuple(Failure(item, why) for item, why in failed),
                    warnings=tuple(new),
                    note=name,
                )
        inputs |= digests(file for files in config.results.values() for file in files)
        found, every, ungrouped = sum_up(config, methods, [*warnings], inputs)
        contents = _contents(found, _drawn(every) if draws else None)
        for name, content in contents.items():
            with folder.opened(name) as write:
                write(content)
    yield Outcome(
        warnings=(*ungrouped, *plots_left_out(config.plots)),
        note="\n".join(report.short_lines(found)),
        written=tuple(config.output / name for name in ("per_image.csv", *contents)),
        data=lambda: json.loads(report.report_json(found)),
    )


def read_any(file: Path) -> ResultSet:
    """Read a result, or shapes in any format, such as TRC, as one without anything beside them."""
    known = detect_format(file)
    if known.read_poses is None:
        check_holds(file, "result", known)
        return read_results(file)
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
    methods: Mapping[str, Sequence[Judged]],
    warnings: Sequence[str],
    inputs: Mapping[str, str],
) -> tuple[Report, list[ImageErrors], list[str]]:
    """Sum up what was judged, method by method, over sequences and groups.

    Returns the report, the errors of all methods, and warnings about the groups. Raises InputError
    where nothing was measured, and where no sequence is in any group.
    """
    whole = {name: join(judged) for name, judged in methods.items()}
    errors = [each for name, judged in whole.items() for each in judged.image_errors(name)]
    if not errors:
        nothing = f"no image has anything to judge in {', '.join(config.metrics)}"
        raise input_error("metrics", nothing, "add `similarity`, which every shape has")
    sequences = (name for each in errors for name in each.sequences.names)
    grouping, ungrouped = group_sequences(config.groups, sequences)
    bars = {name: judged.bars for name, judged in whole.items() if judged.bars is not None}
    found = Report(
        methods=tuple(_method(name, whole[name], judged) for name, judged in methods.items()),
        summaries=tuple(s for each in errors for s in summarise(each, grouping)),
        warnings=tuple(map(printable, (*warnings, *ungrouped))),
        coverage=tuple(
            c for name, own in bars.items() for c in calibration.cover(name, own, grouping)
        ),
        factors={name: calibration.widening_factors(own) for name, own in bars.items()},
        provenance={
            "version": __version__,
            "config": json.loads(config.as_json()),
            "inputs": inputs,
        },
    )
    return found, errors, ungrouped


@contextmanager
def open_truth(config: EvalConfig) -> Iterator[tuple[Truth, list[str]]]:
    """Open the true shapes, and give a warning about what is unknown of them.

    Raises InputError as `open_shapes` does.
    """
    with open_shapes(config.truth, input_options(config), gaps=True) as source:
        gaps = Counter[str]()

        def counting() -> Iterator[ShapeSet]:
            for part in source.batches(AT_A_TIME, by_file=True):
                unknown = np.asarray(np.isnan(part.shapes).any(axis=1))
                gaps["shapes"] += int(unknown.any(axis=1).sum())
                gaps["landmarks"] += int(unknown.sum())
                yield part

        keys = keys_of(counting())
        landmarks, shapes = gaps["landmarks"], gaps["shapes"]
        number = f"{counted(landmarks, 'landmark')} of {counted(shapes, 'shape')}"
        lacks = [f"the truth lacks {number} (NaN): left out"] if shapes else []
        yield Truth(source.head, keys, source.take), lacks


def bar_shares(method: str, judged: Judged) -> list[ImageErrors]:
    """Return the share of landmarks inside the 90% error bars, of each image that has some."""
    if judged.bars is None:
        return []
    rows, shares = image_shares(judged.bars)
    items = [judged.items[row] for row in rows.tolist()]
    sequences = labels_of([judged.sequences[row] for row in rows.tolist()])
    return [ImageErrors(method, calibration.INSIDE, SHARE, items, sequences, shares)]


def seen_in_training(
    method: str, attributes: Mapping[str, object], truth: Mapping[str, str]
) -> list[str]:
    """Warn where a file of the truth is one that the dictionary learned from, by their digests.

    A fit with `leave_one_out` ignores, in each image, the atoms of the shape that it shows.
    """
    training = _stated(attributes, "training_inputs").values()
    same = [file for file, digest in truth.items() if digest in training]
    if not same or _stated(attributes, "config").get("leave_one_out"):
        return []
    return [
        f"{method}: the dictionary was learned from the truth, {listed(same, 'and')}, so these are "
        "errors on shapes that it has seen: give shapes that took no part in learning"
    ]


def _stated(attributes: Mapping[str, object], name: str) -> Mapping[str, Any]:
    """Return the JSON object that an attribute of a result holds; an empty one without."""
    try:
        return parse_json(attributes.get(name, "{}"))
    except ValueError:
        return {}


def _check_distinct(judged: Judged, before: Sequence[Judged]) -> None:
    """Raise InputError where an earlier file of the method has the same item."""
    items = set(judged.items) if before else set()
    for other in before:
        if same := items.intersection(other.items):
            item = next(item for item in judged.items if item in same)
            found = f"has the item '{item}', which {other.file} has too"
            fix = "give each file a unique name in `results`, or leave one out"
            raise input_error(judged.file, found, fix)


def _method(name: str, whole: Judged, files: Sequence[Judged]) -> Method:
    return Method(
        name=name,
        files=tuple(path_text(each.file) for each in files),
        images=len(whole.items),
        failures=dict(islice(whole.failures.items(), MOST_LISTED)),
        solving=report.sum_up_runs([each.run for each in files]),
        unlisted=max(len(whole.failures) - MOST_LISTED, 0),
    )


def _contents(found: Report, plot: bytes | None) -> dict[str, bytes]:
    """Return the files of the report by name."""
    blocks = report.report_blocks(found)
    texts = {"report.csv": report.report_csv(found), "report.json": report.report_json(found)}
    if found.factors:
        texts[ERROR_BARS] = json.dumps(found.factors)
    if plot is not None:
        blocks += ["## Plot", f"![errors, sorted]({PLOT})"]
    texts["report.md"] = report.as_markdown(blocks)
    contents = {name: text.encode("utf-8", "xmlcharrefreplace") for name, text in texts.items()}
    return contents | ({} if plot is None else {PLOT: plot})


def _drawn(errors: Sequence[ImageErrors]) -> bytes:
    """Draw the first metric of all methods, normalised where it is that, too."""
    from shapefit.evaluation.plots import draw_errors, save

    metric = next((e.metric for e in errors if not METRICS[e.metric].of_labels), errors[0].metric)
    of_metric = [each for each in errors if each.metric == metric]
    units = {each.unit for each in of_metric}
    unit = NORMALISED if NORMALISED in units else of_metric[0].unit
    drawing = BytesIO()
    save(draw_errors([each for each in of_metric if each.unit == unit]), drawing, "png")
    return drawing.getvalue()
