"""`eval`: results against the truth, image by image, summed up in tables and plots."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from shapefit import __version__
from shapefit.config import EvalConfig, ViewConfig
from shapefit.errors import InputError, counted, input_error, listed, path_text, printable
from shapefit.evaluation import calibration, report
from shapefit.evaluation.calibration import ErrorBars, image_shares
from shapefit.evaluation.metric_table import METRICS, SHARE
from shapefit.evaluation.plots import draws_plots, plots_left_out
from shapefit.evaluation.report import (
    MOST_LISTED,
    Method,
    Report,
    as_markdown,
    report_blocks,
    report_json,
)
from shapefit.evaluation.summaries import (
    NORMALISED,
    ImageErrors,
    group_sequences,
    keep_plausible,
    labels_of,
    summarise,
)
from shapefit.io import open_shapes, read_results
from shapefit.io.atomic import check_folder, digests, staged_files
from shapefit.io.csv_file import per_image_header, per_image_rows
from shapefit.io.options import input_options
from shapefit.io.records import ShapeSet
from shapefit.pipelines.evaluate.judge import Judged, Truth, join, judge, with_shapes_of
from shapefit.pipelines.items import keys_of
from shapefit.pipelines.outcome import Failure, Outcome
from shapefit.viewer.report_page import Links, report_page

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AT_A_TIME = 1 << 14
"""True shapes that are read at a time for their names, and to count what they lack."""

MOST_FAILURES = 200
"""Failed items a method that the page lists; its JSON lists more."""

MOST_VIEWED = 300_000
"""Images, and true shapes, that the page of the viewer beside the report is made of, at most."""

RANKED = 12
"""Worst, median and best images of a method, each so many, that the page leads to."""

ERROR_BARS = "error_bars.json"
"""File of the report that `prior.calibration` of fit takes."""

VIEW = "view.html"


def run(config: EvalConfig) -> Iterator[Outcome]:
    """Judge every result file, then write the tables and plots to the output folder.

    One outcome a result file, with the images that failed, and a last one with the Markdown
    tables as its note. One result file at a time is in memory, with the true shapes of its images,
    and the errors of all images; rows of per_image.csv are written as files are judged. The folder
    has nothing new before all is written. Raises InputError for
    files that cannot be read or compared, images that leave every metric undefined, groups that no
    sequence belongs to, an output folder that cannot be written, and plots that are asked for
    without matplotlib.
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
                results = with_shapes_of(read_results(file), truth.head.landmark_names)
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
        found = sum_up(config, methods, [*warnings], inputs)
        contents, left_out = _contents(config, found, len(truth), draws=draws)
        for name, content in contents.items():
            with folder.opened(name) as write:
                write(content)
    yield Outcome(
        warnings=(*found.ungrouped, *plots_left_out(config.plots), *left_out),
        note=as_markdown(report_blocks(found.report)).rstrip(),
        written=tuple(config.output / name for name in ("per_image.csv", *contents)),
        data=lambda: json.loads(report_json(found.report)),
    )


class SummedUp(NamedTuple):
    """The report, and what is drawn: errors, their groups, error bars by method and by group."""

    report: Report
    errors: list[ImageErrors]
    grouping: Mapping[str, Sequence[str]]
    ungrouped: list[str]
    bars: Mapping[str, ErrorBars]
    grouped_bars: Mapping[tuple[str, str], ErrorBars]


def sum_up(
    config: EvalConfig,
    methods: Mapping[str, Sequence[Judged]],
    warnings: Sequence[str],
    inputs: Mapping[str, str],
) -> SummedUp:
    """Sum up what was judged, method by method, over sequences and groups.

    Raises InputError where nothing was measured, and where no sequence is in any group.
    """
    whole = {name: join(judged) for name, judged in methods.items()}
    errors = [each for name, judged in whole.items() for each in judged.image_errors(name)]
    if not errors:
        nothing = f"no image has anything to judge in {', '.join(config.metrics)}"
        raise input_error("metrics", nothing, "add `similarity`, which every shape has")
    sequences = (name for each in errors for name in each.sequences.names)
    grouping, ungrouped = group_sequences(config.groups, sequences)
    bars = {name: judged.bars for name, judged in whole.items() if judged.bars is not None}
    grouped_bars = {
        (name, group): own
        for name, every in bars.items()
        for group, own in calibration.by_group(every, grouping).items()
    }
    plausible = [e for e in errors if not METRICS[e.metric].of_labels]
    found = Report(
        methods=tuple(_method(name, whole[name], judged) for name, judged in methods.items()),
        summaries=tuple(s for each in errors for s in summarise(each, grouping)),
        warnings=tuple(map(printable, (*warnings, *ungrouped))),
        coverage=tuple(
            each for key, own in grouped_bars.items() for each in calibration.cover(*key, own)
        ),
        kept=tuple(kept for each in plausible for kept in keep_plausible(each, grouping)),
        without_bars=tuple(name for name in methods if name not in bars),
        parallel=tuple(name for name, own in bars.items() if own.parallel),
        provenance={
            "version": __version__,
            "config": json.loads(config.as_json()),
            "inputs": inputs,
        },
    )
    return SummedUp(found, errors, grouping, ungrouped, bars, grouped_bars)


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


