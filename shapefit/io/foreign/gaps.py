"""Recordings with gaps as whole shapes, for what needs every landmark."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags
from shapefit.errors import abbreviate, counted, input_error
from shapefit.io.records import ShapeSet

KNOWN_SHARE = 0.9
"""Of the shapes of a recording in which a landmark must be known to be learned from."""


def without_gaps(
    shapes: ShapeSet, notes: tuple[str, ...], name: str
) -> tuple[ShapeSet, tuple[str, ...]]:
    """Return the whole shapes of the landmarks that are mostly known, and notes of what is lost.

    Raises InputError where no landmark is.
    """
    known = np.asarray(np.isfinite(shapes.shapes).all(axis=1))
    if not len(shapes):
        return shapes, notes
    often: Flags = np.asarray(known.mean(axis=0) >= KNOWN_SHARE)
    if not often.any():
        found = f"no landmark is known in {KNOWN_SHARE:.0%} of its {counted(len(shapes), 'shape')}"
        raise input_error(name, found, "give shapes with fewer gaps")
    rows: Flags = np.asarray(known[:, often].all(axis=1))
    lost = [name for name, stays in zip(shapes.landmark_names, often, strict=True) if not stays]
    if lost:
        text = f"left out, known in less than {KNOWN_SHARE:.0%} of the shapes"
        notes += (f"{name}: {counted(len(lost), 'landmark')} {text} ({abbreviate(lost)})",)
    if not rows.all():
        gone = counted(int((~rows).sum()), "shape")
        notes += (f"{name}: {gone} left out, in which a landmark is unknown",)
    if lost:
        shapes = _of_landmarks(shapes, np.flatnonzero(often))
    return shapes.take(rows), notes


def _of_landmarks(shapes: ShapeSet, columns: NDArray[np.intp]) -> ShapeSet:
    """Return the shapes with some of their landmarks, and the edges between those."""
    edges = shapes.edges
    if edges is not None:
        place = {int(old): new for new, old in enumerate(columns)}
        pairs = [[place[a], place[b]] for a, b in edges.tolist() if a in place and b in place]
        edges = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return replace(
        shapes,
        shapes=shapes.shapes[:, :, columns],
        landmark_names=tuple(shapes.landmark_names[int(j)] for j in columns),
        edges=edges,
    )
