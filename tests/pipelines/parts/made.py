"""A dictionary of eight landmarks, and numbered images of them."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from shapefit.arrays import Floats
from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSet, write_dictionary
from tests.io.files import save

NAMES = tuple("abcdefgh")


def make_dictionary(path: Path, rng: np.random.Generator) -> None:
    """Write six atoms."""
    atoms = rng.normal(size=(6, 3, len(NAMES)))
    atoms -= atoms.mean(axis=2, keepdims=True)
    write_dictionary(path, Dictionary(atoms, NAMES, atoms[0]))


def make_images(path: str | Path, points: Floats, first: int = 0, **fields: Any) -> None:
    """Write images of points (n, 2, 8), numbered from the first."""
    items = tuple(f"i{n}" for n in range(first, first + len(points)))
    save(Path(path), LandmarkSet(landmarks=points, landmark_names=NAMES, items=items, **fields))


def same_bits(parts: Iterable[str], whole: str) -> None:
    """Assert that the results in the folder out are, one after the other, those of one run."""
    with h5py.File(whole) as expected:
        for name in ("item", "shapes", "dual", "coefficients", "objective"):
            pieces = []
            for part in parts:
                with h5py.File(f"out/{part}") as file:
                    pieces.append(file[name][:])
            np.testing.assert_array_equal(np.concatenate(pieces), expected[name][:])
