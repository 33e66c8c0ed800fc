"""`learn-dict` in batches beside all shapes at once: the objective, passes, seconds, memory.

The sample data is tiled with noise. Each command runs as a process of its own; the memory is the
most that it held.

    python -m benchmarks.batches [SHAPES] [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.parts import PROJECT, SHAPEFIT
from benchmarks.processes import watch
from shapefit.io import read_dictionary, read_shapes
from shapefit.io.layout import SHAPES
from shapefit.io.records import ShapeSet
from shapefit.io.writing import record_writer

PARTS = (1, 4, 20, 100)
"""Numbers of batches; 1 is all shapes at once."""

NOISE = 0.02
"""Metres that tiles differ by in every coordinate, so that no two shapes are equal."""


def tile(path: Path, count: int) -> None:
    """Write `count` shapes: the people of the sample data again and again, with noise."""
    rng = np.random.default_rng(0)
    one = read_shapes([PROJECT / "sample_data/people_train.h5"])
    with record_writer(path, SHAPES) as writer:
        for start in range(0, count, 100_000):
            rows = np.arange(start, min(start + 100_000, count))
            shapes = one.shapes[rows % len(one)]
            shapes = shapes + NOISE * rng.standard_normal(shapes.shape)
            writer.append(
                ShapeSet(
                    shapes=shapes,
                    landmark_names=one.landmark_names,
                    items=tuple(f"shape/{row:09}" for row in rows),
                    sequences=tuple(f"sequence/{row // len(one):06}" for row in rows),
                    edges=one.edges,
                    unit=one.unit,
                )
            )


def main(count: int = 1_000_000, folder: str | None = None) -> None:
    """Print a row for each number of batches."""
    with TemporaryDirectory(dir=folder) as name:
        place = Path(name)
        tile(place / "shapes.h5", count)
        print(
            "| batch | objective | rounds over all | seconds | of processor | memory, MB |",
            flush=True,
        )
        whole = None
        for parts in PARTS:
            batch = 0 if parts == 1 else -(-count // parts)
            command = [str(SHAPEFIT), "learn-dict", "shapes.h5", "-o", "dict.h5", "-q"]
            command += ["--set", f"batch={batch}"]
            found = watch(command, place)
            trace = read_dictionary(place / "dict.h5").objective_trace
            whole = trace[-1] if whole is None else whole
            size = f"{batch:,}" if batch else "all"
            print(
                f"| {size} | {trace[-1] / whole:.4f} | {len(trace) // 2} | {found.seconds:.0f} "
                f"| {found.processor:.0f} | {found.peak / 1e6:,.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else 1_000_000, *sys.argv[2:3])
