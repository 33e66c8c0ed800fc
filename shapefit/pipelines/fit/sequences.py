"""Whole sequences: their images are read together, and refined as frames of one moving
body.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.dictionary.bodies import (
    find_limbs,
    name_joints,
    precision_of_ratios,
)
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.lifting.lift import Lifting
from shapefit.lifting.posterior.method import scale_of_bars
from shapefit.lifting.sequences.clips import LONGEST, Motion, refine_lifting, split
from shapefit.lifting.sequences.exchanges import find_exchanges
from shapefit.lifting.sequences.smoothing import Lengths
from shapefit.lifting.sequences.through_camera import refine_through_camera
from shapefit.pipelines.fit.lift import Lifter
from shapefit.records import Landmarks, concatenate
from shapefit.timeline import ASSUMED_RATE, Timeline, place_in_time

USUAL = 0.02
"""Second difference of a coordinate from image to image where the dictionary knows
none, in units of the size of the body: that of subject 86 at 24 Hz.
"""

WHOLE = 0.75
"""Share of the landmarks of a whole body that detectors see: on film 13 of 15, of a
body to the hips 8.
"""

RIGID = 0.005
"""Deviation of a bone from its length that no data are more exact than, in the same
units.
"""


def whole_sequences(chunks: Iterable[Landmarks]) -> Iterator[Landmarks]:
    """Yield images whose sequences are whole, in their order; a long one in pieces.

    Raises InputError for images without sequences, for those of a sequence that are
    apart, and for two of one frame.
    """
    begun: set[str] = set()
    rest: list[Landmarks] = []
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


def _check_order(images: Landmarks, row: int) -> None:
    """Raise InputError where an image is not of a later frame than that before it."""
    frames, names = images.frames, images.sequences
    if frames is None or not (names and names[row]) or frames[row] > frames[row - 1]:
        return
    fault = (
        f"'{images.items[row - 1]}' is of the frame {frames[row - 1]}, and then"
        f" '{images.items[row]}' of {frames[row]}"
    )
    fix = "give one image per frame of a sequence, in order of time"
    raise input_error("frame", fault, fix)


def pieces(images: Landmarks) -> Iterator[Landmarks]:
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
    images: Landmarks, visible: Flags, lifter: Lifter
) -> tuple[Landmarks, Floats]:
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
    w = np.where(visible[:, None], images.as_columns(), np.nan)
    wrong = np.zeros(len(images), dtype=bool)
    position = place_images(images, rate)
    for clip in split(images.sequences):
        exchanges = find_exchanges(w[clip], pairs, Timeline(position[clip], rate))
        wrong[clip] = exchanges.exchanged
        exchanged[clip] = exchanges.exchanged if exchanges.continuous else np.nan
    return exchange_sides(images, partner, wrong), exchanged


def exchange_sides(images: Landmarks, partner: Integers, rows: Flags) -> Landmarks:
    """Exchange left and right of some images (n,), landmarks and confidences."""
    if not rows.any():
        return images
    w, confidence = images.landmarks, images.confidence
    landmarks = np.where(rows[:, None, None], w[:, partner], w)
    if confidence is not None:
        confidence = np.where(rows[:, None], confidence[:, partner], confidence)
    return replace(images, landmarks=landmarks, confidence=confidence)


def refine_sequences(lifting: Lifting, images: Landmarks, lifter: Lifter) -> Lifting:
    """Infer whole sequences from the liftings of their images.

    People whose hips the files do not show keep the shapes of their single images.
    """
    dictionary, bars = lifter.dictionary, lifter.posterior
    sequences = images.sequences or ()
    if hides_the_hips(dictionary, lifter.shown):
        sequences = tuple(map(str, range(len(images))))
    motion = replace(
        find_motion(dictionary, lifter.frame_rate or images.frame_rate),
        of_half_body=shows_half_a_body(dictionary, lifter.shown),
    )
    refine = partial(
        refine_lifting,
        sequences=sequences,
        motion=motion,
        residual_variance=lifter.variance,
        noise=lifter.noise,
        bar_scale=scale_of_bars(
            bars.bar_scale, bars.growth, len(dictionary.landmark_names)
        ),
        shown=lifter.shown,
        position=place_images(images, motion.rate),
        threads=lifter.threads,
    )
    return refine_through_camera(lifting, images.as_columns(), refine)


def hides_the_hips(dictionary: Dictionary, shown: Flags | None) -> bool:
    """Whether a dictionary has limbs of people, and the files show no hip.

    How the trunk stands is then a guess of the prior, alike in all frames: motion makes
    it no better, and what the guess gets wrong is made to agree.
    """
    if shown is None or dictionary.edges is None:
        return False
    names = dictionary.landmark_names
    of_people = find_limbs(names, dictionary.edges).any()
    hips = [joint == "hip" for joint in name_joints(names)]
    return bool(of_people) and any(hips) and not shown[hips].any()


def shows_half_a_body(dictionary: Dictionary, shown: Flags | None) -> bool:
    """Whether files show less than WHOLE of the landmarks that depend on no other."""
    independent = dictionary.depends_on < 0
    return shown is not None and shown.sum() < WHOLE * independent.sum()


def place_images(images: Landmarks, rate: float) -> Floats:
    """Return the places (n,) of images in their sequences, in frames."""
    places = np.empty(len(images))
    for clip in split(images.sequences or ()):
        frames = None if images.frames is None else images.frames[clip]
        times = None if images.times is None else images.times[clip]
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

    Of any size, and of people only limbs: detectors put hips, shoulders and heads
    elsewhere than training shapes have them.
    """
    usual, covariance, edges = (
        dictionary.edge_length,
        dictionary.edge_covariance,
        dictionary.edges,
    )
    if usual is None or covariance is None or edges is None:
        return None
    limbs = find_limbs(dictionary.landmark_names, edges)
    rows = np.flatnonzero((usual > 0) & (limbs if limbs.any() else True))
    if not len(rows):
        return None
    Q, lengths = np.zeros_like(covariance), np.full(len(usual), np.nan)
    Q[np.ix_(rows, rows)] = precision_of_ratios(covariance[np.ix_(rows, rows)])
    lengths[rows] = usual[rows]
    return Lengths(lengths, Q)
