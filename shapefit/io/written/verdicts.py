"""Which frames of a motion are to be trusted, as a table beside the file of the motion."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.io.records import Names
from shapefit.io.written.tracks import Track
from shapefit.lifting.verdict import DOUBT, PLAUSIBILITY

COLUMNS = ("item", "frame", "time", "trusted", "reason", "plausibility", "mean_error_bar_m")


@dataclass(frozen=True)
class Verdicts:
    """Of the n items of a motion: frames (n,), times in s, and why not to trust one, or "".

    plausibility (n,); bar (n,), mean over landmarks of sqrt(sd_x^2 + sd_y^2 + sd_z^2), in metres.
    """

    items: Names
    frames: Integers
    times: Floats
    doubts: Names
    plausibility: Floats
    bar: Floats


def find_verdicts(track: Track, factor: Floats, rate: float) -> Verdicts | None:
    """Return what the records say of each item, None where they say nothing.

    factor (n,): metres in a unit of each shape.
    """
    records = track.records
    doubts, sd = records.extras.get(DOUBT), getattr(records, "shape_sd", None)
    if doubts is None or sd is None:
        return None
    n = len(records)
    return Verdicts(
        items=records.items,
        frames=track.frames,
        times=track.frames / rate,
        doubts=tuple(map(str, doubts)),
        plausibility=np.asarray(records.extras.get(PLAUSIBILITY, np.full(n, np.nan)), np.float64),
        bar=factor * np.sqrt((sd**2).sum(axis=1)).mean(axis=1),
    )


def write_verdicts(verdicts: Sequence[Verdicts], path: Path) -> None:
    """Write a row per item; an empty cell is not known."""
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for each in verdicts:
            numbers = zip(each.times, each.plausibility, each.bar, strict=True)
            for item, frame, doubt, (time, plausibility, bar) in zip(
                each.items, each.frames.tolist(), each.doubts, numbers, strict=True
            ):
                trusted = "false" if doubt else "true"
                cells = [_cell(plausibility), _cell(bar)]
                table.writerow([item, frame, f"{time:.10g}", trusted, doubt, *cells])


def _cell(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else ""
