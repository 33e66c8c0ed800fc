"""Landmarks in our own formats: `python -m benchmarks.stored [IMAGES]`.

Images of 15 landmarks with confidence are written in HDF5 and in Parquet, chunk by chunk, and read
as every command reads them. Numbers are random in all their digits, or as trackers have them, in
single precision. Times are of the processor, the best of three.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.reading import CHUNK, TURNS, measure
from shapefit.io import LandmarkSet, landmark_writer

IMAGES, LANDMARKS = 1_000_000, 15
SUFFIXES = ("h5", "parquet")


def make_chunks(images: int, *, single: bool) -> Iterator[LandmarkSet]:
    """Yield images that move as a video does, with noise."""
    rng = np.random.default_rng(0)
    for start in range(0, images, CHUNK):
        count = min(CHUNK, images - start)
        motion = np.cumsum(rng.normal(size=(count, 2, LANDMARKS)), axis=0)
        points, confidence = 320 + motion, rng.random((count, LANDMARKS))
        if single:
            points, confidence = (
                values.astype(np.float32).astype(np.float64) for values in (points, confidence)
            )
        yield LandmarkSet(
            landmarks=points,
            confidence=confidence,
            landmark_names=tuple(f"landmark {number}" for number in range(LANDMARKS)),
            items=tuple(f"video/{number:09}" for number in range(start, start + count)),
            sequences=("video",) * count,
        )


def write(path: Path, images: int, *, single: bool) -> float:
    """Write a file; returns the seconds that writing took."""
    seconds = 0.0
    with landmark_writer(path) as writer:
        for chunk in make_chunks(images, single=single):
            start = time.process_time()
            writer.append(chunk)
            seconds += time.process_time() - start
    return seconds


def main() -> int:
    """Measure both formats and print a table."""
    images = int(sys.argv[1]) if len(sys.argv) > 1 else IMAGES
    print("| file | bytes per image | written, images/s | read, images/s |\n|---|--:|--:|--:|")
    with tempfile.TemporaryDirectory() as folder:
        for single in (False, True):
            for suffix in SUFFIXES:
                path = Path(folder) / f"landmarks.{suffix}"
                written = min(write(path, images, single=single) for _ in range(TURNS))
                count, read = measure(path)
                name = f"{suffix}, {'single' if single else 'double'} precision"
                size = path.stat().st_size / images
                rates = f"{images / written:,.0f} | {count / read:,.0f}"
                print(f"| {name} | {size:.0f} | {rates} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
