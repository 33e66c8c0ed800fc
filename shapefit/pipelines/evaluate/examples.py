"""Example images: which are drawn, and their picture: landmarks, truth, and what methods made."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.config.commands.evaluate import MOST_EXAMPLES
from shapefit.errors import abbreviate, input_error
from shapefit.evaluation.averages import slices
from shapefit.evaluation.metric_table import CORRELATION, DEVIATION, LANDMARKS
from shapefit.evaluation.summary import Names
from shapefit.geometry.procrustes import similarity_transform
from shapefit.io import ResultSet, ShapeSet, read_results
from shapefit.io.columns import Column
from shapefit.io.name_index import index_of
from shapefit.meshes.ellipses import covariances
from shapefit.meshes.pictures import Pose, skeleton_picture
from shapefit.meshes.views import YAxis
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


@dataclass(frozen=True)
class Lifted:
    """What one result file has to show.

    shapes (n, 3, p) and landmarks (n, 2, p) or None, with the p landmarks of the truth in their
    order, nan where the file lacks one; truth_rows (n), failures and items as in a Judgement;
    deviation and correlation (n, 3, p) where the file has error bars.
    """

    file: Path
    items: tuple[str, ...]
    shapes: Floats
    landmarks: Floats | None
    y_axis: YAxis
    truth_rows: NDArray[np.intp]
    failures: Mapping[str, str]
    deviation: Floats | None = None
    correlation: Floats | None = None

    def covariance(self, row: int) -> Floats | None:
        """Covariance (p, 3, 3) of the landmarks of an image, None where it is not known."""
        if self.deviation is None:
            return None
        correlation = None if self.correlation is None else self.correlation[row]
        return covariances(self.deviation[row], correlation)


def keep(results: ResultSet, judgement: Judgement) -> Lifted:
    """Take from a result file what a picture of its images needs."""
    observed = find_dataset(judgement.file, results, LANDMARKS)
    have, want = results.landmark_names, judgement.truth.landmark_names
    bars = [find_dataset(judgement.file, results, wanted) for wanted in (DEVIATION, CORRELATION)]
    deviation, correlation = (None if b is None else _arranged(b, have, want) for b in bars)
    return Lifted(
        file=judgement.file,
        items=results.items,
        shapes=_arranged(results.shapes, have, want),
        landmarks=None if observed is None else _arranged(observed, have, want),
        y_axis=results.y_axis,
        truth_rows=judgement.truth_rows,
        failures=judgement.failures,
        deviation=deviation,
        correlation=correlation,
    )


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
        if file.landmarks is None:
            found = "has no dataset 'landmarks' to draw examples with"
            raise input_error(file.file, found, "fit to a file that ends in .h5")
        true = truth.shapes[file.truth_rows[row]]
        estimates = {name: found[item][0].shapes[found[item][1]] for name, found in places.items()}
        bars = {name: found[item][0].covariance(found[item][1]) for name, found in places.items()}
        poses.append(
            Pose(
                title=item,
                landmarks=file.landmarks[row],
                shapes={TRUTH: _laid_onto(estimates[first], true), **estimates},
                covariances={name: C for name, C in bars.items() if C is not None},
            )
        )
    return skeleton_picture(poses, truth.edges, methods[first][0].y_axis)


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
        for row, item in enumerate(file.items)
        if item not in file.failures
    }


def _arranged(points: Floats, have: Sequence[str], want: Sequence[str]) -> Floats:
    """Return points (n, d, p) of the landmarks `have` as those of `want`, nan where unknown."""
    columns = {name: column for column, name in enumerate(have)}
    arranged = np.full((*points.shape[:-1], len(want)), np.nan)
    for column, name in enumerate(want):
        if name in columns:
            arranged[..., column] = points[..., columns[name]]
    return arranged


def _laid_onto(estimate: Floats, true: Floats) -> Floats:
    """Move a true shape (3, p) onto an estimate, by the landmarks that both have."""
    known = np.isfinite(estimate).all(axis=0) & np.isfinite(true).all(axis=0)
    return similarity_transform(true[:, known], estimate[:, known]).apply(true)


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
        for file, rows in _rows_of(method, frozenset(chosen)).items():
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
        judgement = judge(file, results, lambda _: true, options.match, ("similarity",))
        lifted.setdefault(name, []).append(keep(results, judgement))
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
