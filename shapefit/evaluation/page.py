"""report.html: the tables and figures of an evaluation, without a script."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple

from shapefit.errors import listed, printable
from shapefit.evaluation.figures import GRID, INK, PANELS, TRUTH
from shapefit.evaluation.report import (
    ABSENT,
    ALIGNED,
    ALL,
    NORMALISED,
    RATIO,
    SHORT_NAMES,
    UNSTATED_UNIT,
    Document,
    GroupMethod,
    PartSummary,
    Quantity,
    decimals_of,
    format_number,
    sequences_of,
    shown_units,
    table_of,
)

MAX_FAILED_SHOWN = 10
"""Failed images of a method that the page lists; report.json has all."""

BOX = "box"
"""Unit of errors as shares of the box around the landmarks."""

RECOLOURED = {INK: "ink", GRID: "line", TRUTH: "truth"}
"""Colours of figures -> those of the page that take their place."""

STYLE = Path(__file__).with_name("page.css")
"""Style of the page, light and dark."""

POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""Nothing is loaded, and nothing runs; figures style themselves."""

MEASURED = ("similarity", "camera", "rotation", "reprojection")
"""Metrics of which less is better."""

MEANINGS = {
    "similarity": (
        "mean distance of the landmarks from the truth, after the scale, turn and shift"
        " that fit best: the shape alone"
    ),
    "camera": "the same after scale and shift alone: shape and direction",
    "rotation": "angle between the estimated and the true direction of the object",
    "reprojection": (
        "root mean square distance, in the image, between the landmarks that were given"
        " and those of the fitted shape"
    ),
    "expected": "the aligned error that the method itself expects",
    "precision": "share of the landmarks called outliers that were wrong",
    "recall": "share of the wrong landmarks that were called outliers",
    NORMALISED: "share of the standard deviation of the true shape, as in papers",
    "bars": (
        "share of the landmarks whose truth lies in the error ellipsoids; that of the"
        " 90% bars should be 90"
    ),
    "width": "median width of the 90% error bars: wide ones hold anything",
    RATIO[0]: "below 1 the method is too sure of itself, above 1 too careful",
}
"""What the columns of the table mean."""

TITLES = {
    "errors": "How large are the errors?",
    "sequences": "Which sequences are hard?",
    "landmarks": "Which landmarks are hard?",
    "examples": "What do such errors look like?",
    "bars": "Can the error bars be believed?",
}
"""Figures and what they answer."""


ORIGIN = "<h2>Where this comes from</h2>"
"""Heading of the last part of the page."""

SECTION_END = "</section>\n"
"""End of a section that others add."""


class PageFigure(NamedTuple):
    """A figure of the page: its name in `PANELS`, SVG, and what is said below it."""

    name: str
    svg: str
    caption: str


class PageFacts(NamedTuple):
    """What the page says beside the report.

    extent: the size of the true objects in the unit of their file, None where unknown.
    note: why there are no figures, "" where there are. files: what lies beside it.
    """

    extent: float | None
    note: str
    files: Sequence[str]


def report_page(
    report: Document, figures: Sequence[PageFigure], facts: PageFacts
) -> str:
    """Return the HTML of report.html: tables, figures and how to read them.

    Names are escaped.
    """
    parts = [
        "<h1>Errors against the truth</h1>",
        _paragraph(_introduction(report, facts)),
        _table_of_errors(report),
        _legend_of_table(report),
        *(_figure(figure) for figure in figures),
        _table_of_angles(report),
        _list_of("Failed images", _failures(report)),
        _list_of("Warnings", report["warnings"]),
        _paragraph(facts.note, "note") if facts.note else "",
        _origin(report, facts),
    ]
    style = STYLE.read_text(encoding="utf-8")
    head = (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        f"<title>Errors against the truth</title><style>{style}</style></head>"
    )
    body = "\n".join(filter(None, parts))
    return f"{head}\n<body>\n{body}\n</body></html>\n"


