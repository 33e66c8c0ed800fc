"""A dictionary of eight landmarks, and numbered images of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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
