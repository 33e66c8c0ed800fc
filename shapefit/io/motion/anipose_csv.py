"""The CSV of 3D points that anipose writes: x, y, z, error, cameras and score of each landmark."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import abbreviate
from shapefit.io.foreign.recognition import find_landmarks, split_columns
from shapefit.io.foreign.recording import Instances, Recording
from shapefit.io.motion.text import read_blocks, read_head, read_plain, read_table, split_lines

FRAME = "fnum"


def record(paths: tuple[Path, ...]) -> Recording:
    """Return the landmarks of an anipose CSV, in its unit; the score is their confidence.

    Raises InputError for rows of another width, and cells that are no numbers.
    """
    path = paths[0]
    columns = split_columns(read_head(path, 1)[0])
    names = find_landmarks(columns)
    place = {name: number for number, name in enumerate(columns)}
    points = [name[:-2] for name in columns if name.endswith("_x")]
    left = [name for name in points if name not in names]
    kept = [place[f"{name}_{axis}"] for name in names for axis in "xyz"]
    scored = all(f"{name}_score" in place for name in names)
    scores = [place[f"{name}_score"] for name in names] if scored else []
    wanted = [*kept, *scores, *([place[FRAME]] if FRAME in place else [])]

    def blocks() -> Iterator[Instances]:
        done = 0
        for first, texts in read_blocks(path, 1):
            numbers = read_plain(texts, ",", len(columns))
            if numbers is None:
                rows, lines = split_lines(path, first, texts, ",", len(columns))
                numbers = np.full((len(rows), len(columns)), np.nan)
                cells = [[row[column] for column in wanted] for row in rows]
                if rows:
                    numbers[:, wanted] = read_table(cells, lines, path)
            n = len(numbers)
            points, rest = numbers[:, kept], numbers[:, scores]
            yield Instances.of_one(
                points.reshape(n, len(names), 3),
                done,
                _labels(numbers[:, place[FRAME]] if FRAME in place else None, done, n),
                confidence=_confidence(rest) if scored else None,
            )
            done += n

    return Recording(
        name=str(path),
        video=path.stem,
        dimensions=3,
        landmark_names=names,
        blocks=blocks,
        notes=(f"points left out: {abbreviate(left)}",) if left else (),
    )


def _labels(numbers: NDArray[np.float64] | None, done: int, n: int) -> list[str]:
    """Return the frames as the file numbers them, or from 0 where it does not."""
    if numbers is None or not np.isfinite(numbers).all():
        return [str(frame) for frame in range(done, done + n)]
    return [f"{number:.15g}" for number in numbers.tolist()]


def _confidence(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return scores as confidences: those of points that anipose filled in are NaN."""
    return np.where(np.isfinite(scores), np.clip(scores, 0.0, None), np.nan)
