"""Reports as pages: the blocks of a report with its plots, its best and worst images, a viewer."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shapefit.config import ViewConfig
from shapefit.errors import InputError
from shapefit.evaluation.metric_table import METRICS
from shapefit.evaluation.summary import ImageErrors
from shapefit.evaluation.tables.document import Block, Picture, Section, as_markdown
from shapefit.pipelines.view.run import Page, make_page
from shapefit.viewer.report_page import Card, Gallery, report_page
from shapefit.viewer.scene import Scene
from shapefit.viewer.thumbnails import thumbnail

Writer = Callable[[Path], object]

VIEW = "view.html"
SHOWN = 12
"""Worst, median and best images of a method, each so many."""


class Ranked(NamedTuple):
    """An image by its place among those of its method, its item, and its error."""

    row: int
    item: str
    error: float


@dataclass(frozen=True)
class Pages:
    """The writers of a report's pages by file name, and what could not be shown."""

    writers: dict[str, Writer]
    warnings: tuple[str, ...] = ()


def report_pages(
    name: str,
    blocks: Sequence[Block],
    plots: Mapping[str, Writer],
    errors: Sequence[ImageErrors],
    view: ViewConfig | None,
    provenance: Mapping[str, Any],
) -> Pages:
    """Return NAME.md and report.html with the plots and, where a viewer can show it, view.html.

    `plots` are the writers of plots by file name; `errors` those of all methods, of which each is
    ranked by its first; `view` what the viewer is to show, none for no viewer.
    """
    drawings = {file: _bytes_of(write) for file, write in plots.items() if file.endswith(".svg")}
    pictures = [Picture(file, Path(file).stem.replace("_", " ")) for file in drawings]
    with_plots = list(blocks)
    if pictures:
        with_plots += [Section("Plots"), *pictures]
    ranked = [(each, rank(each)) for each in first_of_each(errors)] if view else []
    page, warnings = _page(view, ranked)
    html = report_page(
        with_plots,
        drawings=drawings,
        galleries=[] if page is None else galleries(page.scene, ranked),
        view=None if page is None else VIEW,
        provenance=provenance,
    )
    texts = {f"{name}.md": as_markdown(_with_png(with_plots)), "report.html": html}
    contents = {file: text.encode("utf-8", "xmlcharrefreplace") for file, text in texts.items()}
    if page is not None:
        contents[VIEW] = page.html
    writers: dict[str, Writer] = {
        file: partial(Path.write_bytes, data=drawing) for file, drawing in drawings.items()
    }
    for file, content in contents.items():
        writers[file] = partial(Path.write_bytes, data=content)
    return Pages(writers, warnings)


def contact_sheet(fitted_with: str) -> Path | None:
    """Return the contact sheet that a fit drew, by its config (JSON), where it is still there."""
    pictures = _pictures(fitted_with)
    sheet = Path(str(pictures.get("folder"))) / f"contact_sheet.{pictures.get('format')}"
    return sheet if pictures.get("folder") and sheet.is_file() else None


def contact_sheets(sheets: Mapping[str, Iterable[Path]], folder: Path) -> list[Block]:
    """Return links to the contact sheets of each method; `folder` is that of the report."""
    found = [
        Picture(os.path.relpath(sheet, folder), f"Contact sheet of {name}")
        for name, own in sheets.items()
        for sheet in own
    ]
    return [Section("Contact sheets"), *found] if found else []


def first_of_each(errors: Sequence[ImageErrors]) -> list[ImageErrors]:
    """Return the errors of each method in its first metric; outlier labels are none."""
    first: dict[str, ImageErrors] = {}
    for each in errors:
        if not METRICS[each.metric].of_labels:
            first.setdefault(each.method, each)
    return list(first.values())


def rank(errors: ImageErrors) -> dict[str, list[Ranked]]:
    """Return the worst, median and best images, worst first; all of them where they are few.

    Those of equal errors are in their order.
    """
    values = errors.values[:]
    known = np.flatnonzero(~np.isnan(values))
    falling = known[np.argsort(-values[known], kind="stable")]

    def at(start: int, stop: int) -> list[Ranked]:
        rows = falling[start:stop].tolist()
        return [Ranked(row, errors.items[row : row + 1][0], float(values[row])) for row in rows]

    n = len(falling)
    if n <= 3 * SHOWN:
        return {"all images, worst first": at(0, n)}
    middle = (n - SHOWN) // 2
    return {
        "worst": at(0, SHOWN),
        "median": at(middle, middle + SHOWN),
        "best": at(n - SHOWN, n),
    }


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not drawn
def galleries(
    scene: Scene, ranked: Sequence[tuple[ImageErrors, Mapping[str, Sequence[Ranked]]]]
) -> list[Gallery]:
    """Return the ranked images of each method that the scene shows, drawn."""
    layers = {layer.name: layer for layer in scene.layers}
    frames = {item: frame for frame, item in enumerate(scene.items)}
    found = []
    for errors, kinds in ranked:
        layer = layers.get(errors.method)
        if layer is None:
            continue
        for kind, images in kinds.items():
            cards = [
                Card(
                    image.item,
                    f"{errors.metric} {image.error:.4g} {errors.unit}",
                    thumbnail(scene, frames[image.item], layer),
                )
                for image in images
                if image.item in frames
            ]
            if cards:
                found.append(Gallery(f"{errors.method}: {kind}", cards))
    return found


def _page(
    view: ViewConfig | None,
    ranked: Sequence[tuple[ImageErrors, Mapping[str, Sequence[Ranked]]]],
) -> tuple[Page | None, tuple[str, ...]]:
    """Return the page of the viewer, in which the ranked images are; or why there is none."""
    if view is None:
        return None, ()
    kept = {image.item for _, kinds in ranked for images in kinds.values() for image in images}
    try:
        return make_page(view, kept), ()
    except InputError as error:
        return None, (f"{VIEW} is left out: {'; '.join(error.problems)}",)


def _with_png(blocks: Sequence[Block]) -> list[Block]:
    """Show plots as PNG, which every viewer of Markdown can."""
    return [
        Picture(f"{block.file.removesuffix('.svg')}.png", block.text)
        if isinstance(block, Picture) and block.file.endswith(".svg")
        else block
        for block in blocks
    ]


def _bytes_of(write: Writer) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drawing"
        write(path)
        return path.read_bytes()


def _pictures(fitted_with: str) -> Mapping[str, Any]:
    """Return the section `pictures` of the config that a result was fitted with."""
    try:
        config = json.loads(fitted_with or "{}")
    except ValueError:
        return {}
    pictures = config.get("pictures") if isinstance(config, dict) else None
    return pictures if isinstance(pictures, dict) else {}