def _introduction(report: Document, facts: PageFacts) -> str:
    """Say what was compared, how large the objects are, and what the least error is."""
    methods = report["methods"]
    images = max(method["images"] for method in methods)
    truth = [_last_part(file) for file in _truth_files(report)]
    names = listed([method["name"] for method in methods], "and")
    plural = "" if images == 1 else "s"
    text = f"{images:,} image{plural}, lifted to 3D by {names}, beside the true shapes"
    text += f" of {listed(truth, 'and')}." if truth else "."
    best = _least_error(report)
    if best is None:
        return text
    name, error, unit = best
    decimals = decimals_of([error])
    text += (
        f" After alignment landmarks are {format_number(error, decimals)} {unit} off"
    )
    text += " on average"
    if len(methods) > 1:
        text += f" with {name}, the best of {len(methods)} methods"
    raw_unit = _truth_unit(report)
    if facts.extent and raw_unit is not None:
        shown, factor = shown_units(report)[raw_unit]
        extent = factor * facts.extent
        share = 100 * error / extent
        # two digits, without an exponent
        size = f"{float(f'{extent:.2g}'):,g}"
        text += f"; the objects are about {size} {shown} large, so that is"
        text += f" {share:.2g}% of their size"
    return f"{text}."


def _least_error(report: Document) -> tuple[str, float, str] | None:
    """Return the method with the least aligned error, that error and its unit.

    Over all groups; None where it was not measured in the unit of the truth.
    """
    unit = _truth_unit(report)
    if unit is None:
        return None
    errors: dict[str, list[float]] = {}
    for one in report["summaries"]:
        if (one.metric, one.unit) == (ALIGNED, unit) and one.sequence is None:
            errors.setdefault(one.method, []).append(one.mean)
    known = {
        name: sum(of_groups) / len(of_groups)
        for name, of_groups in errors.items()
        if sum(of_groups) == sum(of_groups)
    }
    if not known:
        return None
    name = min(known, key=known.__getitem__)
    shown, factor = shown_units(report)[unit]
    return name, factor * known[name], shown


def _truth_unit(report: Document) -> str | None:
    """Return the unit of the truth in which errors were measured, None for none."""
    units = [one.unit for one in report["summaries"] if one.metric == ALIGNED]
    stated = [unit for unit in units if unit not in (NORMALISED, UNSTATED_UNIT)]
    return stated[0] if stated else None


def _truth_files(report: Document) -> list[str]:
    """Return the files of the truth, as the config names them."""
    files = report["config"].get("truth", ())
    if isinstance(files, str):
        return [files]
    return [str(file) for file in files] if isinstance(files, list | tuple) else []


def _last_part(path: str) -> str:
    """Return the file name in a path of any operating system."""
    return path.replace("\\", "/").rsplit("/", 1)[-1]


def _shown_columns(columns: Iterable[Quantity]) -> list[Quantity]:
    """Select the columns that the page shows, with one normalised error at the end.

    That is the aligned one; errors in sizes of boxes are left out. All columns where
    there is no other unit.
    """
    aligned = [(name, unit) for name, unit in columns if name == ALIGNED]
    shares = [quantity for quantity in aligned if quantity[1] == NORMALISED]
    others = [one for one in columns if one[1] not in (NORMALISED, BOX)]
    return [*others, *shares] if others else [*columns]


def _table_of_errors(report: Document) -> str:
    """Return the HTML table of errors: a row for each group and method."""
    counts, columns = table_of(report)
    shown = _shown_columns(columns)
    names = [_column_name(quantity) for quantity in shown]
    groups = [*dict.fromkeys(group for group, _ in counts)]
    lines = [_line("th", ["", "images", "failed", *names])]
    for group in groups:
        rows = [row for row in counts if row[0] == group]
        if group != ALL:
            lines.append(_group_line(group, 3 + len(shown)))
        columns_of_group = [
            _column_cells(columns[quantity], rows, quantity) for quantity in shown
        ]
        for place, row in enumerate(rows):
            counted_images = [f"{count:,}" for count in counts[row]]
            cells = [column[place] for column in columns_of_group]
            marks = [False] * 3 + [cell.is_best for cell in cells]
            texts = [row[1], *counted_images, *(cell.text for cell in cells)]
            lines.append(_line("td", texts, marks))
    return _table(lines)


def _group_line(group: str, columns: int) -> str:
    """Return the HTML row that names a group, `columns` wide, above its methods."""
    name = escape(printable(group))
    return f'<tr class="group"><td colspan="{columns}">{name}</td></tr>'


class _Cell(NamedTuple):
    """A cell of the table, and whether no method has a smaller mean error."""

    text: str
    is_best: bool


