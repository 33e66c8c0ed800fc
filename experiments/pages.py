"""What the paper states set beside what was measured: in reports of `eval`, and in an
index.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from ruamel.yaml import YAML

import shapefit
from benchmarks import optimality
from benchmarks.lower_bounds import oracle_rows
from experiments.car_bodies import ERRORS, rows_of_bodies
from experiments.recovery import Shares
from experiments.sensitivity import Point, read_points
from shapefit.arrays import Floats
from shapefit.evaluation.page import html_table, with_section
from shapefit.evaluation.report import markdown_table

PUBLISHED_MILLISECONDS = {"convex": 330, "alternate": 440, "pmp": 3020}
"""Time of a frame in the paper: MATLAB on an i7 with 3.4 GHz."""

BOX_PLOT = "![Errors of all images by method, as boxes](errors.svg)"
BARS = "![Mean errors of the sequences by method, as bars](sequences.svg)"
"""Figures of a report of `eval`."""

SENSITIVITIES = {
    "sensitivity-lambda": "lambda (the paper: 0.1)",
    "sensitivity-noise": "noise of the landmarks, in metres",
    "sensitivity-hidden": "share of hidden landmarks",
    "sensitivity-k": "number of atoms (the paper: 64)",
    "sensitivity-training": "trials of subject 86 to learn from (the paper: 15)",
}

INTRODUCTION = """\
# The paper's experiments

Zhou, Leonardos, Hu, Daniilidis: 3D Shape Estimation from 2D Landmarks: A Convex
Relaxation Approach, CVPR 2015. Each section sets what was measured here beside what the
paper states; numbers in italics are quoted, not computed. How each is made:
docs/experiments.md.
"""


def quoted(name: str) -> Any:
    """Return the section of this name in published.yaml: figures and texts of the paper
    and of the data.
    """
    return YAML(typ="safe").load(Path(__file__).with_name("published.yaml"))[name]


def quoted_shares() -> Shares:
    """Return (landmarks p, active atoms z) -> the paper's share of exact recoveries."""
    figure = quoted("recovery")
    return {
        (p, z): share
        for p, row in zip(figure["landmarks"], figure["success"], strict=True)
        for z, share in zip(figure["active_atoms"], row, strict=True)
    }


class Table(NamedTuple):
    """A table of texts, with a sentence above it, "" for none."""

    introduction: str
    header: list[str]
    rows: list[list[str]]

    def as_markdown(self) -> str:
        """Return the sentence and the table as Markdown."""
        blocks = [self.introduction, markdown_table(self.header, self.rows)]
        return "\n\n".join(filter(None, blocks))

    def as_html(self) -> str:
        """Return the sentence and the table as HTML, without the marks of Markdown."""
        rows = [[cell.strip("*") for cell in row] for row in self.rows]
        header = [cell.strip("*") for cell in self.header]
        sentence = f"<p>{escape(self.introduction)}</p>" if self.introduction else ""
        return sentence + html_table(header, rows)


def add_published(name: str, folder: Path) -> str:
    """Add a section to report.html of `eval` in a folder, published figures for the
    name "mocap" and oracles for "cars"; return it in Markdown.

    Done again, it takes the place of the former section.
    """
    report = _read_json(folder / "report.json")
    if name == "mocap":
        tables = [_errors_beside_the_paper(report)]
        sentences = [_objectives_beside_the_paper(report)]
        title = "Beside the paper"
    else:
        header = ["oracle", "similarity (normalised)", "similarity (unit of the truth)"]
        tables = [
            Table("What no fit can do without:", header, oracle_rows(report["config"])),
            _errors_by_body(folder, report),
        ]
        sentences = []
        title = "Oracles, and classes of body"
    caveats = list(map(str, quoted(name)["caveats"]))
    items = "".join(f"<li>{escape(caveat)}</li>" for caveat in caveats)
    paragraphs = [f"<p>{escape(text.replace('*', ''))}</p>" for text in sentences]
    html = "\n".join(
        [
            f"<h2>{title}</h2>",
            *(table.as_html() for table in tables),
            *paragraphs,
            f"<ul>{items}</ul>\n",
        ]
    )
    path = folder / "report.html"
    page = path.read_text(encoding="utf-8")
    path.write_text(with_section(page, "published", html), encoding="utf-8")
    blocks = [
        f"## {title}",
        *(table.as_markdown() for table in tables),
        *sentences,
        "\n".join(f"- {caveat}" for caveat in caveats),
    ]
    return "\n\n".join(blocks) + "\n"


