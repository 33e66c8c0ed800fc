"""Whole sequences: their images are read together, and refined as frames of one moving
body.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import LandmarkSet
from shapefit.io.records import concatenate
from shapefit.lifting.lift import Lifting
from shapefit.lifting.posterior.method import scale_of_bars
from shapefit.lifting.sequences.clips import LONGEST, Motion, refine_lifting, split
from shapefit.lifting.sequences.exchanges import find_exchanges
from shapefit.lifting.sequences.smoothing import Lengths
from shapefit.lifting.sequences.through_camera import refine_through_camera
from shapefit.pipelines.fit.lift import Lifter
from shapefit.timeline import ASSUMED_RATE, Timeline, place_in_time

USUAL = 0.02
"""Second difference of a coordinate from image to image where the dictionary knows
none, in units of the size of the body: that of subject 86 at 24 Hz.
"""

RIGID = 0.005
"""Deviation of a bone from its length that no data are more exact than, in the same
units.
"""

LIMBS = ({"hip", "knee"}, {"knee", "ankle"}, {"shoulder", "elbow"}, {"elbow", "wrist"})
"""Joints of people, but for their sides, between which limbs are."""


def whole_sequences(chunks: Iterable[LandmarkSet]) -> Iterator[LandmarkSet]:
    """Yield images whose sequences are whole, in their order; a long one in pieces.

    Raises InputError for images without sequences, for those of a sequence that are
    apart, and for two of one frame.
    """
    begun: set[str] = set()
    rest: list[LandmarkSet] = []
    for chunk in chunks:
        images = concatenate([*rest, chunk])
        first, last, names = len(images) - len(chunk), 0, images.sequences
        if names is None:
            fix = "name the sequence of each image, or take `method: posterior`"
            raise input_error("method: sequences", "landmarks without `sequence`", fix)
        for row in range(first, len(images)):
            if row and names[row] == names[row - 1]:
                _check_order(images, row)
                continue
            if names[row] in begun:
                fault = (
                    f"'{names[row]}' goes on after others, at the item"
                    f" '{images.items[row]}'"
                )
                raise input_error(
                    "sequence", fault, "put its images together, in order of time"
                )
            begun.add(names[row])
            last = row
        if last:
            yield from pieces(images.take(slice(0, last)))
        rest = [images.take(slice(last, None))]
    yield from pieces(concatenate(rest))


def _check_order(images: LandmarkSet, row: int) -> None:
    """Raise InputError where an image is not of a later frame than that before it."""
    frames, names = images.frame, images.sequences
    if frames is None or not (names and names[row]) or frames[row] > frames[row - 1]:
        return
    fault = (
        f"'{images.items[row - 1]}' is of the frame {frames[row - 1]}, and then"
        f" '{images.items[row]}' of {frames[row]}"
    )
    fix = "give one image per frame of a sequence, in order of time"
    raise input_error("frame", fault, fix)


def pieces(images: LandmarkSet) -> Iterator[LandmarkSet]:
    """Divide whole sequences into batches: pieces are refined by themselves, in less
    memory.
    """
    start = stop = 0
    for clip in split(images.sequences or ()):
        if clip.stop - start > LONGEST and stop > start:
            yield images.take(slice(start, stop))
            start = stop
        stop = clip.stop
    yield images.take(slice(start, stop))


def restore_sides(
    images: LandmarkSet, visible: Flags, lifter: Lifter
) -> tuple[LandmarkSet, Floats]:
    """Undo exchanges of left and right for some frames, by continuity in the image.

    visible (n, p), which landmarks count. Returns with the images 1 (n,) where they are
    put back, else 0, and nan where sides change places in the sequence and nobody knows
    which are right.
    """
    exchanged = np.zeros(len(images))
    partner = lifter.dictionary.mirror_index
    rate = lifter.frame_rate or images.frame_rate or ASSUMED_RATE
    if partner is None or images.sequences is None:
        return images, exchanged
    left = np.flatnonzero(partner > np.arange(len(partner)))
    pairs = np.stack([left, partner[left]], axis=1)
    w = np.where(visible[:, None], images.landmarks, np.nan)
    wrong = np.zeros(len(images), dtype=bool)
    position = place_images(images, rate)
    for clip in split(images.sequences):
        exchanges = find_exchanges(w[clip], pairs, Timeline(position[clip], rate))
        wrong[clip] = exchanges.exchanged
        exchanged[clip] = exchanges.exchanged if exchanges.continuous else np.nan
    return exchange_sides(images, partner, wrong), exchanged


def exchange_sides(images: LandmarkSet, partner: Integers, rows: Flags) -> LandmarkSet:
    """Exchange left and right of some images (n,), landmarks and confidences."""
    if not rows.any():
        return images
    w, confidence = images.landmarks, images.confidence
    landmarks = np.where(rows[:, None, None], w[..., partner], w)
    if confidence is not None:
        confidence = np.where(rows[:, None], confidence[:, partner], confidence)
    return images.replaced(landmarks=landmarks, confidence=confidence)


def refine_sequences(lifting: Lifting, images: LandmarkSet, lifter: Lifter) -> Lifting:
    """Infer whole sequences from the liftings of their images."""
    dictionary, bars = lifter.dictionary, lifter.posterior
    motion = find_motion(dictionary, lifter.frame_rate or images.frame_rate)
    refine = partial(
        refine_lifting,
        sequences=images.sequences or (),
        motion=motion,
        residual_variance=lifter.variance,
        noise=lifter.noise,
        bar_scale=scale_of_bars(
            bars.bar_scale, bars.growth, len(dictionary.landmark_names)
        ),
        position=place_images(images, motion.rate),
        threads=lifter.threads,
    )
    return refine_through_camera(lifting, images.landmarks, refine)


def place_images(images: LandmarkSet, rate: float) -> Floats:
    """Return the places (n,) of images in their sequences, in frames."""
    places = np.empty(len(images))
    for clip in split(images.sequences or ()):
        frames = None if images.frame is None else images.frame[clip]
        times = None if images.time is None else images.time[clip]
        places[clip] = place_in_time(frames, times, rate, clip.stop - clip.start)
    return places


def find_motion(dictionary: Dictionary, rate: float | None) -> Motion:
    """Return the motion between images at a frame rate, or at that of the training
    shapes.

    Second differences grow with the 3/2th power of the time, where a velocity wanders.
    """
    edges = np.empty((0, 2), np.int64) if dictionary.edges is None else dictionary.edges
    acceleration, tolerance = dictionary.acceleration, dictionary.bone_tolerance
    if acceleration is None:
        acceleration = np.full(len(dictionary.landmark_names), USUAL)
    elif rate is not None and dictionary.frame_rate is not None:
        acceleration = acceleration * (dictionary.frame_rate / rate) ** 1.5
    if tolerance is None:
        tolerance = np.full(len(edges), USUAL)
    rate = rate or dictionary.frame_rate or ASSUMED_RATE
    lengths = find_usual_lengths(dictionary)
    return Motion(edges, acceleration, np.maximum(tolerance, RIGID), lengths, rate)


def find_usual_lengths(dictionary: Dictionary) -> Lengths | None:
    """Return the mean bone lengths of the training bodies and their precision, None if
    unknown.

    Of any size g: Q = P - P 1 1^T P / (1^T P 1) for the precision P of the logarithms.
    Of people only limbs: detectors put hips, shoulders and heads elsewhere than
    training shapes have them.
    """
    usual, covariance, edges = (
        dictionary.edge_length,
        dictionary.edge_covariance,
        dictionary.edges,
    )
    if usual is None or covariance is None or edges is None:
        return None
    names = dictionary.landmark_names
    limbs = np.array(
        [{names[end][1:] for end in edge.tolist()} in LIMBS for edge in edges], bool
    )
    rows = np.flatnonzero((usual > 0) & (limbs if limbs.any() else True))
    if not len(rows):
        return None
    P = np.linalg.inv(covariance[np.ix_(rows, rows)])
    whole = P.sum(axis=1)
    Q, lengths = np.zeros_like(covariance), np.full(len(usual), np.nan)
    Q[np.ix_(rows, rows)] = P - np.outer(whole, whole) / whole.sum()
    lengths[rows] = usual[rows]
    return Lengths(lengths, Q)
