"""Whether pictures whose x and y have different scales are told from right ones.

`python -m benchmarks.stretched --data FOLDER` films clips of seven bodies whom the
dictionary does not know (`benchmarks.footage`), stretches them, lifts each clip alone
by `posterior`, and counts those of which a warning says that x and y have different
scales. Right clips come from several cells, stretched ones show whole bodies.
"""

from __future__ import annotations

import argparse
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

import shapefit
from benchmarks.coverage import DATA, read_bodies
from benchmarks.footage import (
    BASE,
    CELLS,
    CHOSEN_ON,
    SIZE,
    choose_clips,
    film,
)
from benchmarks.verdicts import FOLDER, LONGEST_SECONDS, learn_without
from shapefit.lifting.trust import STRETCHED
from shapefit.records import Landmarks

CLIPS = 6
"""Clips of each body in each cell; not those on which the limits were chosen."""

RIGHT_CELLS = ("whole body", "4 m away", "turns", "walks off", "focal length 30% short")

STRETCHES = {
    "right": (1.0, 1.0),
    "x by 1/2": (0.5, 1.0),
    "x by 2": (2.0, 1.0),
    "y by 1/2": (1.0, 0.5),
    "y by 2": (1.0, 2.0),
    "percent of the image": (100 / SIZE[0], 100 / SIZE[1]),
}


def is_stretch_reported(images: Landmarks, dictionary: shapefit.Dictionary) -> bool:
    """Whether a fit of the images warns that x and y have different scales."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        shapefit.fit(images, dictionary, method="posterior")
    return any(STRETCHED in str(warning.message) for warning in caught)


def stretch(images: Landmarks, factors: tuple[float, float]) -> Landmarks:
    """Return images with x and y multiplied by factors, and without the size of the
    images unless both are 1.
    """
    stretched = images.with_points(images.landmarks * np.array(factors))
    return stretched if factors == (1.0, 1.0) else stretched.without(["image_size"])


def main() -> None:
    """Simulate detections in clips, stretch and lift them; print in how many clips of
    each kind a stretch is reported.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA / "mocap")
    given = parser.parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    clips_seen = Counter[str]()
    clips_named = Counter[str]()
    for body, shapes in read_bodies(given.data, ("other_subjects",), CHOSEN_ON).items():
        dictionary = learn_without(body, given.data)
        for cell in CELLS:
            if cell.name not in RIGHT_CELLS:
                continue
            rng = np.random.default_rng([int(body), CLIPS])
            clips = choose_clips(shapes, CLIPS, LONGEST_SECONDS, rng)
            images, _ = film(shapes, clips, rng, cell)
            names = np.array(images.sequences)
            for name in np.unique(names):
                clip = images.take(np.flatnonzero(names == name))
                for kind, factors in STRETCHES.items():
                    if kind == "right" or cell == BASE:
                        clips_seen[kind] += 1
                        stretched = stretch(clip, factors)
                        named = is_stretch_reported(stretched, dictionary)
                        clips_named[kind] += named
        print(body, flush=True)
    for kind, count in clips_seen.items():
        print(f"{kind}: {clips_named[kind]} of {count} named")


if __name__ == "__main__":
    main()
