"""The CSV of 3D points that anipose writes: x, y, z, error, cameras and score of each landmark."""

from __future__ import annotations

from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io.foreign.recording import Instances, Recording
from shapefit.io.motion.recognition import find_landmarks, split_columns
from shapefit.io.motion.text import read_blocks, read_head, read_table

FRAME = "fnum"


def record(paths: tuple[Path, ...]) -> Recording:
    """Return the landmarks of an anipose CSV, in its unit; the score is their confidence.

    Raises InputError for rows of another width, and cells that are no numbers.
    """
    path = paths[0]
    columns = split_columns(read_head(path, 1)[0])
    names = find_landmarks(columns)
    place = {name: number for number, name in enumerate(columns)}
    kept = [place[f"{name}_{axis}"] for name in names for axis in "xyz"]
    scored = all(f"{name}_score" in place for name in names)
    scores = [place[f"{name}_score"] for name in names] if scored else []
    wanted = itemgetter(*kept, *scores)

    def blocks() -> Iterator[Instances]:
        done = 0
        for first, texts in read_blocks(path, 1):
            lines, rows = [], []
            labels: list[str] = []
            for line, text in enumerate(texts, first):
                if not text.strip(" ,"):
                    continue
                cells = text.split(",")
                if len(cells) != len(columns):
                    found = f"has {len(cells)} cells for {len(columns)} columns"
                    raise input_error(f"{path}:{line}", found, "write one cell per column")
                rows.append(wanted(cells))
                lines.append(line)
                number = cells[place[FRAME]].strip() if FRAME in place else ""
                labels.append(number.removesuffix(".0") or str(done + len(labels)))
            if not rows:
                continue
            numbers = read_table(rows, lines, path)
            points, rest = numbers[:, : len(kept)], numbers[:, len(kept) :]
            yield Instances(
                points=points.reshape(len(rows), len(names), 3),
                confidence=_confidence(rest) if scored else None,
                frames=np.arange(done, done + len(rows)),
                labels=labels,
                individuals=np.zeros(len(rows), np.int64),
            )
            done += len(rows)

    return Recording(
        name=str(path),
        video=path.stem,
        dimensions=3,
        landmark_count=len(names),
        landmark_names=names,
        blocks=blocks,
    )


def _confidence(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return scores as confidences: those of points that anipose filled in are NaN."""
    return np.where(np.isfinite(scores), np.clip(scores, 0.0, None), np.nan)