def rank(errors: ImageErrors) -> dict[str, list[int]]:
    """Return rows of the worst, median and best images, worst first; all where they are few.

    Those of equal errors are in their order.
    """
    known = np.flatnonzero(~np.isnan(errors.values))
    falling = known[np.argsort(-errors.values[known], kind="stable")].tolist()
    if len(falling) <= 3 * RANKED:
        return {"all images, worst first": falling}
    middle = (len(falling) - RANKED) // 2
    return {
        "worst": falling[:RANKED],
        "median": falling[middle : middle + RANKED],
        "best": falling[-RANKED:],
    }


def _stated(attributes: Mapping[str, object], name: str) -> Mapping[str, Any]:
    """Return the JSON object that an attribute of a result holds; an empty one without."""
    try:
        found = json.loads(str(attributes.get(name, "{}")))
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


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


def _contents(
    config: EvalConfig, found: SummedUp, shapes: int, *, draws: bool
) -> tuple[dict[str, bytes], tuple[str, ...]]:
    """Return the files of the report by name, and why the viewer is not among them."""
    texts = report.write_tables(found.report)
    if found.bars:
        factors = {name: calibration.widening_factors(own) for name, own in found.bars.items()}
        texts[ERROR_BARS] = json.dumps(factors)
    contents = {name: text.encode("utf-8") for name, text in texts.items()}
    figures = _figures(found) if draws else {}
    drawings = {f"{n}.{form}": _drawn(figures[n], form) for n in figures for form in FORMATS}
    view, links, left_out = _view(config, shapes, found.errors)
    blocks = report_blocks(found.report, MOST_FAILURES)
    page = report_page(
        [*blocks, *_pictures(figures, "svg")],
        drawings={name: drawing for name, drawing in drawings.items() if name.endswith(".svg")},
        provenance=found.report.provenance,
        view=VIEW if view else None,
        links=links,
    )
    pages = {"report.md": as_markdown([*blocks, *_pictures(figures, "png")]), "report.html": page}
    for name, text in pages.items():
        contents[name] = text.encode("utf-8", "xmlcharrefreplace")
    return contents | drawings | ({VIEW: view} if view else {}), left_out


FORMATS = ("png", "svg")


def _figures(found: SummedUp) -> dict[str, Figure]:
    """Draw each metric once, as bars and boxes: what is also in the unit of the truth, normalised.

    Images in no group are in neither. And the error bars, where a method has some.
    """
    from shapefit.evaluation.plots import draw_bars, draw_boxes, draw_calibration

    drawn: dict[str, tuple[str, str]] = {}
    of_kind = report.by_kind(found.errors)
    for metric, unit in of_kind:
        if metric not in drawn or unit == NORMALISED:
            drawn[metric] = metric, unit
    summed_up = report.by_kind(found.report.summaries)
    figures = {}
    for metric, kind in drawn.items():
        if kind in summed_up:
            figures[metric] = draw_bars(summed_up[kind])
            figures[f"{metric}_boxes"] = draw_boxes(of_kind[kind], found.grouping)
    if found.grouped_bars:
        curves = {key: calibration.curve(own) for key, own in found.grouped_bars.items()}
        figures["calibration"] = draw_calibration(found.report.coverage, curves)
    return figures


def _drawn(figure: Figure, form: str) -> bytes:
    from shapefit.evaluation.plots import save

    drawing = BytesIO()
    save(figure, drawing, form)
    return drawing.getvalue()


def _pictures(names: Iterable[str], form: str) -> list[str]:
    """Return the plots as a section; every viewer of Markdown can show PNG."""
    plots = [f"![{name.replace('_', ' ')}]({name}.{form})" for name in names]
    return ["## Plots", *plots] if plots else []


def _view(
    config: EvalConfig, shapes: int, errors: Sequence[ImageErrors]
) -> tuple[bytes | None, Links, tuple[str, ...]]:
    """Return the page of the viewer, links to the ranked images in it, or why there is none.

    Each method is ranked by its first metric; outlier labels are none.
    """
    files = [file for own in config.results.values() for file in own]
    if not config.view or not all(file.is_file() for file in (*config.truth, *files)):
        return None, {}, ()
    first: dict[str, ImageErrors] = {}
    for each in errors:
        if not METRICS[each.metric].of_labels:
            first.setdefault(each.method, each)
    most = max([shapes, *(len(each.values) for each in errors)])
    if most > MOST_VIEWED:
        why = f"{most:,} images or shapes are more than the {MOST_VIEWED:,} that it is made of"
        return None, {}, (f"{VIEW} is left out: {why}; `shapefit view` shows a file of them",)
    ranked = {
        f"{name}: {kind}": [
            (each.items[row], f"{each.metric} {each.values[row]:.4g} {each.unit}") for row in rows
        ]
        for name, each in first.items()
        for kind, rows in rank(each).items()
    }
    from shapefit.pipelines.view.run import make_page

    shown = ViewConfig(
        files=config.results,
        truth=config.truth,
        match=config.match,
        rename=config.rename,
    )
    try:
        page = make_page(shown, {item for images in ranked.values() for item, _ in images})
    except InputError as error:
        return None, {}, (f"{VIEW} is left out: {'; '.join(error.problems)}",)
    there = set(page.scene.items)
    kept = {heading: [i for i in images if i[0] in there] for heading, images in ranked.items()}
    return page.html, {heading: images for heading, images in kept.items() if images}, ()
