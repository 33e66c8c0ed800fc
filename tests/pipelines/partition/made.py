"""A dictionary of eight landmarks, numbered images of them, and the folder of results
`out`.
"""

import json
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from shapefit.arrays import Floats
from shapefit.dictionary.model import Dictionary
from shapefit.io import write_dictionary
from shapefit.records import Landmarks
from tests.io.files import save

NAMES = tuple("abcdefgh")


def make_dictionary(path: Path, rng: np.random.Generator) -> None:
    """Write six atoms."""
    atoms = rng.normal(size=(6, 3, len(NAMES)))
    atoms -= atoms.mean(axis=2, keepdims=True)
    write_dictionary(path, Dictionary(atoms, NAMES, atoms[0]))


def make_images(
    path: str | Path, points: Floats, first: int = 0, **fields: Any
) -> None:
    """Write images of points (n, 2, 8), numbered from the first."""
    items = tuple(f"i{n}" for n in range(first, first + len(points)))
    save(
        Path(path),
        Landmarks(points.swapaxes(1, 2), landmark_names=NAMES, items=items, **fields),
    )


def entries(folder: Path = Path("out")) -> list[dict[str, Any]]:
    """Return the lines of the parts in the manifest, in the order of their files."""
    lines = (folder / "manifest.jsonl").read_text().splitlines()[1:]
    return sorted(map(json.loads, lines), key=lambda entry: entry["file"])


OF_CONVEX = {"item", "shapes", "coefficients", "objective", "rotation"}


def same_bits(
    parts: Iterable[Path], whole: Path, among: Collection[str] = OF_CONVEX
) -> None:
    """Assert that results are, one after the other, those of one run; `among` their
    datasets.
    """
    parts = list(parts)
    with h5py.File(whole) as expected:
        count = len(expected["item"])
        names = [name for name, each in expected.items() if each.shape[:1] == (count,)]
        assert set(among) <= set(names)
        for name in names:
            pieces = []
            for part in parts:
                with h5py.File(part) as file:
                    pieces.append(file[name][:])
            np.testing.assert_array_equal(
                np.concatenate(pieces), expected[name][:], err_msg=name
            )
