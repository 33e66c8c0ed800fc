"""Whole sequences: their images are read together, and refined as frames of one moving body."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, Integers
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import LandmarkSet, match_landmarks, read_shapes
from shapefit.io.layout import LANDMARK_COVARIANCE
from shapefit.io.records import concatenate
from shapefit.lifting.lift import Lifting
from shapefit.lifting.posterior.method import scale_of_bars
from shapefit.lifting.sequences.clips import Motion, refine_lifting, split
from shapefit.lifting.sequences.exchanges import find_exchanges
from shapefit.lifting.sequences.smoothing import CONSTANTS, Lengths
from shapefit.lifting.sequences.through_camera import refine_through_camera

if TYPE_CHECKING:
    from shapefit.pipelines.fit.lift import Lifter

USUAL = 0.02
"""Second difference of a coordinate from image to image where the dictionary knows none, in units
of the size of the body: that of subject 86 at 24 Hz."""

RIGID = 0.005
"""Deviation of a bone from its length, in the same units, that no data are more exact than."""

MEASURED = 0.01
"""Relative deviation of lengths that were measured on the body."""

RATE = 24.0
"""Frames a second where no file says it."""

LIMBS = ({"hip", "knee"}, {"knee", "ankle"}, {"shoulder", "elbow"}, {"elbow", "wrist"})
"""Joints of people, but for their sides, between which limbs are."""

HEADER = ("from", "to", "length")


def whole_sequences(chunks: Iterable[LandmarkSet]) -> Iterator[LandmarkSet]:
    """Hold back the last run of images of one sequence until its end is known.

    The images stay in their order. As much is held in memory as a chunk and the longest sequence.
    Raises InputError for images without sequences, and where one goes on after another.
    """
    known: set[str] = set()
    current: str | None = None
    held: list[LandmarkSet] = []
    for chunk in chunks:
        names = chunk.sequences
        if names is None:
            fix = "name the sequence of each image, or take `method: posterior`"
            raise input_error("method: sequences", "landmarks without `sequence`", fix)
        starts = [
            row for row, name in enumerate(names) if name != (names[row - 1] if row else current)
        ]
        for row in starts:
            if names[row] in known:
                found = f"the sequence '{names[row]}' goes on after others, at the item "
                found += f"'{chunk.items[row]}'"
                raise input_error("sequence", found, "put its images together, in order of time")
            known.add(names[row])
        if held and starts[:1] == [0]:
            yield concatenate(held)
            held = []
        if starts and starts[-1]:
            yield concatenate([*held, chunk.take(slice(0, starts[-1]))])
            held = []
        held.append(chunk.take(slice(starts[-1] if starts else 0, None)))
        current = names[-1] if names else current
    if held:
        yield concatenate(held)


class Sides(NamedTuple):
    """Images whose left and right are put back, which (n,) these are, and where sides are unsure.

    unsure (n,): left and right change places in the sequence, and nobody knows which are right.
    """

    images: LandmarkSet
    exchanged: Flags
    unsure: Flags


def put_back_sides(
    images: LandmarkSet, seen: Flags, partner: Integers | None, rate: float | None
) -> Sides:
    """Undo exchanges of left and right for some frames, by continuity in the image.

    seen (n, p), which landmarks count; partner (p,) of each, see `mirror_index`.
    """
    exchanged, unsure = np.zeros((2, len(images)), dtype=bool)
    if partner is None or images.sequences is None:
        return Sides(images, exchanged, unsure)
    left = np.flatnonzero(partner > np.arange(len(partner)))
    pairs = np.stack([left, partner[left]], axis=1)
    w = np.where(seen[:, None], images.landmarks, np.nan)
    for clip in split(images.sequences):
        found = find_exchanges(w[clip], pairs, rate or images.frame_rate or RATE)
        exchanged[clip], unsure[clip] = found.exchanged, not found.continuous
    if exchanged.any():
        images = exchange_sides(images, partner, exchanged)
    return Sides(images, exchanged, unsure)


def exchange_sides(images: LandmarkSet, partner: Integers, rows: Flags) -> LandmarkSet:
    """Exchange left and right of some images, and all that is known of these landmarks."""
    by_image: Flags = rows[:, None]
    confidence, covariance = images.confidence, images.columns.get(LANDMARK_COVARIANCE)
    if confidence is not None:
        confidence = np.where(by_image, confidence[:, partner], confidence)
    landmarks = np.where(by_image[..., None], images.landmarks[..., partner], images.landmarks)
    images = images.replaced(landmarks=landmarks, confidence=confidence)
    if covariance is None:
        return images
    other = np.where(by_image[..., None, None], covariance[:, partner], covariance)
    return images.with_columns({LANDMARK_COVARIANCE: other})


def refine_sequences(lifting: Lifting, images: LandmarkSet, lifter: Lifter) -> Lifting:
    """Infer whole sequences from what was found of each image."""
    rate = lifter.frame_rate or images.frame_rate
    p = len(lifter.dictionary.landmark_names)
    refine = partial(
        refine_lifting,
        sequences=images.sequences or (),
        motion=find_motion(lifter.dictionary, rate, lifter.bone_lengths),
        residual_variance=lifter.variance,
        noise=lifter.noise,
        bar_scale=scale_of_bars(lifter.bar_scale, lifter.growth, p),
        threads=lifter.threads,
    )
    return refine_through_camera(lifting, images.landmarks, refine)


def find_motion(dictionary: Dictionary, rate: float | None, lengths: Floats | None) -> Motion:
    """Return the motion between images at a frame rate, or at that of the training shapes.

    Of a body whose velocity wanders, second differences grow with the 3/2th power of the time
    between images.
    """
    edges = np.empty((0, 2), np.int64) if dictionary.edges is None else dictionary.edges
    acceleration = dictionary.acceleration
    if acceleration is None:
        acceleration = np.full(len(dictionary.landmark_names), USUAL)
    elif rate is not None and dictionary.frame_rate is not None:
        acceleration = acceleration * (dictionary.frame_rate / rate) ** 1.5
    give = dictionary.bone_tolerance
    if give is None:
        give = np.full(len(edges), USUAL)
    known = find_known(dictionary)
    if lengths is not None:
        known = Lengths(lengths, np.diag(np.isfinite(lengths) / MEASURED**2), measured=True)
    seconds = CONSTANTS.memory * (rate or dictionary.frame_rate or RATE)
    return Motion(edges, acceleration, np.maximum(give, RIGID), known, max(1, round(seconds)))


def find_known(dictionary: Dictionary) -> Lengths | None:
    """Return what the bodies of the training shapes say of the lengths of another, if they do.

    Of any size g: Q = P - P 1 1^T P / (1^T P 1) for the precision P of the logarithms. Of people
    only limbs: detectors put hips, shoulders and heads elsewhere than training shapes have them.
    """
    usual, covariance = dictionary.edge_length, dictionary.edge_covariance
    if usual is None or covariance is None or dictionary.edges is None:
        return None
    limbs = [is_limb(dictionary.landmark_names, edge) for edge in dictionary.edges]
    there = (usual > 0) & (np.array(limbs) if any(limbs) else True)
    if not there.any():
        return None
    rows = np.flatnonzero(there)
    P = np.linalg.inv(covariance[np.ix_(rows, rows)])
    whole = P.sum(axis=1)
    Q = np.zeros_like(covariance)
    Q[np.ix_(rows, rows)] = P - np.outer(whole, whole) / whole.sum()
    return Lengths(np.where(there, usual, np.nan), Q, measured=False)


def is_limb(names: Sequence[str], edge: NDArray[np.integer]) -> bool:
    """Whether an edge is a thigh, a shank, an upper or a lower arm of people."""
    return {names[end][1:] for end in edge.tolist()} in LIMBS


def find_lengths(path: Path, dictionary: Dictionary) -> Floats:
    """Return the known lengths (e,) of the bones of the dictionary, nan where unknown.

    Raises InputError for a file that cannot be read or holds no length of a bone, and for a
    dictionary without edges.
    """
    if dictionary.edges is None:
        fix = "learn the dictionary from shapes with edges, or leave out `sequences.lengths`"
        raise input_error(path, "the dictionary has no bones, so that lengths say nothing", fix)
    names, edges = dictionary.landmark_names, dictionary.edges
    table = read_lengths(path)
    if table is None:
        shapes = read_shapes([path], gaps=True)
        known = [name for name in names if name in set(shapes.landmark_names)]
        points = np.full((len(shapes), 3, len(names)), np.nan)
        columns = [names.index(name) for name in known]
        points[..., columns] = shapes.shapes[..., match_landmarks(shapes.landmark_names, known)]
        each = np.linalg.norm(points[..., edges[:, 0]] - points[..., edges[:, 1]], axis=1)
        there = np.isfinite(each).sum(axis=0)
        lengths = np.where(there, np.nansum(each, axis=0) / np.maximum(there, 1), np.nan)
    else:
        pairs = [frozenset((names[i], names[j])) for i, j in edges]
        lengths = np.array([table.get(pair, np.nan) for pair in pairs])
    if not np.isfinite(lengths).any():
        found = "has no length of a bone of the dictionary"
        first = " - ".join(names[end] for end in edges[0])
        raise input_error(path, found, f"name bones as the dictionary does, as {first}")
    return lengths


def read_lengths(path: Path) -> dict[frozenset[str], float] | None:
    """Return the lengths of a CSV file with the header `from,to,length`; None for other files.

    Raises InputError with the line of what is no length.
    """
    found: dict[frozenset[str], float] = {}
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        if tuple(file.readline().strip().split(",")) != HEADER:
            return None
        for line, row in enumerate(csv.reader(file), 2):
            try:
                one, other, text = row
                length = float(text)
            except ValueError:
                length = math.nan
            if not (math.isfinite(length) and length > 0):
                wrong = f"is no length of a bone: {','.join(row)}"
                raise input_error(f"{path}:{line}", wrong, "write from,to,length with a length > 0")
            found[frozenset((one, other))] = length
    return found
