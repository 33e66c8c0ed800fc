"""The figures of a report: what is drawn of the methods that were measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.config import EvalConfig
from shapefit.evaluation import figures as f
from shapefit.evaluation import report
from shapefit.evaluation.metrics import SHARE
from shapefit.evaluation.page import PageFigure
from shapefit.evaluation.report import ALIGNED, ALL, NORMALISED, Document, Quantity
from shapefit.evaluation.units import ShownUnit
from shapefit.pipelines.evaluate.examples import MethodExamples, choose_examples
from shapefit.pipelines.evaluate.measure import MatchedResults, MethodErrors
from shapefit.records import Shapes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CAPTIONS = {
    "errors": (
        "Boxes hold half of the images, with the median as the thick line and the mean"
        " over images as ◆; whiskers go from 5% to 95%. Curves show the share of all"
        " images whose error is smaller, in the same colours; one further left and"
        " higher is better, and one that ends below 100% has failed images."
    ),
    "sequences": (
        "Mean error of each sequence; at the end, set apart, the mean over the"
        " sequences, as in the table."
    ),
    "landmarks": (
        "Mean over all images of the distance of each landmark from the truth, after"
        " the shape as a whole was aligned. The drawn shape is a true one of usual"
        " form, with the errors of {method} as colours; dark is far off."
    ),
    "examples": (
        "Images of {method}. Each has three parts: the landmarks that were given;"
        " the shape seen from the camera; and the same from its side, which the"
        " camera did not see. Grey is the truth, blue the estimate after alignment,"
        " orange the distance between them."
    ),
    "bars": (
        "Of error bars that state 90%, 90% of the true landmarks should lie inside: on"
        " the grey line bars are right, above it they are wider than need be, below it"
        " too narrow. Counted over all landmarks of all images."
    ),
}
"""What is said below each figure."""

FIGURE_FORMATS = ("svg", "png", "pdf")
"""Formats in which figures lie beside the page."""


class Figures(NamedTuple):
    """The figures of the page, and the files beside it by name."""

    of_page: tuple[PageFigure, ...]
    files: Mapping[str, bytes]


class _Shown(NamedTuple):
    """The metric and unit of the error that figures show, and the unit for people."""

    quantity: Quantity
    unit: ShownUnit


def draw_figures(
    document: Document,
    methods: Mapping[str, MethodErrors],
    matched: MatchedResults,
    truth: Shapes,
    config: EvalConfig,
) -> Figures:
    """Draw the figures of a report, those that its results allow.

    matched are the results of the first method, of which examples are shown.
    """
    shown = _shown_error(document)
    with f.style():
        drawn = _draw(document, methods, matched, truth, shown)
        svg = {name: f.figure_bytes(figure, "svg") for name, figure in drawn.items()}
        files = {}
        for name, figure in drawn.items():
            if config.plots == "svg":
                files[f"{name}.svg"] = f.on_white(svg[name])
            else:
                data = f.figure_bytes(figure, config.plots)
                files[f"{name}.{config.plots}"] = data
    first = next(iter(methods))
    of_page = tuple(
        PageFigure(name, text.decode(), CAPTIONS[name].format(method=first))
        for name, text in svg.items()
    )
    return Figures(of_page, files)


def _shown_error(document: Document) -> _Shown:
    """Return which error figures show: in the unit of the truth, after alignment.

    That is the normalised one where the truth states no unit, and the first error of
    the report where alignment was not measured.
    """
    quantities = [*dict.fromkeys((s.metric, s.unit) for s in document["summaries"])]
    errors = [one for one in quantities if one[1] != SHARE] or quantities
    aligned = [one for one in errors if one[0] == ALIGNED] or errors
    stated = [
        one for one in aligned if one[1] not in (NORMALISED, report.UNSTATED_UNIT)
    ]
    quantity = (stated or aligned)[0]
    return _Shown(quantity, report.shown_units(document)[quantity[1]])


def _draw(
    document: Document,
    methods: Mapping[str, MethodErrors],
    matched: MatchedResults,
    truth: Shapes,
    shown: _Shown,
) -> dict[str, Figure]:
    """Draw the figures of a report; return them by name, in their order.

    matched are the results of the first method, of which examples are shown; shown: the
    error that figures show.
    """
    unit = shown.unit.name
    names = [*methods]
    drawn = {"errors": f.draw_errors(_errors_by_group(document, methods, shown), unit)}
    means = _means_by_sequence(document, shown)
    if any(len(of) > 1 for group in means.values() for of in group.values()):
        drawn["sequences"] = f.draw_sequences(means, unit)
    if shown.quantity[0] == ALIGNED:
        error = shown.unit.factor * methods[names[0]].errors[shown.quantity]
        pictured = choose_examples(names[0], matched, truth, error, unit)
        if pictured is not None:
            drawn["landmarks"] = _draw_landmarks(document, methods, pictured, shown)
            drawn["examples"] = f.draw_examples(pictured.examples, pictured.edges)
    coverage = {
        name: measured.bars.coverage(f.LEVELS)
        for name, measured in methods.items()
        if measured.bars is not None and np.isfinite(measured.bars.square).any()
    }
    if coverage:
        drawn["bars"] = f.draw_bars(coverage)
    return drawn


def _errors_by_group(
    document: Document, methods: Mapping[str, MethodErrors], shown: _Shown
) -> dict[str, dict[str, Floats]]:
    """Return group -> method -> errors of images (n,), nan where an image failed."""
    members: dict[str, set[str]] = {}
    for summary in document["summaries"]:
        if summary.sequence is not None:
            members.setdefault(summary.group, set()).add(summary.sequence)
    groups: dict[str, dict[str, Floats]] = {}
    for group, sequences in members.items():
        of_group: dict[str, Floats] = {}
        for name, measured in methods.items():
            if shown.quantity not in measured.errors:
                continue
            is_member = np.isin(np.array(measured.sequences, str), [*sequences])
            errors = shown.unit.factor * measured.errors[shown.quantity][is_member]
            of_group[name] = errors[~np.isinf(errors)]
        groups[group] = of_group
    return groups


def _means_by_sequence(
    document: Document, shown: _Shown
) -> dict[str, dict[str, dict[str, float]]]:
    """Return group -> method -> sequence -> mean error, of named sequences."""
    means: dict[str, dict[str, dict[str, float]]] = {}
    for one in document["summaries"]:
        if (one.metric, one.unit) != shown.quantity or one.sequence in (None, ALL):
            continue
        if np.isnan(one.mean):
            continue
        of_method = means.setdefault(one.group, {}).setdefault(one.method, {})
        of_method[str(one.sequence)] = shown.unit.factor * one.mean
    return means


def _draw_landmarks(
    document: Document,
    methods: Mapping[str, MethodErrors],
    pictured: MethodExamples,
    shown: _Shown,
) -> Figure:
    """Draw the mean error of each landmark by each method, on a typical shape."""
    names = methods[pictured.method].landmarks.names
    means = {
        (one.method, one.part): shown.unit.factor * one.mean
        for one in document["landmarks"]
        if one.unit == shown.quantity[1]
    }
    errors = {
        method: np.array([means.get((method, name), np.nan) for name in names])
        for method in methods
    }
    return f.draw_landmarks(errors, names, pictured.typical, shown.unit.name)
