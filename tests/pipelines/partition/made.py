"""A dictionary of eight landmarks, numbered images of them, and the folder of results
`out`.
"""

import json
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.testing import assert_array_equal

from shapefit.arrays import Floats
from shapefit.dictionary.model import Dictionary
from shapefit.io import write_dictionary
from shapefit.records import Landmarks
from tests.columns import in_rows
from tests.io.files import save

NAMES = tuple("abcdefgh")


def make_dictionary(path: Path, rng: np.random.Generator) -> None:
    """Write six atoms."""
    atoms = rng.normal(size=(6, 3, len(NAMES)))
    atoms -= atoms.mean(axis=2, keepdims=True)
    dictionary = Dictionary(atoms, NAMES, mean_shape=atoms[0])
    write_dictionary(path, dictionary)


def make_images(
    path: str | Path, points: Floats, first: int = 0, **fields: Any
) -> None:
    """Write images of points (n, 2, 8), numbered from the first."""
    numbers = range(first, first + len(points))
    items = tuple(f"i{n}" for n in numbers)
    record = Landmarks(in_rows(points), landmark_names=NAMES, items=items, **fields)
    save(Path(path), record)


def entries(folder: Path = Path("out")) -> list[dict[str, Any]]:
    """Return the lines of the parts in the manifest, in the order of their files."""
    text = (folder / "manifest.jsonl").read_text()
    _, *parts = [json.loads(line) for line in text.splitlines()]
    return sorted(parts, key=lambda entry: entry["file"])


OF_CONVEX = {"item", "shapes", "coefficients", "objective", "rotation"}


def read_joined(parts: Iterable[Path], name: str) -> np.ndarray:
    """Return the rows of a dataset in all parts."""
    pieces = []
    for part in parts:
        with h5py.File(part) as file:
            pieces.append(file[name][:])
    return np.concatenate(pieces)


def same_bits(
    parts: Iterable[Path], whole: Path, among: Collection[str] = OF_CONVEX
) -> None:
    """Assert that results are, one after the other, those of one run; `among` their
    datasets.
    """
    parts = list(parts)
    with h5py.File(whole) as expected:
        count = len(expected["item"])
        rows = {
            name: node[:]
            for name, node in expected.items()
            if node.shape[:1] == (count,)
        }
    assert set(among) <= set(rows)
    for name, values in rows.items():
        joined = read_joined(parts, name)
        assert_array_equal(joined, values, err_msg=name)
