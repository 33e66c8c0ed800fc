"""Files of trackers of animals, spoiled as our own are."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from random import Random

import h5py
import numpy as np

from benchmarks.tracker_files import WRITERS

from .csv_cases import spoiled_csv
from .hdf5_cases import CHANGES, spoiled_hdf5


def write_tracker_files(folder: Path) -> None:
    """Write a small file of each format: five frames of two animals of four landmarks."""
    rng = np.random.default_rng(0)
    points = rng.integers(1, 600, (5, 2, 4, 2)).astype(float)
    confidence = rng.uniform(size=(5, 2, 4))
    for name, write in WRITERS.items():
        write(folder / name, points, confidence)


def spoil_groups(rng: Random, path: Path) -> None:
    """Change datasets and attributes of a group of the file."""
    with h5py.File(path, "a") as file:
        groups = [file]
        file.visititems(lambda _, node: groups.append(node) if hasattr(node, "keys") else None)
        group = rng.choice(groups)
        for _ in range(rng.choice((1, 1, 2))):
            with suppress(IndexError, KeyError, TypeError, ValueError, RuntimeError, OSError):
                rng.choice(CHANGES)(rng, group)


def make(rng: Random, folder: Path) -> tuple[str, ...]:
    """Spoil one of the files, and convert it."""
    name = rng.choice(list(WRITERS))
    if name.endswith(".csv"):
        with suppress(ValueError, IndexError):  # changes that need a row with cells
            spoiled_csv(rng, folder / name)
    elif rng.random() < 0.5:
        spoiled_hdf5(rng, folder / name)
    else:
        spoil_groups(rng, folder / name)
    return ("convert", name, "-o", rng.choice(("out.h5", "out.csv")))
