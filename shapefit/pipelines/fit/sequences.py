"""Whole sequences: their images are read together, and refined as frames of one moving body."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Integers
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import LandmarkSet
from shapefit.io.layout import LANDMARK_COVARIANCE
from shapefit.io.records import concatenate
from shapefit.lifting.lift import Lifting
from shapefit.lifting.posterior.method import scale_of_bars
from shapefit.lifting.sequences.clips import LONGEST, Motion, refine_lifting, split
from shapefit.lifting.sequences.exchanges import find_exchanges
from shapefit.lifting.sequences.smoothing import Lengths
from shapefit.lifting.sequences.through_camera import refine_through_camera

if TYPE_CHECKING:
    from shapefit.pipelines.fit.lift import Lifter

USUAL = 0.02
"""Second difference of a coordinate from image to image where the dictionary knows none, in units
of the size of the body: that of subject 86 at 24 Hz."""

RIGID = 0.005
"""Deviation of a bone from its length that no data are more exact than, in the same units."""

RATE = 24.0
"""Frames a second where no file states it."""

LIMBS = ({"hip", "knee"}, {"knee", "ankle"}, {"shoulder", "elbow"}, {"elbow", "wrist"})
"""Joints of people, but for their sides, between which limbs are."""


def whole_sequences(chunks: Iterable[LandmarkSet]) -> Iterator[LandmarkSet]:
    """Hold back the last run of images of one sequence until its end is known.

    The images stay in their order. As much is held in memory as a chunk and the longest sequence.
    Raises InputError for images without sequences, and where one goes on after another.
    """
    begun: set[str] = set()
    last: str | None = None
    pending: list[LandmarkSet] = []
    for chunk in chunks:
        names = chunk.sequences
        if names is None:
            fix = "name the sequence of each image, or take `method: posterior`"
            raise input_error("method: sequences", "landmarks without `sequence`", fix)
        before = [last, *names][: len(names)]
        starts = [row for row, name in enumerate(names) if name != before[row]]
        for row in starts:
            if names[row] in begun:
                found = f"the sequence '{names[row]}' goes on after others, at the item "
                found += f"'{chunk.items[row]}'"
                raise input_error("sequence", found, "put its images together, in order of time")
            begun.add(names[row])
        if pending and starts[:1] == [0]:
            yield concatenate(pending)
            pending = []
        if starts and starts[-1]:
            yield concatenate([*pending, chunk.take(slice(0, starts[-1]))])
            pending = []
        pending.append(chunk.take(slice(starts[-1] if starts else 0, None)))
        last = names[-1] if names else last
    if pending:
        yield concatenate(pending)


def in_pieces(groups: Iterable[LandmarkSet]) -> Iterator[LandmarkSet]:
    """Divide groups of whole sequences into batches that are lifted by themselves.

    A long sequence is refined in pieces anyway; lifted piece by piece, it takes the memory of one.
    """
    for group in groups:
        start = stop = 0
        for clip in split(group.sequences or ()):
            if clip.stop - start > LONGEST and stop > start:
                yield group.take(slice(start, stop))
                start = stop
            stop = clip.stop
        yield group.take(slice(start, stop))


class Sides(NamedTuple):
    """Images whose left and right are put back, which (n,) these are, and where sides are unsure.

    unsure (n,): left and right change places in the sequence, and nobody knows which are right.
    """

    images: LandmarkSet
    exchanged: Flags
    unsure: Flags


def restore_sides(images: LandmarkSet, visible: Flags, lifter: Lifter) -> Sides:
    """Undo exchanges of left and right for some frames, by continuity in the image.

    seen (n, p), which landmarks count.
    """
    exchanged, unsure = np.zeros((2, len(images)), dtype=bool)
    partner, rate = lifter.dictionary.mirror_index, lifter.frame_rate or images.frame_rate or RATE
    if partner is None or images.sequences is None:
        return Sides(images, exchanged, unsure)
    left = np.flatnonzero(partner > np.arange(len(partner)))
    pairs = np.stack([left, partner[left]], axis=1)
    w = np.where(visible[:, None], images.landmarks, np.nan)
    for clip in split(images.sequences):
        exchanges = find_exchanges(w[clip], pairs, rate)
        exchanged[clip], unsure[clip] = exchanges.exchanged, not exchanges.continuous
    return Sides(exchange_sides(images, partner, exchanged), exchanged, unsure)


def exchange_sides(images: LandmarkSet, partner: Integers, rows: Flags) -> LandmarkSet:
    """Exchange left and right of some images (n,), and all that is known of these landmarks."""
    if not rows.any():
        return images
    changed = {"landmarks": images.landmarks.swapaxes(1, 2)}
    changed |= {} if images.confidence is None else {"confidence": images.confidence}
    covariance = images.columns.get(LANDMARK_COVARIANCE)
    changed |= {} if covariance is None else {LANDMARK_COVARIANCE: covariance}
    for name, values in changed.items():  # (n, p, ...)
        of_image = rows.reshape(-1, *(1,) * (values.ndim - 1))
        changed[name] = np.where(of_image, values[:, partner], values)
    return images.replaced(**changed | {"landmarks": changed["landmarks"].swapaxes(1, 2)})


def refine_sequences(lifting: Lifting, images: LandmarkSet, lifter: Lifter) -> Lifting:
    """Infer whole sequences from what was found of each image."""
    dictionary, bars = lifter.dictionary, lifter.posterior
    refine = partial(
        refine_lifting,
        sequences=images.sequences or (),
        motion=find_motion(dictionary, lifter.frame_rate or images.frame_rate),
        residual_variance=lifter.variance,
        noise=lifter.noise,
        bar_scale=scale_of_bars(bars.bar_scale, bars.growth, len(dictionary.landmark_names)),
        threads=lifter.threads,
    )
    return refine_through_camera(lifting, images.landmarks, refine)


def find_motion(dictionary: Dictionary, rate: float | None) -> Motion:
    """Return the motion between images at a frame rate, or at that of the training shapes.

    Of a body whose velocity wanders, second differences grow with the 3/2th power of the time
    between images.
    """
    edges = np.empty((0, 2), np.int64) if dictionary.edges is None else dictionary.edges
    acceleration, tolerance = dictionary.acceleration, dictionary.bone_tolerance
    if acceleration is None:
        acceleration = np.full(len(dictionary.landmark_names), USUAL)
    elif rate is not None and dictionary.frame_rate is not None:
        acceleration = acceleration * (dictionary.frame_rate / rate) ** 1.5
    tolerance = np.full(len(edges), USUAL) if tolerance is None else tolerance
    known = find_usual_lengths(dictionary)
    rate = rate or dictionary.frame_rate or RATE
    return Motion(edges, acceleration, np.maximum(tolerance, RIGID), known, rate)


def find_usual_lengths(dictionary: Dictionary) -> Lengths | None:
    """Return the mean bone lengths of the training bodies and their precision, None if unknown.

    Of any size g: Q = P - P 1 1^T P / (1^T P 1) for the precision P of the logarithms. Of people
    only limbs: detectors put hips, shoulders and heads elsewhere than training shapes have them.
    """
    usual, covariance, edges = dictionary.edge_length, dictionary.edge_covariance, dictionary.edges
    if usual is None or covariance is None or edges is None:
        return None
    limbs = [is_limb(dictionary.landmark_names, edge) for edge in edges]
    rows = np.flatnonzero((usual > 0) & (np.array(limbs) if any(limbs) else True))
    if not len(rows):
        return None
    P = np.linalg.inv(covariance[np.ix_(rows, rows)])
    whole = P.sum(axis=1)
    Q, lengths = np.zeros_like(covariance), np.full(len(usual), np.nan)
    Q[np.ix_(rows, rows)] = P - np.outer(whole, whole) / whole.sum()
    lengths[rows] = usual[rows]
    return Lengths(lengths, Q)


def is_limb(names: Sequence[str], edge: NDArray[np.integer]) -> bool:
    """Whether an edge is a thigh, a shank, an upper or a lower arm of people."""
    return {names[end][1:] for end in edge.tolist()} in LIMBS
