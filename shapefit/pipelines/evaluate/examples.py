"""Example images: which are drawn, and their picture: landmarks, truth, and what methods made."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from shapefit.arrays import Floats
from shapefit.config.commands.evaluate import MOST_EXAMPLES
from shapefit.errors import abbreviate, input_error
from shapefit.evaluation.averages import slices
from shapefit.evaluation.metric_table import CORRELATION, DEVIATION, LANDMARKS, Dataset
from shapefit.evaluation.summary import Names
from shapefit.geometry.procrustes import similarity_transform
from shapefit.io import ResultSet, ShapeSet, read_results
from shapefit.io.columns import Column
from shapefit.io.name_index import NameIndex
from shapefit.meshes.ellipses import covariances
from shapefit.meshes.pictures import Pose, skeleton_picture
from shapefit.pipelines.evaluate.judgement import Judgement, judge
from shapefit.pipelines.evaluate.measurement import as_named, find_dataset, visible_enough
from shapefit.pipelines.evaluate.method_images import MethodImages, Picked
from shapefit.pipelines.evaluate.plan import MeasuringOptions, Truth
from shapefit.pipelines.items import matches, named_items, spread

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KEY = "examples"
AT_A_TIME = 1 << 14
"""Items that are read at a time, and compared with a name that none of them has."""

TRUTH = "truth"
"""Name of the column of the true shapes."""


class Lifted(NamedTuple):
    """Images of one result file, and what was judged of them."""

    results: ResultSet
    judgement: Judgement

    def dataset(self, row: int, wanted: Dataset) -> Floats | None:
        """Return what a dataset says of an image, (d, p) as `arranged`; None where it is absent."""
        values = find_dataset(self.judgement.file, self.results, wanted)
        return None if values is None else self.arranged(values[row])

    def arranged(self, points: Floats) -> Floats:
        """Return points (d, p) with the landmarks of the truth, nan where the file lacks one."""
        own = self.results.landmark_names
        columns = {name: column for column, name in enumerate(self.judgement.truth.landmark_names)}
        arranged = np.full((len(points), len(columns)), np.nan)
        for column, name in enumerate(own):
            if name in columns:
                arranged[:, columns[name]] = points[:, column]
        return arranged

    def shape(self, row: int) -> Floats:
        """Return the shape (3, p) of an image."""
        return self.arranged(self.results.shapes[row])

    def covariance(self, row: int) -> Floats | None:
        """Covariance (p, 3, 3) of the landmarks of an image, None where it is not known."""
        deviation = self.dataset(row, DEVIATION)
        if deviation is None:
            return None
        return covariances(deviation, self.dataset(row, CORRELATION))


def examples_picture(
    wanted: int | Sequence[str], methods: Mapping[str, Sequence[Lifted]], truth: ShapeSet
) -> Figure:
    """One row an example: its landmarks, the truth, then the shape of each method.

    The truth is laid onto the estimate of the first method by the best similarity, so that all are
    seen from the same side. `methods` maps a name to its files. Raises InputError for names that
    no image has that all methods lifted, and where the first method has no observed landmarks.
    """
    assert truth.edges is not None  # check_examples
    places = {name: _places(files) for name, files in methods.items()}
    first, *others = places
    common = [item for item in places[first] if all(item in places[name] for name in others)]
    chosen = choose(wanted, common)
    poses = []
    for item in chosen:
        file, row = places[first][item]
        landmarks = file.dataset(row, LANDMARKS)
        if landmarks is None:
            found = "has no dataset 'landmarks' to draw examples with"
            raise input_error(file.judgement.file, found, "fit to a file that ends in .h5")
        true = truth.shapes[file.judgement.truth_rows[row]]
        own = {name: found[item] for name, found in places.items()}
        bars = {name: lifted.covariance(row) for name, (lifted, row) in own.items()}
        shapes = {name: lifted.shape(row) for name, (lifted, row) in own.items()}
        poses.append(
            Pose(
                title=item,
                landmarks=landmarks,
                shapes={TRUTH: _laid_onto(shapes[first], true), **shapes},
                covariances={name: C for name, C in bars.items() if C is not None},
            )
        )
    return skeleton_picture(poses, truth.edges, methods[first][0].results.y_axis)


def choose(wanted: int | Sequence[str], items: Names) -> tuple[str, ...]:
    """Choose items: as many as wanted, spread evenly, or those of the names and globs.

    A number takes the middle of each of so many equal parts. Raises InputError where there are no
    items, a name or glob fits none, or more fit than a picture shows.
    """
    if not len(items):
        found = "no image has the truth and a shape of every method"
        raise input_error(KEY, found, "give results of the same images, or leave it out")
    if isinstance(wanted, int):
        return tuple(items[place : place + 1][0] for place in spread(wanted, len(items)))
    chosen: dict[str, None] = {}
    for name in wanted:
        fitting = [
            item
            for rows in slices(len(items), AT_A_TIME)
            for item in items[rows]
            if matches(item, name)
        ]
        if not fitting:
            near = get_close_matches(name, items[:AT_A_TIME], n=5, cutoff=0.0)
            found = f"no image with the truth and a shape of every method is called '{name}'"
            raise input_error(KEY, found, f"correct it; the nearest are {', '.join(near)}")
        chosen |= dict.fromkeys(fitting)
    if len(chosen) > MOST_EXAMPLES:
        found = f"{len(chosen)} images fit: {abbreviate(list(chosen))}"
        raise input_error(KEY, found, f"name at most {MOST_EXAMPLES}, or give a number of images")
    return tuple(chosen)


def _places(files: Sequence[Lifted]) -> dict[str, tuple[Lifted, int]]:
    """File and row of each item that did not fail."""
    return {
        item: (file, row)
        for file in files
        for row, item in enumerate(file.results.items)
        if item not in file.judgement.failures
    }


def _laid_onto(estimate: Floats, true: Floats) -> Floats:
    """Move a true shape (3, p) onto an estimate, by the landmarks that both have."""
    known = np.isfinite(estimate).all(axis=0) & np.isfinite(true).all(axis=0)
    return similarity_transform(true[:, known], estimate[:, known]).apply(true)


def chosen_items(
    wanted: int | Sequence[str], methods: Sequence[MethodImages], folder: Path | None
) -> tuple[str, ...]:
    """Choose from the images that no method failed on; raises as `choose`."""
    first, *others = methods
    indices = [(each, NameIndex.of(each.items.blocks())) for each in others]
    common = Column(folder, np.int64)
    start = 0
    for items in first.items.blocks():
        shown = ~first.failed[start : start + len(items)]
        for other, index in indices:
            rows = index.find(items)
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
        for file, rows in _rows_of(method, frozenset(chosen)).items():
            results = held[file] if file in held else read_results(file)
            results = as_named(results, truth.head.landmark_names)
            results, _ = visible_enough(file, results, options.least_visible)
            shown.append((method.name, file, results.take(rows)))
    keys = [
        key
        for _, file, results in shown
        for key in named_items(results, options.match, file, "match")
    ]
    true = truth.named(keys)
    lifted: dict[str, list[Lifted]] = {}
    for name, file, results in shown:
        judgement = judge(file, results, lambda _: true, options.match, ("similarity",))
        lifted.setdefault(name, []).append(Lifted(results, judgement))
    return lifted, true


def _rows_of(method: MethodImages, chosen: Collection[str]) -> dict[Path, list[int]]:
    """Rows of the chosen images in each file that has any."""
    found: dict[Path, list[int]] = {}
    start = 0
    for items in method.items.blocks():
        for row in (row for row, item in enumerate(items, start) if item in chosen):
            file, own = method.place(row)
            found.setdefault(file, []).append(own)
        start += len(items)
    return found
