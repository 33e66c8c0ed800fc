"""How fast files of trackers are read: `python -m benchmarks.reading [FRAMES]`.

Files of one animal with 25 landmarks are made, and read as every command reads them, one after
the other, three times; the best time counts. Fails below the floor.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.tracker_files import WRITERS
from shapefit.io import open_landmarks

FRAMES, LANDMARKS, TURNS = 100_000, 25, 3
FLOOR = 50_000
"""Frames a second below which this fails."""

CASES = ("table.csv", "table.h5", "tracks.analysis.h5", "labels.slp")

CHUNK = 4096


def measure(path: Path) -> tuple[int, float]:
    """Return the number of images of a file, and the seconds that reading it takes."""
    best, count = float("inf"), 0
    for _ in range(TURNS):
        start = time.process_time()
        with open_landmarks([path]) as source:
            count = sum(len(chunk) for chunk in source.batches(CHUNK))
        best = min(best, time.process_time() - start)
    return count, best


def main() -> int:
    """Measure all formats and print a table; 1 if one is slower than the floor."""
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else FRAMES
    rng = np.random.default_rng(0)
    points = (640 * rng.random((frames, 1, LANDMARKS, 2), np.float32)).astype(np.float64)
    confidence = rng.random((frames, 1, LANDMARKS), np.float32).astype(np.float64)
    slow = 0
    print("| file | frames | MB | seconds | frames/s |\n|---|--:|--:|--:|--:|")
    with tempfile.TemporaryDirectory() as folder:
        for name in CASES:
            path = Path(folder) / name
            WRITERS[name](path, points, confidence)
            count, seconds = measure(path)
            size = path.stat().st_size / 1e6
            print(f"| {name} | {count:,} | {size:.0f} | {seconds:.2f} | {count / seconds:,.0f} |")
            slow += count / seconds < FLOOR
            path.unlink()
    return int(slow > 0)


if __name__ == "__main__":
    sys.exit(main())
