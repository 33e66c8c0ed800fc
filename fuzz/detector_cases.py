"""Files of detectors of people: JSON with wrong values in any place, and text cut anywhere."""

from __future__ import annotations

import json
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from benchmarks.detector_files import WRITERS

from .csv_cases import SPOILS
from .hdf5_cases import spoil_bytes

VALUES: tuple[Any, ...] = (
    *(None, True, False, -1, 0, 1, 2.5, 1e308, -1e308, 10**18, 10**30, float("nan"), float("inf")),
    *("", "a", "0", [], {}, [[]], [{}], {"a": 1}, [1], [1, 2, 3], [None], ["x"], [1, [2], 3]),
)
KEYS = ("images", "people", "id", "track_id", "idx", "person_id", "instances", "keypoints")


def write_detector_files(folder: Path) -> None:
    """Write small files of each format: four frames of two people of five landmarks."""
    rng = np.random.default_rng(0)
    points = rng.integers(1, 600, (4, 2, 5, 2)).astype(float)
    confidence = rng.uniform(size=(4, 2, 5))
    for name, write in WRITERS.items():
        write(folder / name, points, confidence)


def _places(found: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if path:
        yield path
    keys = found if isinstance(found, dict) else range(len(found) if isinstance(found, list) else 0)
    for key in keys:
        yield from _places(found[key], (*path, key))


def _spoil_json(rng: Random, found: Any) -> None:
    """Replace, drop, repeat or add a value somewhere."""
    places = list(_places(found))
    if not places:
        return
    *way, last = rng.choice(places)
    for key in way:
        found = found[key]
    kind = rng.random()
    if kind < 0.6:
        found[last] = deepcopy(rng.choice(VALUES))  # since it may be spoiled next
    elif kind < 0.8:
        del found[last]
    elif isinstance(found, list):
        found.insert(last, deepcopy(found[last]))
    else:
        found[rng.choice(KEYS)] = deepcopy(rng.choice(VALUES))


def make(rng: Random, folder: Path) -> tuple[str, ...]:
    """Spoil a file of one of the formats, and convert what it is part of."""
    name = rng.choice(list(WRITERS))
    path = spoil_file(rng, folder / name)
    track = rng.choice(("nearest", "none"))
    given = name if rng.random() < 0.7 else str(path.relative_to(folder))
    return ("convert", given, "-o", rng.choice(("out.h5", "out.csv")), "--set", f"track={track}")


def spoil_file(rng: Random, path: Path) -> Path:
    """Spoil a file, or one in this folder; returns which."""
    if path.is_dir():
        path = rng.choice(sorted(path.iterdir()))
    if path.suffix == ".json" and rng.random() < 0.8:
        found = json.loads(path.read_text("utf-8"))
        for _ in range(rng.choice((1, 1, 2, 3))):
            _spoil_json(rng, found)
        path.write_text(json.dumps(found), encoding="utf-8")
    elif path.suffix.startswith(".np"):
        spoil_bytes(rng, path)
    else:
        path.write_bytes(rng.choice(SPOILS)(rng, path.read_bytes()))
    return path
