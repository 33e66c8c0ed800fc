"""A report as one HTML file that needs nothing else: tables, plots and pictures inlined."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any
from urllib.parse import quote

from shapefit.evaluation.tables.document import (
    Block,
    Italic,
    Listing,
    Picture,
    Section,
    Table,
    Title,
)
from shapefit.viewer.page import fill, list_items, resource


@dataclass(frozen=True)
class Card:
    """One image of a gallery: its item, a line about it, its drawing (SVG of our own making)."""

    item: str
    line: str
    drawing: str


@dataclass(frozen=True)
class Gallery:
    """Images under a heading, such as the worst of a method."""

    heading: str
    cards: Sequence[Card]


def report_page(
    blocks: Sequence[Block],
    *,
    drawings: Mapping[str, bytes],
    galleries: Sequence[Gallery] = (),
    view: str | None = None,
    provenance: Mapping[str, Any],
) -> str:
    """Return the page.

    `drawings` are the SVG files that pictures among the blocks name; other pictures are links.
    `view` is the file of the viewer beside the report, which the images link to. Whatever comes
    from a file is escaped; the Content-Security-Policy forbids foreign code and every request.
    """
    body = [_html(block, drawings) for block in blocks]
    if galleries:
        body.append("<h2>Images</h2>")
    if view is not None:
        body.append(f'<p><a href="{_address(view)}">All images, to turn and play</a></p>')
    body += [_gallery(gallery, view) for gallery in galleries]
    body += _provenance(provenance)
    title = next((block.text for block in blocks if isinstance(block, Title)), "Report")
    return fill(
        resource("report.html"),
        style=resource("report.css"),
        script=resource("report.js"),
        title=escape(title),
        body="\n".join(body),
    )


def _html(block: Block, drawings: Mapping[str, bytes]) -> str:
    match block:
        case Title(text):
            return f"<h1>{escape(text)}</h1>"
        case Section(text):
            return f"<h2>{escape(text)}</h2>"
        case Table(header, rows):
            return _table(header, rows)
        case Listing(lines):
            return f"<ul>{list_items(lines)}</ul>"
        case Picture(file, text):
            return _picture(file, text, drawings.get(file))
        case text:
            return f"<p>{escape(text)}</p>"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f'<th scope="col">{_cell(cell)}</th>' for cell in header)
    body = "".join(f"<tr>{''.join(f'<td>{_cell(c)}</td>' for c in row)}</tr>" for row in rows)
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return f'<div class="scroll">{table}</div>'


def _cell(cell: str) -> str:
    text = f"<bdi>{escape(cell)}</bdi>"
    return f"<em>{text}</em>" if isinstance(cell, Italic) else text


def _picture(file: str, text: str, drawing: bytes | None) -> str:
    if drawing is None:
        return f'<p><a href="{_address(file)}">{escape(text)}</a></p>'
    data = b64encode(drawing).decode("ascii")
    image = f'<img alt="{escape(text)}" src="data:image/svg+xml;base64,{data}">'
    return f"<figure>{image}<figcaption>{escape(text)}</figcaption></figure>"


def _gallery(gallery: Gallery, view: str | None) -> str:
    cards = "".join(_card(card, view) for card in gallery.cards)
    return f'<h3>{escape(gallery.heading)}</h3><div class="cards">{cards}</div>'


def _card(card: Card, view: str | None) -> str:
    inside = f"{card.drawing}<bdi>{escape(card.item)}</bdi>{escape(card.line)}"
    if view is None:
        return f'<div class="card">{inside}</div>'
    address = f"{_address(view)}#item={quote(card.item, safe='', errors='replace')}"
    return f'<a class="card" href="{address}" title="{escape(card.item)}">{inside}</a>'


def _address(file: str) -> str:
    """Return a relative address of a file: no name of one can be taken for a scheme."""
    return "./" + quote(file, errors="replace")


def _provenance(provenance: Mapping[str, Any]) -> list[str]:
    config = json.dumps(provenance.get("config", {}), indent=2, ensure_ascii=False)
    inputs = [[name, digest] for name, digest in provenance.get("inputs", {}).items()]
    return [
        "<h2>How it was made</h2>",
        f"<p>shapefit {escape(str(provenance.get('version', '')))}</p>",
        _table(["input", "SHA-256"], inputs),
        f"<details><summary>Config</summary><pre>{escape(config)}</pre></details>",
    ]
