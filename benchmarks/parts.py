"""`fit` into a folder, two processes, beside plain `fit`: rates per core, and the cost of a part.

Both sides run in turns on tiled sample data, as whole commands, in time of the processor of the
command and of all processes that it started; `threads` is 1.

    python -m benchmarks.parts [IMAGES] [TURNS]
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from shapefit.io import landmark_writer, open_landmarks
from shapefit.io.records import LandmarkSet

PROJECT = Path(__file__).resolve().parents[1]
SHAPEFIT = Path(sys.executable).with_name("shapefit")
PARTITION = 100_000
SMALL = 6_400
"""Images per part of the runs that show what a part costs by itself."""

NOISE = 1.0
"""Pixels that tiles differ by, so that no two images are equal."""


def tile(path: Path, count: int, first: int = 0) -> None:
    """Write `count` images from the `first`: the people of the sample data again, with noise."""
    rng = np.random.default_rng(first)
    with open_landmarks((PROJECT / "sample_data/people_views.csv",)) as source:
        (one,) = source.chunks(count)
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


def processor_seconds(*words: object, folder: Path) -> float:
    """Run a command of shapefit; return its seconds of processor, children included."""
    before = os.times()
    command = [str(SHAPEFIT), *map(str, words), "-q", "--set", "threads=1"]
    subprocess.run(command, cwd=folder, check=True)
    after = os.times()
    spent = after.children_user + after.children_system
    return spent - before.children_user - before.children_system


def measure(folder: Path, options: tuple[object, ...]) -> float:
    """Return the processor's seconds of a fit of all images."""
    shutil.rmtree(folder / "parts", ignore_errors=True)
    return processor_seconds("fit", "views.h5", "-d", "dict.h5", *options, folder=folder)


def main(count: int = 400_000, turns: int = 3) -> None:
    """Print the rates of both sides, their ratio, and the seconds that a part costs."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        config = PROJECT / "configs/demo/learn-dict.yaml"
        subprocess.run(
            [str(SHAPEFIT), "learn-dict", "-c", str(config), "-o", "dict.h5", "-q"],
            cwd=folder,
            check=True,
        )
        tile(folder / "views.h5", count)
        parts = ("-o", "parts/", "--set", f"partition={PARTITION}")
        small = ("-o", "parts/", "--set", f"partition={SMALL}")
        sides: dict[str, tuple[object, ...]] = {
            "fit": ("-o", "one.h5"),
            "parts": parts,
            "2 workers": (*parts, "--workers", 2),
            "small parts": small,
        }
        seconds = {side: [] for side in sides}  # type: dict[str, list[float]]
        for _ in range(turns):
            for side, options in sides.items():
                seconds[side].append(measure(folder, options))
        for side, each in seconds.items():
            ratios = np.array(seconds["fit"]) / each
            median = float(np.median(each))
            print(
                f"{side}: {median:.1f} s of processor, {count / median:,.0f} images/s a core, "
                f"{np.median(ratios):.2f} of fit"
            )
        more = -(-count // SMALL) - -(-count // PARTITION)
        extra = np.median(np.array(seconds["small parts"]) - seconds["parts"])
        print(f"a part costs {extra / more:.3f} s by itself")
        start = np.median(np.array(seconds["2 workers"]) - seconds["parts"])
        print(f"two workers cost {start:.1f} s, started and stopped")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