def _column_cells(
    column: Mapping[GroupMethod, tuple[float, ...]],
    rows: Sequence[GroupMethod],
    quantity: Quantity,
) -> list[_Cell]:
    """Return the cells of one column of the table, the best of a group marked.

    column: (group, method) -> mean and median, or the one number of a count or share.
    rows: the (group, method) of the cells, all of one group. The method of the smallest
    mean error is the best, where the quantity of the column is an error.
    """
    decimals = decimals_of(value for values in column.values() for value in values)
    texts = [
        " / ".join(format_number(value, decimals) for value in column.get(row, (None,)))
        for row in rows
    ]
    means = [text.partition(" / ")[0] for text in texts]
    known = [float(mean) for mean in means if mean != ABSENT]
    is_compared = quantity[0] in MEASURED and len(known) > 1
    return [
        _Cell(text, is_compared and mean != ABSENT and float(mean) == min(known))
        for text, mean in zip(texts, means, strict=True)
    ]


def _column_name(quantity: Quantity) -> str:
    """Return the heading of a column: a short name, and the unit in brackets."""
    name, unit = quantity
    shown = SHORT_NAMES.get(name, name)
    return f"{shown} ({unit})" if unit not in ("", UNSTATED_UNIT) else shown


def _legend_of_table(report: Document) -> str:
    """Return the HTML that says what the table of errors shows and its columns mean."""
    counts, columns = table_of(report)
    many = max(len(sequences_of(report, *row)) for row in counts)
    text = "Cells of errors are mean / median over the images."
    if many > 1:
        text = (
            "Cells of errors are mean / median: those of each sequence, averaged over"
            f" the sequences (up to {many}), so that long ones do not count more. The"
            " figures of all images, below, weigh each image alike, and their means"
            " differ a little."
        )
    if len(report["methods"]) > 1:
        text += " The least mean error of a column is bold."
    terms: dict[str, str] = {}
    for name, unit in _shown_columns(columns):
        if name in MEANINGS:
            terms.setdefault(SHORT_NAMES.get(name, name), MEANINGS[name])
        if unit == NORMALISED:
            terms[NORMALISED] = MEANINGS[NORMALISED]
        if name.startswith("in "):
            terms["in … bars"] = MEANINGS["bars"]
    items = "".join(
        f"<dt>{escape(term)}</dt><dd>{escape(meaning)}</dd>"
        for term, meaning in terms.items()
    )
    return f"{_paragraph(text, 'note')}<dl>{items}</dl>"


def _table_of_angles(report: Document) -> str:
    """Return the HTML table of errors of joint angles, "" where there are none."""
    angles = report["angles"]
    if not angles:
        return ""
    methods = [*dict.fromkeys(one.method for one in angles)]
    names = [*dict.fromkeys(one.part for one in angles)]
    of: dict[tuple[str, str], PartSummary] = {
        (one.part, one.method): one for one in angles
    }
    lines = [_line("th", ["joint angle (deg)", *methods])]
    for name in names:
        found = [of.get((name, method)) for method in methods]
        cells = [
            "–" if one is None else f"{one.mean:.1f} / {one.median:.1f}"
            for one in found
        ]
        lines.append(_line("td", [name, *cells]))
    note = (
        "Mean / median over the images of the difference from the true angle. Names are"
        " those of OpenSim's models; hips and shoulders are flexion, and angles to the"
        " vertical are left out."
    )
    table = _table(lines)
    return f"<h2>How far off are joint angles?</h2>{table}{_paragraph(note, 'note')}"


def _figure(figure: PageFigure) -> str:
    """Return the HTML of a figure with its heading and caption."""
    title = TITLES[figure.name]
    drawn = inline_svg(figure.name, figure.svg, title)
    caption = f"<figcaption>{escape(printable(figure.caption))}</figcaption>"
    return f"<h2>{escape(title)}</h2><figure>{drawn}{caption}</figure>"


