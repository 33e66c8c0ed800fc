"""What an archive of small files takes beside the lifting: its plan, and its manifest.

The files are links to one of 100 images. No part is lifted, but each reports as many names as it
would have, in an order that has to be compared, and has an entry in the manifest.

    python -m benchmarks.small_files [FILES]
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast
from unittest.mock import patch

import numpy as np

from benchmarks.parts import tile
from shapefit.config import FitConfig, load_config
from shapefit.pipelines.outcome import Outcome
from shapefit.pipelines.parts import run as parts
from shapefit.pipelines.parts.equal_items import Span
from shapefit.pipelines.parts.part import Done, Job
from shapefit.stores.shelf import find_state

FILES, IMAGES = 100_000, 100

LINKS = 10_000
"""To one file: file systems have a limit."""


def no_work(job: Job) -> Done:
    """Report a part as done, its names spread over those of all."""
    result = job.folder / job.part.file
    result.touch()
    count = IMAGES * len(job.part.inputs)
    hashes = np.random.default_rng(job.part.number).integers(0, 2**64, count, np.uint64)
    span = Span("a", "z", "a", "z")
    state = find_state(result) or (0, "")
    return Done(job.part, Outcome(done=count), state=state, span=span, hashes=hashes.tobytes())


def measure(folder: Path, files: int = FILES) -> list[float]:
    """Return the seconds of a run that lifts nothing, and of the same once more."""
    archive = folder / "archive"
    archive.mkdir()
    for number in range(files):
        if number % LINKS == 0:
            clip = archive / f"clip-{number:06}.h5"
            tile(clip, IMAGES)
        else:
            os.link(clip, archive / f"clip-{number:06}.h5")
    given = {
        "landmarks": f"{archive}/*.h5",
        "dictionary": "people",
        "output": f"{folder}/results/",
    }
    seconds = []
    for _ in range(2):
        began = time.perf_counter()
        with patch.object(parts, "fit_part", no_work):
            for _ in parts.run(cast(FitConfig, load_config("fit", None, (), given))):
                pass
        seconds.append(time.perf_counter() - began)
    return seconds


def main(files: int = FILES) -> None:
    """Print what was measured."""
    with TemporaryDirectory() as name:
        first, again = measure(Path(name), files)
        manifest = (Path(name) / "results/manifest.json").stat().st_size
    print(
        f"{files:,} files of {IMAGES} images: {first:.1f} s beside the lifting, {again:.1f} s again"
    )
    print(f"the manifest has {manifest / 1e6:.1f} MB")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
