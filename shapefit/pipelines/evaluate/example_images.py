"""Which images are drawn as examples, and their shapes, read once more from the result files."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from shapefit.io import ResultSet, ShapeSet, read_results
from shapefit.io.spilled.columns import Column
from shapefit.io.spilled.name_index import index_of
from shapefit.pipelines.evaluate.examples import Lifted, choose, keep
from shapefit.pipelines.evaluate.judgement import judge
from shapefit.pipelines.evaluate.method_images import MethodImages, Picked
from shapefit.pipelines.evaluate.plan import MeasuringOptions
from shapefit.pipelines.evaluate.result_datasets import visible_enough
from shapefit.pipelines.evaluate.truth import Truth
from shapefit.pipelines.items import named_items
from shapefit.pipelines.skeletons.as_named import as_named


def chosen_items(
    wanted: int | Sequence[str], methods: Sequence[MethodImages], folder: Path | None
) -> tuple[str, ...]:
    """Choose from the images that no method failed on; raises as `choose`."""
    first, *others = methods
    indices = [(each, index_of(folder, each.items.blocks())) for each in others]
    common = Column(folder, np.int64)
    start = 0
    for items in first.items.blocks():
        shown = ~first.failed[start : start + len(items)]
        for other, index in indices:
            rows = index.find(items, other.items)
            shown &= rows >= 0
            shown[shown] &= ~other.failed.take(rows[shown])
        common.append(start + np.flatnonzero(shown))
        start += len(items)
    return choose(wanted, Picked(first.items, common))


def read_lifted(
    options: MeasuringOptions,
    chosen: Sequence[str],
    methods: Sequence[MethodImages],
    truth: Truth,
    held: Mapping[Path, ResultSet],
) -> tuple[dict[str, list[Lifted]], ShapeSet]:
    """Return the chosen images of each method, file by file, and their true shapes.

    `held` are the results of files that cannot be read again.
    """
    shown = []
    for method in methods:
        for file, rows in _places(method, frozenset(chosen)).items():
            results = held[file] if file in held else read_results(file)
            results = as_named(results, truth.head.landmark_names)
            results, _ = visible_enough(file, results, options.least_visible)
            shown.append((method.name, file, results.take(rows)))
    keys = [
        key
        for _, file, results in shown
        for key in named_items(results.items, results.extras, options.match, file, "match")
    ]
    true = truth.named(keys)
    lifted: dict[str, list[Lifted]] = {}
    for name, file, results in shown:
        judgement = judge(file, results, true, options.match, ("similarity",))
        lifted.setdefault(name, []).append(keep(results, judgement, true))
    return lifted, true


def _places(method: MethodImages, chosen: Collection[str]) -> dict[Path, list[int]]:
    """Rows of the chosen images in each file that has any."""
    found: dict[Path, list[int]] = {}
    start = 0
    for items in method.items.blocks():
        for row in (row for row, item in enumerate(items, start) if item in chosen):
            file, own = method.place(row)
            found.setdefault(file, []).append(own)
        start += len(items)
    return found