def _errors_by_body(folder: Path, report: Mapping[str, Any]) -> Table:
    """Return the table of mean errors of the methods by class of body, from report and
    per_image.csv of the cars.
    """
    fit = shapefit.read_results(report["methods"][0]["files"][0])
    models = np.asarray(fit.extras["true_model"]).astype(str)
    row_of = {item: row for row, item in enumerate(fit.items or ())}
    errors: dict[str, dict[tuple[str, str], Floats]] = {}
    with (folder / "per_image.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            metric = (row["metric"], row["unit"])
            if metric not in ERRORS or not row["error"]:
                continue
            of_method = errors.setdefault(row["method"], {})
            if metric not in of_method:
                of_method[metric] = np.full(len(models), np.nan)
            of_method[metric][row_of[row["item"]]] = float(row["error"])
    is_judged = np.zeros(len(models), dtype=bool)
    for of_method in errors.values():
        is_judged |= np.isfinite(of_method[ERRORS[0]])
    judged = {
        method: {metric: values[is_judged] for metric, values in of_method.items()}
        for method, of_method in errors.items()
    }
    bodies = quoted("cars")["bodies"]
    header, rows = rows_of_bodies(judged, models[is_judged], bodies)
    text = "By class of body, means, and in brackets how many images there are:"
    return Table(text, header, rows)


def _objectives_beside_the_paper(report: Mapping[str, Any]) -> str:
    """Return a sentence with the mean objectives of alternation from several starts,
    ours and the paper's.
    """
    ours = {method["name"]: method["mean_objective"] for method in report["methods"]}
    paper = quoted("mocap")["mean_objectives"]
    here = ", ".join(f"{name} {_number_as_text(ours.get(name))}" for name in paper)
    there = ", ".join(f"{name} {value:.2f}" for name, value in paper.items())
    return (
        f"Mean objective: {here}. The paper's, of subject 15, which is not in these"
        f" data, and on a scale that it does not state: *{there}*."
    )


def _errors_beside_the_paper(report: Mapping[str, Any]) -> Table:
    """Return the table of mean normalised similarity errors, ours and the paper's."""
    ours: dict[str, dict[str, float]] = {}
    for row in report["summaries"]:
        if (row["metric"], row["unit"], row["sequence"]) == (
            "similarity",
            "normalised",
            None,
        ):
            ours.setdefault(row["method"], {})[row["group"]] = row["mean"]
    paper = quoted("mocap")["rows"]
    groups = dict.fromkeys(
        group for errors in (*ours.values(), *paper.values()) for group in errors
    )
    header = ["method"]
    for group in groups:
        header += [group, "*the paper*"]
    rows = []
    for method in ours | paper:
        row = [method]
        for group in groups:
            published = paper.get(method, {}).get(group)
            row.append(_number_as_text(ours.get(method, {}).get(group)))
            row.append("–" if published is None else f"*{_number_as_text(published)}*")
        rows.append(row)
    text = "Mean errors up to a similarity of normalised shapes, ours and the paper's:"
    return Table(text, header, rows)


def index(folder: Path) -> str:
    """Return the index page, in Markdown, of the results of `make paper` in a
    folder.
    """
    report = _read_json(folder / "mocap/report.json")
    parts = [
        INTRODUCTION,
        *_mocap_section(report),
        *optimality.sections(folder),
        "## Exact recovery (fig. freqexact)",
        "![Share recovered exactly, ours and published](recovery/recovery.png)",
        (
            "The numbers, and the deviations from the published ones (themselves read"
            " off a figure, within 0.02; the paper says 10 instances per cell):"
            " [recovery/recovery.md](recovery/recovery.md)."
        ),
        *_timing_section(
            [p for name in ("timing", "timing-pmp") for p in read_points(folder / name)]
        ),
        *_sensitivity_section(
            {name: read_points(folder / name) for name in SENSITIVITIES}
        ),
    ]
    return "\n\n".join(part.rstrip() for part in parts) + "\n"


def _mocap_section(report: Mapping[str, Any]) -> list[str]:
    medians = ", ".join(
        f"{name} {value:.3f}" for name, value in quoted("mocap")["medians"].items()
    )
    return [
        "## Motion capture (tab. human)",
        _errors_beside_the_paper(report).as_markdown(),
        (
            "Mean over sequences of the mean error up to a similarity, for shapes of"
            " unit standard deviation. All metrics, and the counts of images:"
            " [mocap/report.html](mocap/report.html)."
        ),
        "\n".join(f"- {caveat}" for caveat in quoted("mocap")["caveats"]),
        "### Spread over images (fig. boxplot-human)",
        BOX_PLOT.replace("(errors", "(mocap/errors"),
        (f"The paper's box plot is of subject 15; medians read off it: *{medians}*."),
        _objectives_beside_the_paper(report),
        "### Sequences (fig. mocap)",
        BARS.replace("(sequences", "(mocap/sequences"),
    ]


def _timing_section(points: Sequence[Point]) -> list[str]:
    times = {str(point.value): 1000 * point.seconds_per_image for point in points}
    rows = []
    for method, time in times.items():
        paper = PUBLISHED_MILLISECONDS.get(method)
        rows.append([method, f"{time:.3g}", "–" if paper is None else f"*{paper}*"])
    return [
        "## Time of an image",
        markdown_table(["method", "ms", "*ms (paper)*"], rows),
        (
            "All methods on the same images in one run, on all cores of this machine;"
            " the paper's are of MATLAB on one i7 with 3.4 GHz. Errors on the same"
            " images: [timing/sweep.md](timing/sweep.md),"
            " [timing-pmp/sweep.md](timing-pmp/sweep.md)."
        ),
        "![Errors and times of the methods](timing/sweep.png)",
    ]


def _sensitivity_section(experiments: Mapping[str, Sequence[Point]]) -> list[str]:
    parts = [
        "## Sensitivity of the convex program",
        (
            "The paper has no such figure; it sets lambda = 0.1 and 64 atoms, with"
            " exact landmarks."
        ),
    ]
    for name, points in experiments.items():
        groups = list(dict.fromkeys(point.group for point in points))
        means = {(point.value, point.group): point.mean for point in points}
        rows = [
            [str(value), *(_number_as_text(means[value, group]) for group in groups)]
            for value in dict.fromkeys(point.value for point in points)
        ]
        title = SENSITIVITIES[name]
        parts += [
            f"### {title[0].upper()}{title[1:]}",
            markdown_table([points[0].key, *groups], rows),
            f"![Error against {title}]({name}/sweep.png)",
            f"With medians and times: [{name}/sweep.md]({name}/sweep.md).",
        ]
    return parts


def _read_json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def _number_as_text(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"
