"""`eval` of results in parts: time of the processor and memory, for more and more images.

The sample data is tiled with noise, written as a truth and as results of a hundred thousand images
each, with error bars and plausibilities; nothing is fitted. `PYTHON` names the Python of another
installation of the package, which is then measured, too, in turns.

    python -m benchmarks.reports [IMAGES,IMAGES,...] [PYTHON] [TURNS]
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.parts import PROJECT
from benchmarks.processes import watch
from shapefit.io import read_shapes, result_writer, write_shapes
from shapefit.io.records import ResultSet, ShapeSet

PART = 100_000
"""Images of a result file, and shapes of a file of the truth."""

IN_A_SEQUENCE = 5_000
NOISE = 0.05
"""Deviation of an estimated landmark from the true one, as a share of the spread of its shape."""

RUN = "import sys; from shapefit.cli.main import run; sys.exit(run(sys.argv[1:]))"
"""The command of whatever installation runs it."""


def write_part(folder: Path, number: int, start: int, count: int) -> None:
    """Write the true shapes and the results of images from `start` on."""
    rng = np.random.default_rng(number)
    people = read_shapes((PROJECT / "sample_data/people_test.h5",))
    rows = np.arange(start, start + count)
    spread = people.shapes.std()
    true = people.shapes[rows % len(people)]
    true = true + NOISE * spread * rng.standard_normal(true.shape)
    items = tuple(f"image/{row:09}" for row in rows)
    sequences = tuple(f"sequence/{row // IN_A_SEQUENCE:06}" for row in rows)
    names = people.landmark_names
    truth = ShapeSet(true, names, items, sequences, unit=people.unit)
    write_shapes(folder / f"truth-{number:05}.h5", truth)
    error = NOISE * spread * rng.standard_normal(true.shape)
    deviation = np.full(true.shape, NOISE * spread)
    results = ResultSet(
        shapes=true + error,
        shape_sd=deviation,
        landmark_names=names,
        items=items,
        sequences=sequences,
        unit=people.unit,
        rotation=np.tile(np.eye(3), (count, 1, 1)),
        columns={
            "true_rotation": np.tile(np.eye(3), (count, 1, 1)),
            "plausibility": rng.uniform(size=count),
        },
    )
    with result_writer(folder / f"part-{number:05}.h5") as writer:
        writer.append(results)


def measure(python: str, folder: Path) -> tuple[float, float]:
    """Return seconds of processor and peak bytes of one `eval` of all parts, without viewer."""
    shutil.rmtree(folder / "report", ignore_errors=True)
    command = [python, "-c", RUN, "eval", "-o", "report", "-q", "--set", "view=false"]
    parts = [str(path) for path in sorted(folder.glob("part-*.h5"))]
    command += ["--set", f"results={json.dumps({'fit': parts})}", "--truth", "truth-*.h5"]
    found = watch(command, folder)
    return found.processor, found.peak


def main(counts: str = "200000,1000000", python: str = "", turns: str = "1") -> None:
    """Print seconds, images per second and megabytes of each size, for each installation."""
    sides = [sys.executable, *([python] if python else [])]
    print("images\tpython\tseconds\timages/s\tMB")
    with TemporaryDirectory() as name:
        folder = Path(name)
        written = 0
        for count in sorted(map(int, counts.split(","))):
            for number in range(written, -(-count // PART)):
                write_part(folder, number, number * PART, min(PART, count - number * PART))
            written = -(-count // PART)
            measured: dict[str, list[tuple[float, float]]] = {side: [] for side in sides}
            for _ in range(int(turns)):
                for side in sides:
                    measured[side].append(measure(side, folder))
            for side, found in measured.items():
                seconds = median(each for each, _ in found)
                peak = max(each for _, each in found) / 1e6
                print(f"{count}\t{side}\t{seconds:.1f}\t{count / seconds:.0f}\t{peak:.0f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
