"""Errors, 90% regions and verdicts on film of people whom the dictionary does not know.

`python -m benchmarks.verdicts --data FOLDER` films clips of seven bodies
(`benchmarks.footage`: the whole body, to the hips, to the hips from 1 m, and above the
hips), lifts each body by a dictionary of the others, by `posterior` every fourth frame
and by `sequences` all of them, and writes results/verdicts/index.md. A fine image has
an error below 0.25, a far one above 0.4, after the best similarity and in sizes of the
true shape; a verdict is good where it doubts few fine images and many far ones. None of
these bodies is scored elsewhere: settings may be chosen on this table.
"""

from __future__ import annotations

import argparse
import csv
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import shapefit
from benchmarks.coverage import CONFIGS, DATA, read_bodies, run, write_page
from benchmarks.footage import (
    ABOVE,
    BASE,
    CHOSEN_ON,
    HIPS,
    JUDGED,
    NEAR,
    Cell,
    choose_clips,
    film,
)
from shapefit.api.arguments import Method, Prior
from shapefit.evaluation.calibration import WIDTH_SQUARED_RADIUS
from shapefit.evaluation.report import markdown_table
from shapefit.io import write_shapes
from shapefit.io.atomic import atomic_path
from shapefit.pipelines.evaluate.measure import measure as measure_file
from shapefit.records import Landmarks, Shapes

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

FOLDER = Path("results/verdicts")
CELLS = (BASE, HIPS, NEAR, ABOVE)

FINE = 0.25
"""Error below which an image is fine."""

FAR = 0.4
"""Error above which an image is far from the truth."""

CLIPS = 8
"""Clips of each body in each cell."""

LONGEST_SECONDS = 3.0
"""Length of the longest clip."""

EVERY = 4
"""Frames of film from one single image to the next."""

PRIORS: Mapping[Method, Prior] = {
    "posterior": {"residual_variance": 0.006, "bar_scale": 1.6},
    "sequences": {"residual_variance": 0.01, "bar_scale": 1.5},
}
"""What `-d people` uses; dictionaries made here do not say that they suit people."""


@dataclass(frozen=True)
class Judged:
    """Images of one body in one cell by one method, and how they were judged.

    The sum of errors and of squared errors are over images; inside counts landmarks in
    their 90% regions, of so many that have one; refined, frames that `sequences` took
    together with their neighbours.
    """

    method: str
    cell: str
    body: str
    images: int
    error: float
    regions: int
    inside: int
    fine: int
    fine_doubted: int
    far: int
    far_doubted: int
    trusted_images: int
    far_trusted: int
    refined: int


def judge(
    method: Method,
    cell: Cell,
    body: str,
    images: Landmarks,
    truth: Shapes,
    dictionary: shapefit.Dictionary,
) -> Judged:
    """Lift images of a body in a cell by a method; return how many are fine and far by
    the truth, and how many of each are trusted.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = shapefit.fit(
            images,
            dictionary,
            method=method,
            lam=0.1,
            prior=PRIORS[method],
        )
    measured = measure_file(Path(method), fit, truth, JUDGED)
    error = measured.errors["similarity", "normalised"]
    assert measured.bars is not None
    square = measured.bars.square[~np.isnan(measured.bars.square)]
    trusted = np.asarray(fit.trusted, bool)
    fine = error < FINE
    far = error > FAR
    noise = fit.sequence_noise
    if noise is None:
        noise = np.full(len(error), np.nan)
    return Judged(
        method=method,
        cell=cell.name,
        body=body,
        images=len(error),
        error=float(np.nansum(error)),
        regions=len(square),
        inside=int((square <= WIDTH_SQUARED_RADIUS).sum()),
        fine=int(fine.sum()),
        fine_doubted=int((fine & ~trusted).sum()),
        far=int(far.sum()),
        far_doubted=int((far & ~trusted).sum()),
        trusted_images=int(trusted.sum()),
        far_trusted=int((far & trusted).sum()),
        refined=int(np.isfinite(noise).sum()),
    )


def learn_without(body: str, data: Path) -> shapefit.Dictionary:
    """Return a dictionary of all bodies but one, learned once, in one iteration."""
    path = FOLDER / f"without-{body}.h5"
    if not path.exists():
        bodies = read_bodies(data, ("subject86", "other_subjects"))
        files = []
        for name, shapes in bodies.items():
            if name != body:
                files.append(FOLDER / f"body-{name}.h5")
                write_shapes(files[-1], shapes)
        run(
            "learn-dict",
            "-c",
            CONFIGS / "people/learn-box.yaml",
            "-o",
            path,
            *map(str, files),
            "--set",
            "iterations=1",
            "--set",
            "every=12",
        )
    return shapefit.read_dictionary(path)


def summary_cells(rows: Iterable[Judged]) -> list[str]:
    """Return a line of the table without its first two cells: how many images there
    are, and means and shares over some rows.
    """
    total = {
        field.name: sum(getattr(row, field.name) for row in rows)
        for field in fields(Judged)
        if field.type in ("int", "float")
    }

    def share(part: str, whole: str) -> str:
        count = total[whole]
        return f"{total[part] / count:.3f}" if count else "-"

    return [
        f"{total['images']:,}",
        share("error", "images"),
        share("inside", "regions"),
        share("fine_doubted", "fine"),
        share("far_doubted", "far"),
        share("trusted_images", "images"),
        share("far_trusted", "trusted_images"),
        share("refined", "images"),
    ]


HEADER = (
    "method",
    "cell",
    "images",
    "error",
    "in 90% regions",
    "fine doubted",
    "far doubted",
    "trusted",
    "far of the trusted",
    "refined",
)


def table(rows: list[Judged]) -> str:
    """Return a table in Markdown: a line for each method and cell, and for each method
    over all cells.
    """
    lines = []
    for method in PRIORS:
        of_method = [row for row in rows if row.method == method]
        for cell in CELLS:
            of_cell = [row for row in of_method if row.cell == cell.name]
            if of_cell:
                lines.append([method, cell.name, *summary_cells(of_cell)])
        if of_method:
            lines.append([method, "all", *summary_cells(of_method)])
    return markdown_table(HEADER, lines)


def write(rows: list[Judged]) -> None:
    """Write the rows as CSV and the table as a page."""
    with atomic_path(FOLDER / "rows.csv") as path, path.open("w", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Judged)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    write_page(FOLDER, f"# Verdicts\n\n{table(rows)}\n")


def main() -> None:
    """Simulate detections of all bodies in all cells, lift and judge them, and write
    the table.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA / "mocap")
    parser.add_argument("--bodies", nargs="*", default=CHOSEN_ON)
    parser.add_argument("--methods", nargs="*", default=[*PRIORS], choices=[*PRIORS])
    given = parser.parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    rows = []
    bodies = read_bodies(given.data, ("other_subjects",), given.bodies)
    for body, shapes in bodies.items():
        dictionary = learn_without(body, given.data)
        for cell in CELLS:
            rng = np.random.default_rng([int(body), CLIPS])
            clips = choose_clips(shapes, CLIPS, LONGEST_SECONDS, rng)
            images, truth = film(shapes, clips, rng, cell)
            for method in given.methods:
                chosen = slice(None, None, EVERY if method == "posterior" else 1)
                rows.append(
                    judge(
                        method,
                        cell,
                        body,
                        images.take(chosen),
                        truth.take(chosen),
                        dictionary,
                    )
                )
        print(body, flush=True)
        write(rows)
    print(table(rows))


if __name__ == "__main__":
    main()
