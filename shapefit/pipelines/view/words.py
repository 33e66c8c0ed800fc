"""What a page says of itself: what is shown, how good it is, what is assumed, what it lacks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import counted
from shapefit.io.layout import METRES_FROM
from shapefit.lifting.verdict import MIRRORED, REASONS
from shapefit.pipelines.view.layers import AGAINST_TRUTH, EXPECTED, has_camera
from shapefit.pipelines.view.reading import Frames, Gathered
from shapefit.viewer.scene import Fact, Layer

EXPECTED_TITLE = (
    "Median over trusted frames of the error to expect: the mean distance between the shape and "
    "the true one after the best similarity, computed from the error bars."
)
TRUTH_TITLE = "Median over frames of the mean distance to the truth after the best similarity."


def facts(
    results: Sequence[Gathered],
    layers: Sequence[Layer],
    frames: Frames,
    recordings: Sequence[Sequence[int]] | None,
    moments: int,
    rate: str,
) -> Iterator[Fact]:
    """Yield what is shown, how much of it is trusted, and how large errors are.

    moments counts the frames of all videos; rate is the frame rate in words, "" for images that are
    no video.
    """
    if rate:
        groups = recordings or [[row] for row in range(len(frames.sequences))]
        if len(groups) > 1:
            yield Fact(counted(len(groups), "sequence"))
        if max(map(len, groups)) > 1:
            yield Fact(counted(max(map(len, groups)), "individual"))
        yield Fact(counted(moments, "frame"))
        yield Fact(rate)
    else:
        yield Fact(counted(len(frames.items), "image"))
    for each, layer in zip(results, layers, strict=False):
        name = f"{each.name}: " if len(results) > 1 else ""
        trusted = np.ones(len(frames.items), dtype=bool)
        if REASONS in each.texts:
            trusted = np.isfinite(each.points).any(axis=(1, 2)) & (each.texts[REASONS] == "")
            share = f"{np.count_nonzero(trusted):,} of {len(trusted):,} trusted"
            yield Fact(name + share, "", "trust" if trusted.mean() > 0.5 else "trust doubtful")
        for measure in layer.measures:
            title = {EXPECTED: EXPECTED_TITLE, AGAINST_TRUTH: TRUTH_TITLE}.get(measure.name)
            counts = trusted if measure.name == EXPECTED else np.ones_like(trusted)
            known = measure.values[counts & np.isfinite(measure.values)]
            if title and known.size:
                what = "typical error" if measure.name == EXPECTED else "error against the truth"
                yield Fact(f"{name}{what} {_number(known)} {measure.unit}".strip(), title)


def assumed(results: Sequence[Gathered], floor: str, *, video: bool) -> Iterator[str]:
    """Yield what a fit took for granted, in sentences; `floor` describes a known one."""
    if not results:
        return
    if floor:
        yield f"Floor from resting feet: {floor}."
    elif video:
        yield "The floor is not known: up is up in the image, and shadows lie below each body."
    if not all(map(has_camera, results)):
        yield "Without perspective, distances from the camera are unknown."
    for each in results:
        if "assumed" in str(each.attributes.get("estimated", "")) and has_camera(each):
            yield "The focal length is assumed, so distances from the camera are rough."
            break
    if any(METRES_FROM in each.attributes and "height" not in each.stated for each in results):
        yield "Sizes are those of the training shapes (`--height` sets them)."
    if any(np.any(each.texts.get(REASONS, "") == MIRRORED) for each in results):
        yield "Near and far are not told apart: shapes may be mirrored in depth."


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


def _number(values: Floats) -> str:
    """Write the median, to two digits."""
    median = float(np.median(values))
    return f"{median:.0f}" if median >= 9.5 else f"{median:.2g}"
