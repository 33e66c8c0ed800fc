"""What the benchmarks on real data share: commands, bodies of motion capture, tables of
errors.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from shapefit.evaluation.report import markdown_table
from shapefit.io import (
    landmark_writer,
    open_landmarks,
    read_shapes,
)
from shapefit.io.atomic import atomic_path
from shapefit.records import Landmarks, Shapes

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
DATA = Path("../shared/data")
WITH_BARS = ("posterior", "sequences")


def run(*arguments: str | Path, failures: bool = False) -> None:
    """Run a command of shapefit. Raises SystemExit where it fails; with `failures`
    single items may.
    """
    command = [str(Path(sys.executable).with_name("shapefit")), *map(str, arguments)]
    code = subprocess.run(command, check=False, stdout=subprocess.DEVNULL).returncode
    if code and not (failures and code == 1):
        raise SystemExit(f"failed: {' '.join(command)}")


def set_options(values: Sequence[str]) -> list[str]:
    """Return the options `--set VALUE` for values such as "key=1"."""
    return [part for value in values for part in ("--set", value)]


def read_bodies(
    data: Path, files: Sequence[str], wanted: Sequence[str] = ()
) -> dict[str, Shapes]:
    """Return body -> its shapes in the files, for the wanted bodies or all; a body is
    the number that the names of its sequences begin with.
    """
    bodies: dict[str, Shapes] = {}
    for name in files:
        shapes = read_shapes([data / f"{name}_24fps.h5"])
        numbers = np.array(
            [sequence.split("_")[0] for sequence in shapes.sequences or ()]
        )
        for body in wanted or dict.fromkeys(numbers.tolist()):
            if (numbers == body).any():
                bodies[body] = shapes.take(np.flatnonzero(numbers == body))
    return bodies


def read_images(path: Path) -> Landmarks:
    """Read all images of a file."""
    with open_landmarks([path]) as source:
        return source.whole()


def write_images(path: Path, images: Landmarks) -> Path:
    """Write images to a file, in its folder; return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with landmark_writer(path) as writer:
        writer.append(images)
    return path


def mean_errors(report: Path) -> dict[tuple[str, str], float]:
    """Return (method, unit) -> mean similarity error in a report of `eval`, its
    JSON.
    """
    summaries = json.loads(report.read_text(encoding="utf-8"))["summaries"]
    return {
        (row["method"], row["unit"]): row["mean"]
        for row in summaries
        if row["metric"] == "similarity" and row["sequence"] is None
    }


def error_cells(report: Path, methods: Sequence[str]) -> list[str]:
    """Return the mean normalised error of each method in a report as a text, with
    millimetres where the truth is in metres; "" for a method that it lacks.
    """
    found = mean_errors(report)
    texts = []
    for method in methods:
        error, metres = (found.get((method, unit)) for unit in ("normalised", "m"))
        text = "" if error is None else f"{error:.3f}"
        texts.append(text if metres is None else f"{text} ({1000 * metres:.3g} mm)")
    return texts


def coverage_cells(report: Path) -> list[str]:
    """Return the calibration of each method with error bars in a report as a text: the
    shares of the truth inside the 50% and 90% ellipsoids, and their normalised width.
    """
    texts = {}
    for row in json.loads(report.read_text(encoding="utf-8"))["calibration"]:
        half, most = (f"{100 * share:.0f}%" for share in row["inside"])
        texts[row["method"]] = (
            f"{half} / {most} / {row['median_width']['normalised']:.2f}"
        )
    return [texts.get(method, "") for method in WITH_BARS]


def write_page(folder: Path, text: str) -> None:
    """Write a page in Markdown as index.md in the folder, and print it."""
    with atomic_path(folder / "index.md") as path:
        path.write_text(text, encoding="utf-8")
    print(text)


def errors_and_bars(
    title: str, header: list[str], errors: list[list[str]], bars: list[list[str]]
) -> str:
    """Return a page in Markdown with a table of errors, of rows by `error_cells`, and
    one of error bars, of rows by `coverage_cells`; each row begins with the name of a
    set.
    """
    table = markdown_table(header, errors)
    table_of_bars = markdown_table([header[0], *WITH_BARS], bars)
    return (
        f"{title}\n\nMean similarity error, normalised.\n\n{table}\n\nShare of the"
        " truth inside the 50% and the 90% ellipsoids of the error bars, and the"
        f" median width of the latter, normalised.\n\n{table_of_bars}\n"
    )
