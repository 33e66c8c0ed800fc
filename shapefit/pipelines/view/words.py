"""What a page says of itself: how good the results are, what is assumed, what it lacks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import counted
from shapefit.io.layout import METRES_FROM
from shapefit.io.skeletons import joint_columns
from shapefit.lifting.verdict import MIRRORED, REASONS
from shapefit.pipelines.view.layers import has_camera
from shapefit.pipelines.view.reading import Frames, Gathered, fit_config
from shapefit.viewer.scene import Layer

MOST_NAMED = 4
"""Individuals of which each has words of its own."""
SHARE_NAMED = 0.1
"""Of the frames of the longest, from which on an individual is more than a slip of the tracker."""


def summary(
    results: Sequence[Gathered],
    layers: Sequence[Layer],
    frames: Frames,
    recordings: Sequence[Sequence[int]] | None,
    landmarks: Sequence[str],
    upright: str,
) -> Iterator[str]:
    """Yield how large errors are and how much is trusted, then what is assumed, in sentences.

    `upright` says where up comes from, "" where it is up in the image.
    """
    part = "joint" if joint_columns(landmarks) else "landmark"
    starts = [*(start for _, start in frames.sequences), len(frames.items)]
    spans = list(pairwise(starts))
    several = recordings is not None and len(recordings) == 1 and 1 < len(spans) <= MOST_NAMED
    for each, layer in zip(results, layers, strict=False):
        named = [(each.name if len(results) > 1 else "", slice(None))]
        if several and len(results) == 1:
            individuals = (name.rpartition("/")[2] for name, _ in frames.sequences)
            longest = max(end - start for start, end in spans)
            named = [
                (name, slice(start, end))
                for name, (start, end) in zip(individuals, spans, strict=True)
                if end - start > SHARE_NAMED * longest
            ]
        said = [_quality(name, rows, each, layer, part) for name, rows in named]
        yield "; ".join(said) + "."
    assumed = dict.fromkeys(line for each in results for line in _assumed(each, level=not upright))
    if assumed:
        yield f"Assumed: {'; '.join(assumed)}."
    if upright:
        yield upright
    if any(np.any(each.texts.get(REASONS, "") == MIRRORED) for each in results):
        yield "Near and far are not told apart: shapes may be mirrored in depth."


def _quality(name: str, rows: slice, gathered: Gathered, layer: Layer, part: str) -> str:
    """Say of some frames of a result how large its errors are, and what share is trusted."""
    medians = {
        m.name: f"{_number(m.values[rows])} {m.unit}".strip()
        for m in layer.measures
        if np.isfinite(m.values[rows]).any()
    }
    said = []
    if "expected error" in medians:
        said.append(f"{part} errors about {medians['expected error']}")
    if REASONS in gathered.texts:
        doubts = gathered.texts[REASONS][rows]
        trusted = np.count_nonzero(doubts == "")
        share = int(100 * trusted / len(doubts)) if len(doubts) else 0
        said.append(f"{share}% of {counted(len(doubts), 'frame')} trusted")
    if not said:
        method = gathered.attributes.get("method")
        said = [f"no error bars and no verdict{f': method {method} gives none' if method else ''}"]
    if "error against the truth" in medians:
        said.append(f"against the truth {medians['error against the truth']}")
    text = ", ".join(said)
    return f"{name}: {text}" if name else text[0].upper() + text[1:]


def _number(values: Floats) -> str:
    """Write the median of what is known, to two digits."""
    median = float(np.median(values[np.isfinite(values)]))
    return f"{median:.0f}" if median >= 9.5 else f"{median:.2g}"


def _assumed(gathered: Gathered, *, level: bool) -> Iterator[str]:
    """Yield what a fit took for granted."""
    attributes, found = gathered.attributes, gathered.of_frames
    if level:
        yield "a level camera"
    if not has_camera(gathered):
        yield "no perspective, so distances from the camera are unknown"
    elif "assumed" in str(attributes.get("estimated", "")):
        numbers = np.hstack([2 * found["principal_point"], found["focal"][:, :1]])
        for w, h, focal in numbers[np.isfinite(numbers).all(axis=1)][:1]:
            yield (
                f"images of {w:.0f} x {h:.0f} px and a focal length of {focal:.0f} px "
                "(`image_size`), so distances from the camera are rough"
            )
    if METRES_FROM in attributes and fit_config(attributes).get("height") is None:
        yield "the size of the training shapes (`height`)"


def lacking(
    layers: Sequence[Layer], seen: Floats | None, edges: NDArray[np.int64] | None
) -> Iterator[str]:
    """Yield what is missing from the page, and where to get it."""
    if not layers:
        yield "There are only landmarks here, and nothing in 3D."
    results = [layer for layer in layers if layer.role == "result"]
    if results and seen is None:
        yield "The results hold no observed landmarks; add the landmark file to see them."
    if edges is None and not any(layer.blend for layer in layers):
        yield "No edges are known, so landmarks are points; -d DICT.h5 or --truth may have them."
    for layer in results:
        failed = int((~np.isfinite(layer.points).any(axis=(1, 2))).sum())
        if failed:
            yield f"{layer.name} has no shape of {counted(failed, 'frame')}."