def inline_svg(name: str, svg: str, title: str) -> str:
    """Return the HTML of the panels of a figure (SVG), in the colours of the page.

    The first one holds all of the figure and shows its own panel of it; the others
    show theirs by reference. On a narrow screen they stand below each other.
    """
    box = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg)
    if box is None:
        raise ValueError(f"the figure {name} has no size")
    width, height = map(float, box.groups())
    inner = svg[svg.index(">", box.start()) + 1 : svg.rindex("</svg>")]
    inner = re.sub(r"<metadata>.*?</metadata>", "", inner, flags=re.DOTALL)
    inner = re.sub(r"<style.*?</style>", "", inner, flags=re.DOTALL)
    # Tags alone: what a name says stays as it is.
    inner = re.sub("<[^>]*>", lambda tag: _adapt_tag(tag[0], name), inner)
    panels = []
    left = 0.0
    for place, share in enumerate(PANELS[name]):
        view = f"{left:.2f} 0 {share * width:.2f} {height:.2f}"
        content = f'<use href="#{name}-whole"/>'
        if place == 0:
            content = f'<g id="{name}-whole">{inner}</g>'
        panels.append(
            f'<svg viewBox="{view}" style="width:{100 * share:g}%" role="img"'
            f' aria-label="{escape(title)}">{content}</svg>'
        )
        left += share * width
    kind = "panels one" if len(panels) == 1 else "panels"
    return f'<div class="{kind}">{"".join(panels)}</div>'


def _adapt_tag(tag: str, name: str) -> str:
    """Give an SVG's tag, `<...>`, the page's colours, and its ids the prefix `name`."""
    for colour, of_page in RECOLOURED.items():
        tag = tag.replace(colour, f"var(--{of_page})")
    tag = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', tag)
    return re.sub(r'(url\(#|href="#)', rf"\g<1>{name}-", tag)


def _failures(report: Document) -> list[str]:
    """Return lines on the first failed images of each method, and how many are left."""
    lines = []
    for method in report["methods"]:
        failures = method["failures"]
        lines += [
            f"{method['name']}, {image['item']}: {image['reason']}"
            for image in failures[:MAX_FAILED_SHOWN]
        ]
        more = len(failures) - MAX_FAILED_SHOWN
        if more > 0:
            lines.append(f"{method['name']}: {more} more, which report.json lists")
    return lines


def _list_of(title: str, lines: Sequence[str]) -> str:
    """Return the HTML of a list of lines below a title, "" where there are no lines."""
    if not lines:
        return ""
    items = "".join(f"<li>{escape(printable(line))}</li>" for line in lines)
    return f"<h2>{escape(title)}</h2><ul>{items}</ul>"


def _origin(report: Document, facts: PageFacts) -> str:
    """Return the HTML that says which files were compared, and which the report has."""
    rows = [("truth", ", ".join(_truth_files(report)))]
    for method in report["methods"]:
        files = ", ".join(method["files"])
        made = f", by `fit --method {method['method']}`" if method["method"] else ""
        rows.append((method["name"], files + made))
    rows.append(("beside this page", ", ".join(facts.files)))
    rows.append(("shapefit", str(report["version"])))
    items = "".join(
        f"<dt>{escape(printable(name))}</dt><dd>{escape(printable(text))}</dd>"
        for name, text in rows
    )
    return f"{ORIGIN}<dl>{items}</dl>"


def html_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return the HTML table of a header and rows of texts, which are escaped."""
    return _table([_line("th", header), *(_line("td", row) for row in rows)])


def _table(lines: Sequence[str]) -> str:
    """Return the HTML table of rows of HTML, which scrolls where it is too wide."""
    return f'<div class="wide"><table>{"".join(lines)}</table></div>'


def with_section(page: str, name: str, html: str) -> str:
    """Insert HTML as the section `name` near the end of a report's page.

    It replaces the section that the page has of that name.
    """
    opening = f'<section id="{name}">'
    start = page.find(opening)
    if start >= 0:
        end = page.index(SECTION_END, start) + len(SECTION_END)
        page = page[:start] + page[end:]
    before, _, after = page.rpartition(ORIGIN)
    return f"{before}{opening}\n{html}{SECTION_END}{ORIGIN}{after}"


def _paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph of HTML, of the class `kind` if any."""
    opening = f'<p class="{kind}">' if kind else "<p>"
    return f"{opening}{escape(printable(text))}</p>"


def _line(tag: str, cells: Sequence[str], marks: Sequence[bool] = ()) -> str:
    """Return the HTML row of cells (th or td); marks says which cells are the best."""
    texts = []
    for place, cell in enumerate(cells):
        is_best = place < len(marks) and marks[place]
        kind = ' class="best"' if is_best else ""
        texts.append(f"<{tag}{kind}>{escape(printable(cell))}</{tag}>")
    return f"<tr>{''.join(texts)}</tr>"
