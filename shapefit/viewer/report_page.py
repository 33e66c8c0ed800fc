"""A report as one HTML file that needs nothing else: its Markdown with the plots inlined."""

from __future__ import annotations

import json
import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any
from urllib.parse import quote

from shapefit.viewer.page import fill, list_items, resource

Links = Mapping[str, Sequence[tuple[str, str]]]
"""Headings, and below each the items of images with a line about each."""


def report_page(
    blocks: Sequence[str],
    *,
    drawings: Mapping[str, bytes],
    provenance: Mapping[str, Any],
    view: str | None = None,
    links: Links | None = None,
) -> str:
    """Return the page.

    `blocks` are those of the Markdown; `drawings` the SVG files that pictures among them name;
    `links` lead to images in `view`, the file of the viewer beside the report. Whatever comes from
    a file is escaped; the Content-Security-Policy forbids foreign code and every request.
    """
    body = [_html(block, drawings) for block in blocks]
    if view is not None:
        body.append(f'<h2>Images</h2><p><a href="{_address(view)}">All, to turn and play</a></p>')
        for heading, images in (links or {}).items():
            lines = "".join(_link(view, item, line) for item, line in images)
            body.append(f'<h3>{escape(heading)}</h3><ul class="images">{lines}</ul>')
    body += [_further([]), *_provenance(provenance)]
    return fill(
        resource("report.html"),
        style=resource("report.css"),
        script=resource("report.js"),
        title=escape(blocks[0].removeprefix("# ")),
        body="\n".join(body),
    )


def _further(blocks: Sequence[str]) -> str:
    body = "\n".join(_html(block, {}) for block in blocks)
    return f'<section id="further">{body}</section>'


def add_section(page: str, blocks: Sequence[str]) -> str:
    """Return a page of `report_page` with blocks before how it was made, in place of such."""
    section = re.compile(re.escape(_further([])).replace("><", ">.*?<"), re.DOTALL)
    return section.sub(lambda _: _further(blocks), page, count=1)


def _html(block: str, drawings: Mapping[str, bytes]) -> str:
    """Return one block, which is a heading, a table, a list, a picture or a paragraph."""
    if block.startswith("# "):
        return f"<h1>{escape(block[2:])}</h1>"
    if block.startswith("## "):
        return f"<h2>{escape(block[3:])}</h2>"
    if block.startswith("| "):
        header, _, *rows = [_cells(line) for line in block.splitlines()]
        return _table(header, rows)
    if block.startswith("- "):
        return f"<ul>{list_items(line[2:] for line in block.splitlines())}</ul>"
    if picture := re.fullmatch(r"!\[(.*)\]\((.*)\)", block):
        return _picture(picture[1], drawings[picture[2]])
    return f"<p>{escape(block)}</p>"


def _cells(line: str) -> list[str]:
    """Return the cells of a line of a table; a bar inside a cell stands behind a backslash."""
    cells = re.split(r"(?<!\\)\|", line)[1:-1]
    return [cell.strip(" ").replace("\\|", "|") for cell in cells]


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f'<th scope="col">{_cell(cell)}</th>' for cell in header)
    body = "".join(f"<tr>{''.join(f'<td>{_cell(c)}</td>' for c in row)}</tr>" for row in rows)
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return f'<div class="scroll">{table}</div>'


def _cell(cell: str) -> str:
    """Return a cell; what stands between asterisks is quoted from elsewhere."""
    if quoted := re.fullmatch(r"\*(.+)\*", cell):
        return f"<bdi><i>{escape(quoted[1])}</i></bdi>"
    return f"<bdi>{escape(cell)}</bdi>"


def _picture(text: str, drawing: bytes) -> str:
    data = b64encode(drawing).decode("ascii")
    image = f'<img alt="{escape(text)}" src="data:image/svg+xml;base64,{data}">'
    return f"<figure>{image}<figcaption>{escape(text)}</figcaption></figure>"


def _link(view: str, item: str, line: str) -> str:
    address = f"{_address(view)}#item={quote(item, safe='', errors='replace')}"
    return f'<li><a href="{address}"><bdi>{escape(item)}</bdi></a> {escape(line)}</li>'


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
