"""Reports as pages: the blocks of a report with its plots, its best and worst images, a viewer."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

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


def contact_sheets(fitted_with: Mapping[str, Sequence[str]], folder: Path) -> list[Block]:
    """Return links to the contact sheets that fits drew, where they are still there.

    `fitted_with` are the configs (JSON) of the fits of each method; `folder` that of the report.
    """
    found: list[Block] = []
    for name, configs in fitted_with.items():
        for config in configs:
            pictures = _pictures(config)
            sheet = Path(str(pictures.get("folder"))) / f"contact_sheet.{pictures.get('format')}"
            if pictures.get("folder") and sheet.is_file():
                file = os.path.relpath(sheet, folder)
                found.append(Picture(file, f"Contact sheet of {name}"))
    return [Section("Contact sheets"), *found] if found else []


def first_of_each(errors: Sequence[ImageErrors]) -> list[ImageErrors]:
    """Return the errors of each method in its first metric; outlier labels are none."""
    first: dict[str, ImageErrors] = {}
    for each in errors:
        if not METRICS[each.metric].of_labels:
            first.setdefault(each.method, each)
    return list(first.values())


def rank(errors: ImageErrors) -> dict[str, list[int]]:
    """Return the worst, median and best images, worst first; all of them where they are few."""
    known = np.flatnonzero(~np.isnan(errors.values))
    order = known[np.argsort(-errors.values[known], kind="stable")].tolist()
    if len(order) <= 3 * SHOWN:
        return {"all images, worst first": order}
    middle = (len(order) - SHOWN) // 2
    return {
        "worst": order[:SHOWN],
        "median": order[middle : middle + SHOWN],
        "best": order[-SHOWN:],
    }


@np.errstate(over="ignore", invalid="ignore")  # what overflows is not drawn
def galleries(
    scene: Scene, ranked: Sequence[tuple[ImageErrors, Mapping[str, Sequence[int]]]]
) -> list[Gallery]:
    """Return the ranked images of each method that the scene shows, drawn."""
    layers = {layer.name: layer for layer in scene.layers}
    frames = {item: frame for frame, item in enumerate(scene.items)}
    found = []
    for errors, kinds in ranked:
        layer = layers.get(errors.method)
        if layer is None:
            continue
        for kind, rows in kinds.items():
            cards = [
                Card(
                    errors.items[row],
                    f"{errors.metric} {errors.values[row]:.4g} {errors.unit}",
                    thumbnail(scene, frames[errors.items[row]], layer),
                )
                for row in rows
                if errors.items[row] in frames
            ]
            if cards:
                found.append(Gallery(f"{errors.method}: {kind}", cards))
    return found


def _page(
    view: ViewConfig | None,
    ranked: Sequence[tuple[ImageErrors, Mapping[str, Sequence[int]]]],
) -> tuple[Page | None, tuple[str, ...]]:
    """Return the page of the viewer, in which the ranked images are; or why there is none."""
    if view is None:
        return None, ()
    kept = {
        errors.items[row] for errors, kinds in ranked for rows in kinds.values() for row in rows
    }
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
