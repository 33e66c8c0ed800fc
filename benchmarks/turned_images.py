"""How far shapes depend on the rotation of an image in its plane.

`python -m benchmarks.turned_images` lifts every 60th image of `make mocap-table` as it
is and turned, by the dictionary of subject 86 or that of the package, and prints how
far the shapes lie apart after the best similarity, in sizes of the shape.
"""

from __future__ import annotations

import argparse
import warnings
from pathlib import Path

import numpy as np

import shapefit
from shapefit.api.arguments import Method
from shapefit.arrays import Floats
from shapefit.evaluation.metrics import similarity_error
from shapefit.evaluation.report import markdown_table
from shapefit.geometry.normalisation import std
from shapefit.records import Landmarks

EVERY = 60
DEGREES = 37.0
FAR = 0.1
"""Sizes of the shape by which few shapes change."""


def rotate_images(images: Landmarks, degrees: float) -> Landmarks:
    """Return images rotated in their plane about its origin, by degrees."""
    angle = np.radians(degrees)
    c, s = np.cos(angle), np.sin(angle)
    rotation = np.array([[c, -s], [s, c]])
    return images.replaced(landmarks=images.landmarks @ rotation.T)


def measure_change(images: Landmarks, dictionary: str, method: Method) -> Floats:
    """Return the similarity error (n,) between the shapes of images and those of the
    images rotated by DEGREES, as a share of the size of the shape.
    """
    upright = shapefit.fit(images, dictionary, method=method).as_columns()
    rotated = rotate_images(images, DEGREES)
    turned = shapefit.fit(rotated, dictionary, method=method).as_columns()
    change: Floats = similarity_error(upright, turned) / std(turned)
    return change


def main() -> None:
    """Print a table of how far shapes change, a row for each method."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("results/mocap"))
    folder = parser.parse_args().folder
    warnings.simplefilter("ignore")
    images = shapefit.read_landmarks(folder / "landmarks.h5")
    images = images.take(np.arange(0, len(images), EVERY))
    own = str(folder / "dictionary.h5")
    rows = []
    methods: dict[Method, str] = {
        "convex": own,
        "convex+refine": own,
        "posterior": "people",
    }
    for method, dictionary in methods.items():
        change = measure_change(images, dictionary, method)
        middle, most = np.nanmedian(change), np.nanmax(change)
        far = np.mean(change > FAR)
        rows.append((f"`{method}`", f"{middle:.4f}", f"{most:.4f}", f"{far:.1%}"))
    print(markdown_table(("", "median", "most", "by more than 0.1"), rows))


if __name__ == "__main__":
    main()
