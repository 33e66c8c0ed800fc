"""Figures that pages state, and the same figures measured again: they agree within 2%.

A page rounds, which adds half of its last digit.
"""

import contextlib
import csv
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from shapefit.cli.main import run as run_command

from shapefit.records import Landmarks
from tests.io.files import load, save

BAND = 0.02


Run = Callable[..., None]


def within(figure: float, stated: str) -> bool:
    """Whether a figure is the stated one within the band and its rounding."""
    digit_count = len(stated.partition(".")[2])
    rounding = 0.5 * 10**-digit_count
    return abs(figure - float(stated)) <= BAND * float(stated) + rounding


FOLDERS_OF_RESULTS = ("demo/cars", "mocap/best", "paper", "people", "cars")


def runner(project: Path, folder: Path, *settings: str) -> Run:
    """Return what runs a command with a config of `configs/`, into `folder/results`."""
    shutil.copytree(project / "configs", folder / "configs")
    (folder / "sample_data").symlink_to(project / "sample_data")

    def run(command: str, config: str, *more: str) -> None:
        for name in FOLDERS_OF_RESULTS:
            (folder / "results" / name).mkdir(parents=True, exist_ok=True)
        path = folder / f"configs/{config}.yaml"
        line = [command, "-c", str(path.relative_to(folder)), *more]
        if command != "fit" or "data:" in path.read_text("utf-8"):
            for setting in settings:
                line += ["--set", setting]
        if command == "eval":
            line += ["--set", "plots=none"]
        with contextlib.chdir(folder):
            code = run_command(line)
        assert code in (0, 1), line

    return run


def read_report(path: Path) -> list[dict[str, str]]:
    """Return the rows of a report."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


Kind = tuple[str, str, str, str]
"""Method, metric, unit and group."""


def report(path: Path) -> dict[Kind, tuple[float, float]]:
    """Return mean and median of each method, metric, unit and group of a report."""
    figures = {}
    for row in read_report(path):
        if row["sequence"] or not row["mean"] or not row["median"]:
            continue
        kind = (row["method"], row["metric"], row["unit"], row["group"])
        figures[kind] = (float(row["mean"]), float(row["median"]))
    return figures


def rows_below_the_header(rows: dict[str, list[str]]) -> dict[str, list[str]]:
    """Return the rows of a table without its header and the line below it."""
    _header, _line, *names = rows
    return {name: rows[name] for name in names}


def table(page: Path, first: str) -> dict[str, list[str]]:
    """Return the rows of the table of a page whose header begins with `first`, by first
    cell.
    """
    rows = rows_of(page.read_text(encoding="utf-8"), first)
    assert rows, f"{page} has no table that begins with {first!r}"
    return rows


def rows_of(text: str, first: str = "") -> dict[str, list[str]]:
    """Return the rows of the first such table of a text, by first cell."""
    rows: dict[str, list[str]] = {}
    for line in text.splitlines():
        if not rows and not line.startswith(f"| {first}"):
            continue
        if not line.startswith("|"):
            break
        cells = [cell.strip(" *") for cell in line.strip("|").split("|")]
        rows[cells[0]] = cells[1:]
    return rows


def keep_images(path: Path, which: Callable[[Landmarks], np.ndarray]) -> int:
    """Keep of a file the images that `which` finds, by number; return how many."""
    images = load(path)
    few = which(images)
    save(path, images.take(few))
    return len(few)


TABLE_FITS = ("convex", "alternate", "alternate-plus", "pmp")


FURTHER_FITS = ("alternate-six-views", "refine", "mean-shape")
"""Fits of the paper's table, and what `make paper` adds to them."""


PAPER_TABLE = "method               | Subject 13"
