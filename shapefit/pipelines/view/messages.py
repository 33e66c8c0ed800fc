"""What a page states: what is shown and how good it is, what is assumed, what is missing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from shapefit.arrays import Floats
from shapefit.errors import counted, parse_json
from shapefit.io.layout import METRES_FROM
from shapefit.io.skeletons import joint_columns
from shapefit.io.writers.metres import EXTRINSIC_ROTATION
from shapefit.lifting.trust import MIRRORED, REASONS
from shapefit.pipelines.view.layers import AGAINST_TRUTH, EXPECTED, has_camera
from shapefit.pipelines.view.reading import Content
from shapefit.viewer.scene import Fact, Layer

TITLES = {
    EXPECTED: "Median over trusted frames of the error to expect: the mean distance between the "
    "shape and the true one after the best similarity, computed from the error bars.",
    AGAINST_TRUTH: "Median over frames of the mean distance to the truth, after the best "
    "similarity.",
}
SHOWN_AS = {EXPECTED: "typical error", AGAINST_TRUTH: "error against the truth"}


def counts(
    recordings: Sequence[Sequence[int]], frames: int, images: int, rate: str
) -> Iterator[Fact]:
    """Yield what is shown: `frames` of videos at a rate in words, or images that are no video."""
    if not rate:
        yield Fact(counted(images, "image"))
        return
    if len(recordings) > 1:
        yield Fact(counted(len(recordings), "sequence"))
    if (individuals := max(map(len, recordings))) > 1:
        yield Fact(counted(individuals, "individual"))
    yield Fact(counted(frames, "frame"))
    yield Fact(rate)


def quality(contents: Sequence[Content], layers: Sequence[Layer]) -> Iterator[Fact]:
    """Yield how many frames of each layer are trusted, and how large its errors are."""
    by_name = {content.name: content for content in contents}
    for layer in layers:
        prefix = f"{layer.name}: " if len(contents) > 1 else ""
        trusted = np.ones(len(layer.points), dtype=bool)
        reasons = by_name[layer.name].per_frame(REASONS) if layer.name in by_name else None
        if reasons is not None:
            trusted = np.isfinite(layer.points).any(axis=(1, 2)) & (reasons == "")
            share = f"{np.count_nonzero(trusted):,} of {len(trusted):,} trusted"
            style = "trust" if trusted.mean() > 0.5 else "trust doubtful"
            yield Fact(prefix + share, style=style)
        for measure in layer.measures:
            if measure.name in TITLES:
                counted_in = trusted if measure.name == EXPECTED else True
                values = measure.values[counted_in & np.isfinite(measure.values)]
                if values.size:
                    text = f"{SHOWN_AS[measure.name]} {_median(values)} {measure.unit}".strip()
                    yield Fact(prefix + text, TITLES[measure.name])


def assumed(results: Sequence[Content], floors: Sequence[str], *, rigid: bool) -> Iterator[str]:
    """Yield what is taken for granted, in sentences; `floors` describe those that are known."""
    if floors:
        several = f"{len(floors)} videos have one"
        yield f"Floor from resting feet: {several if len(floors) > 1 else floors[0]}."
    elif not rigid:
        world = any(EXTRINSIC_ROTATION in result.records.columns for result in results)
        why = " (which axis of the calibrated world is up is not stated)" if world else ""
        up = f"up is up in the image{why}, and " if results else ""
        yield f"The floor is not known: {up}each body has its own ground."
    if not results:
        return
    if not all(map(has_camera, results)):
        yield "Without perspective, distances from the camera are unknown."
    for result in results:
        if "assumed" in str(result.records.attributes.get("estimated", "")) and has_camera(result):
            yield "The focal length is assumed, so distances from the camera are rough."
            break
    sized = [result for result in results if METRES_FROM in result.records.attributes]
    if any("height" not in _config(result) for result in sized):
        people = any("rankle" in joint_columns(each.records.landmark_names) for each in sized)
        yield "Sizes are those of the training shapes" + (
            " (`--height` sets them)." if people else "."
        )
    if any(np.any(result.records.columns.get(REASONS, "") == MIRRORED) for result in results):
        yield "Near and far are not told apart: shapes may be mirrored in depth."


def _config(result: Content) -> dict[str, object]:
    """Return the keys of the config of the fit that are set, as the file has them."""
    try:
        config = parse_json(result.records.attributes.get("config", "{}"))
    except ValueError:
        return {}
    return {name: value for name, value in config.items() if value is not None}


def missing(layers: Sequence[Layer], observed: Floats | None, *, has_edges: bool) -> Iterator[str]:
    """Yield what the page lacks, and where to get it."""
    if not layers:
        yield "There are only landmarks here, and nothing in 3D."
    results = [layer for layer in layers if layer.role == "result"]
    if results and observed is None:
        yield "The results hold no observed landmarks; add the landmark file to see them."
    if not has_edges and not any(layer.blend for layer in layers):
        yield "No edges are known, so landmarks are points; -d DICT.h5 or --truth may have them."
    for layer in results:
        failed = int((~np.isfinite(layer.points).any(axis=(1, 2))).sum())
        if failed:
            yield f"{layer.name} has no shape of {counted(failed, 'frame')}."


def _median(values: Floats) -> str:
    """Write the median, to two digits."""
    median = float(np.median(values))
    return f"{median:.0f}" if median >= 9.5 else f"{median:.2g}"
