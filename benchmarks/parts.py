"""`fit` into a folder, two processes, beside plain `fit`: rates per core, and the cost of a part.

All sides run in turns on tiled sample data, as whole commands, in time of the processor of the
commands and of all processes that they started; `threads` is 1. Two cores that are busy at once are
slower than one, so two workers are also compared with two plain fits at once, of half the images.

    python -m benchmarks.parts [IMAGES] [TURNS]
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.processes import spent
from shapefit.io import landmark_writer, open_landmarks
from shapefit.io.records import LandmarkSet

PROJECT = Path(__file__).resolve().parents[1]
SHAPEFIT = Path(sys.executable).with_name("shapefit")
PARTITION = 100_000
SMALL = 6_400
"""Images per part of the runs that show what a part costs by itself."""

BASES = ("fit", "2 fits at once")
"""Sides that the others are compared with."""

NOISE = 1.0
"""Pixels that tiles differ by, so that no two images are equal."""


def tile(path: Path, count: int, first: int = 0) -> None:
    """Write `count` images from the `first`: the people of the sample data again, with noise."""
    rng = np.random.default_rng(first)
    with open_landmarks((PROJECT / "sample_data/people_views.csv",)) as source:
        (one,) = source.batches(count)
    block = len(one) * 1000
    with landmark_writer(path) as writer:
        for start in range(first, first + count, block):
            rows = np.arange(start, min(start + block, first + count))
            points = one.landmarks[rows % len(one)]
            points = points + NOISE * rng.standard_normal(points.shape)
            items = tuple(f"image/{row:08}" for row in rows)
            writer.append(
                LandmarkSet(landmarks=points, landmark_names=one.landmark_names, items=items)
            )


def processor_seconds(*commands: tuple[object, ...], folder: Path) -> float:
    """Run commands of shapefit at once; return their seconds of processor, children included."""
    before = spent()
    running = [
        subprocess.Popen([str(SHAPEFIT), *map(str, words), "-q", "--set", "threads=1"], cwd=folder)
        for words in commands
    ]
    codes = [process.wait() for process in running]
    if any(codes):
        raise SystemExit("a fit failed")
    return spent() - before


def fit(*words: object) -> tuple[object, ...]:
    return ("fit", "-d", "dict.h5", *words)


def main(count: int = 400_000, turns: int = 3) -> None:
    """Print the rates of all sides, their ratios, and the seconds that a part costs."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        config = PROJECT / "configs/demo/learn-dict.yaml"
        subprocess.run(
            [str(SHAPEFIT), "learn-dict", "-c", str(config), "-o", "dict.h5", "-q"],
            cwd=folder,
            check=True,
        )
        views = ("views-0.h5", "views-1.h5")
        for number, path in enumerate(views):
            tile(folder / path, count // 2, first=number * (count // 2))
        parts = fit(*views, "-o", "parts/", "--set", f"partition={PARTITION}")
        small = fit(*views, "-o", "parts/", "--set", f"partition={SMALL}")
        sides: dict[str, list[tuple[object, ...]]] = {
            "fit": [fit(*views, "-o", "one.h5")],
            "parts": [parts],
            "2 fits at once": [fit(path, "-o", f"of-{path}") for path in views],
            "2 workers": [(*parts, "--workers", 2)],
            "small parts": [small],
        }
        seconds = {side: [] for side in sides}  # type: dict[str, list[float]]
        for _ in range(turns):
            for side, commands in sides.items():
                shutil.rmtree(folder / "parts", ignore_errors=True)
                seconds[side].append(processor_seconds(*commands, folder=folder))
        for side, each in seconds.items():
            median = float(np.median(each))
            of = {base: np.median(np.array(seconds[base]) / each) for base in BASES}
            ratios = ", ".join(f"{ratio:.2f} of {base}" for base, ratio in of.items())
            print(f"{side}: {median:.1f} s of processor, {count / median:,.0f} images/s, {ratios}")
        more = -(-count // SMALL) - -(-count // PARTITION)
        extra = np.median(np.array(seconds["small parts"]) - seconds["parts"])
        print(f"a part costs {extra / more:.3f} s by itself")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
