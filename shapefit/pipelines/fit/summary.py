"""What a fit tells at its end, in a few rows: read, method, camera, metres, result, next."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from shapefit.config import FitConfig
from shapefit.errors import abbreviate, counted
from shapefit.io import LandmarkSet, LandmarkSource, ResultSet
from shapefit.io.layout import METRES_PER_UNIT
from shapefit.lifting.expected_error import EXPECTED_ERROR
from shapefit.lifting.verdict import TRUSTED
from shapefit.pipelines.fit.prepare import Setup

VIEWED = (".h5", ".hdf5", ".hdf", ".he5", ".csv", ".trc")
"""Endings of results that `shapefit view` shows."""


@dataclass
class Tally:
    """How many images of how many sequences were lifted, trusted, and their expected errors."""

    images: int = 0
    sequences: set[str] = field(default_factory=set)
    judged: int = 0
    trusted: int = 0
    errors: list[float] = field(default_factory=list)

    def add(self, images: LandmarkSet, record: ResultSet) -> None:
        """Count the images of a batch."""
        self.images += len(images)
        self.sequences.update(images.sequences or ())
        trusted = record.columns.get(TRUSTED)
        if trusted is None:
            return
        self.judged += len(images)
        self.trusted += int(trusted.sum())
        errors, metres = record.columns.get(EXPECTED_ERROR), record.columns.get(METRES_PER_UNIT)
        if errors is not None and metres is not None:
            self.errors += (errors * metres)[np.asarray(trusted, bool)].tolist()

    @property
    def result(self) -> str:
        """Say how many images are to be trusted, and how far off their landmarks are."""
        if not self.judged:
            return f"{counted(self.images, 'image')} (no error bars by this method)"
        errors = [error for error in self.errors if np.isfinite(error)]
        size = f", expected error about {100 * np.median(errors):.0f} cm" if errors else ""
        return f"{self.trusted} of {counted(self.images, 'image')} trusted{size}"


def rows_of(
    config: FitConfig,
    source: LandmarkSource,
    setup: Setup,
    tally: Tally,
    chosen: str,
    of_writer: str,
) -> tuple[tuple[str, str], ...]:
    """Return the rows of the summary, label and text."""
    names = abbreviate([path.name or str(path) for path in config.landmarks], 1)
    sequences = f" of {counted(len(tally.sequences), 'sequence')}" if tally.sequences else ""
    matched = setup.matched.describe(source.head.landmark_names)
    read = f"{names}: {counted(tally.images, 'image')}{sequences}"
    camera = setup.estimates.lines[0] if setup.estimates.lines else "camera: as given"
    output = config.output
    following = ""
    if isinstance(output, Path) and output.suffix.lower() in VIEWED:
        name = output.name if output.parent == Path.cwd() else str(output)
        following = f"shapefit view {name if output.suffix != '.trc' else output.stem + '*.trc'}"
    rows = (
        ("Read", f"{read}; {matched}" if matched else read),
        ("Method", chosen or config.method),
        ("Camera", camera.removeprefix("camera: ")),
        ("Metres", of_writer),
        ("Result", tally.result),
        ("Next", following),
    )
    return tuple((label, text) for label, text in rows if text)
