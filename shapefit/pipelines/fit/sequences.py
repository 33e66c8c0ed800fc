"""Whole sequences: their images are read together, and refined as frames of one moving
body.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.config import FitConfig
from shapefit.dictionary.bodies import (
    find_limbs,
    name_joints,
    precision_of_ratios,
)
from shapefit.dictionary.model import Dictionary
from shapefit.io import LandmarkSource
from shapefit.lifting.estimate import PosteriorEstimate
from shapefit.lifting.lift import Lifting
from shapefit.lifting.posterior.method import scale_of_bars
from shapefit.lifting.sequences.clips import (
    BodyMotion,
    refine_lifting,
    split_into_clips,
)
from shapefit.lifting.sequences.exchanges import find_exchanges
from shapefit.lifting.sequences.smoothing import CONSTANTS, Lengths
from shapefit.lifting.sequences.through_camera import refine_through_camera
from shapefit.pipelines.fit.family import Batch, Calibration, Cost, LiftedImages, Pace
from shapefit.pipelines.fit.posterior import PosteriorFamily, make_posterior_family
from shapefit.pipelines.fit.whole_sequences import whole_sequences
from shapefit.pipelines.joints import LandmarkMatch
from shapefit.records import Fit, Landmarks
from shapefit.timeline import ASSUMED_RATE, Timeline, place_in_time

USUAL_ACCELERATION = 0.02
"""Second difference of a coordinate from image to image where the dictionary knows
none, in units of the size of the body: that of subject 86 at 24 Hz.
"""

MIN_WHOLE_SHARE = 0.75
"""Share of the landmarks of a whole body that detectors see: on film 13 of 15, of a
body to the hips 8.
"""

MIN_BONE_TOLERANCE = 0.005
"""Deviation of a bone from its length that no data are more exact than, in the same
units.
"""


def make_sequence_family(
    config: FitConfig, match: LandmarkMatch, calibration: Calibration | None
) -> SequenceFamily:
    """Return the sequence family with a config's options and calibrated values."""
    of_images = make_posterior_family(config, match, calibration)
    return SequenceFamily(
        of_images=of_images, noise=config.noise, frame_rate=config.frame_rate
    )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SequenceFamily:
    """The posterior of whole sequences: rigid bones and smooth motion.

    of_images, by which single images are lifted, and a sample; noise, the stated
    standard deviation of a landmark's coordinate, None if there is none; frame_rate in
    place of that of the files.
    """

    of_images: PosteriorFamily
    noise: float | None = None
    frame_rate: float | None = None

    @property
    def dictionary(self) -> Dictionary:
        """Return the dictionary whose landmarks are lifted."""
        return self.of_images.dictionary

    def check(self, sample: Landmarks) -> None:
        """Raise nothing: this family needs only landmarks."""

    def predict_cost(self, sample: Landmarks, total: int) -> Cost:
        """Predict the cost of single images, as smoothing costs less."""
        return self.of_images.predict_cost(sample, total)

    def calibrate(self, sample: Landmarks) -> Calibration:
        """Estimate what the options leave open from the single images of a sample."""
        return self.of_images.calibrate(sample)

    def read_batches(self, source: LandmarkSource, pace: Pace) -> Iterator[Batch]:
        """Yield batches as large as the pace allows, in which sequences are whole."""
        return map(Batch, whole_sequences(source.batches(pace.max_images)))

    def lift(self, images: Landmarks, group: Integers | None = None) -> LiftedImages:
        """Lift images, left and right put back, and refine whole sequences of them."""
        posterior = replace(self.of_images.posterior, modes=CONSTANTS.modes)
        visible = posterior.weigh(images) > 0
        rate = self.frame_rate or images.frame_rate
        images, sides = restore_sides(images, visible, posterior.dictionary, rate)
        lifting = posterior.lift_with_p_values(images)
        lifting = self.refine(lifting, images)
        estimate = replace(lifting.estimate, sides_exchanged=sides)
        lifting = replace(lifting, estimate=estimate)
        return self.of_images.convert_to_joints(lifting, images)

    def add_columns(self, fit: Fit, lifting: Lifting[PosteriorEstimate]) -> Fit:
        """Return the fit with error bars, verdicts, and what only sequences tell."""
        estimate = lifting.estimate
        return replace(
            self.of_images.add_columns(fit, lifting),
            sequence_noise=estimate.sequence_noise,
            image_error=estimate.image_error,
            sides_exchanged=estimate.sides_exchanged,
        )

    def refine(
        self, lifting: Lifting[PosteriorEstimate], images: Landmarks
    ) -> Lifting[PosteriorEstimate]:
        """Refine liftings of single images by the motion of whole sequences.

        People whose hips the files do not show keep the shapes of their single images.
        """
        posterior = self.of_images.posterior
        dictionary = posterior.dictionary
        sequences = images.sequences or ()
        if hides_the_hips(dictionary, posterior.shown):
            sequences = tuple(map(str, range(len(images))))
        motion = replace(
            motion_between_frames(dictionary, self.frame_rate or images.frame_rate),
            of_half_body=shows_half_a_body(dictionary, posterior.shown),
        )
        bar_scale = scale_of_bars(
            posterior.bar_scale, posterior.growth, len(dictionary.landmark_names)
        )
        refine = partial(
            refine_lifting,
            sequences=sequences,
            motion=motion,
            residual_variance=posterior.variance,
            noise=self.noise,
            bar_scale=bar_scale,
            shown=posterior.shown,
            position=place_frames(images, motion.rate),
            threads=posterior.threads,
        )
        return refine_through_camera(lifting, images.as_columns(), refine)


def restore_sides(
    images: Landmarks, visible: Flags, dictionary: Dictionary, rate: float | None
) -> tuple[Landmarks, Floats]:
    """Undo exchanges of left and right landmarks in some frames, by continuity.

    visible (n, p), which landmarks count; rate, frames a second, if it is known.
    Returns with the images 1 (n,) where they are put back, else 0, and nan where sides
    change places in the sequence and nobody knows which are right.
    """
    exchanged = np.zeros(len(images))
    partner = dictionary.mirror_index
    rate = rate or ASSUMED_RATE
    if partner is None or images.sequences is None:
        return images, exchanged
    left = np.flatnonzero(partner > np.arange(len(partner)))
    pairs = np.stack([left, partner[left]], axis=1)
    w = np.where(visible[:, None], images.as_columns(), np.nan)
    wrong = np.zeros(len(images), dtype=bool)
    position = place_frames(images, rate)
    for clip in split_into_clips(images.sequences):
        exchanges = find_exchanges(w[clip], pairs, Timeline(position[clip], rate))
        wrong[clip] = exchanges.exchanged
        exchanged[clip] = exchanges.exchanged if exchanges.continuous else np.nan
    return exchange_sides(images, partner, wrong), exchanged


def exchange_sides(images: Landmarks, partner: Integers, rows: Flags) -> Landmarks:
    """Exchange left and right landmarks of the images that `rows` (n,) flags."""
    if not rows.any():
        return images
    w = images.landmarks
    landmarks = np.where(rows[:, None, None], w[:, partner], w)
    confidence = images.confidence
    if confidence is not None:
        confidence = np.where(rows[:, None], confidence[:, partner], confidence)
    return replace(images, landmarks=landmarks, confidence=confidence)


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
    """Whether files show too few of the independent landmarks for a whole body."""
    independent = dictionary.depends_on < 0
    return shown is not None and shown.sum() < MIN_WHOLE_SHARE * independent.sum()


def place_frames(images: Landmarks, rate: float) -> Floats:
    """Return the position (n,) of each image in its sequence, counted in frames."""
    places = np.empty(len(images))
    for clip in split_into_clips(images.sequences or ()):
        frames = None if images.frames is None else images.frames[clip]
        times = None if images.times is None else images.times[clip]
        places[clip] = place_in_time(frames, times, rate, clip.stop - clip.start)
    return places


def motion_between_frames(dictionary: Dictionary, rate: float | None) -> BodyMotion:
    """Return the BodyMotion between frames at a rate in Hz, else at that of training.

    Second differences grow with the 3/2th power of the time, where a velocity wanders.
    """
    edges = np.empty((0, 2), np.int64) if dictionary.edges is None else dictionary.edges
    acceleration, tolerance = dictionary.acceleration, dictionary.bone_tolerance
    if acceleration is None:
        acceleration = np.full(len(dictionary.landmark_names), USUAL_ACCELERATION)
    elif rate is not None and dictionary.frame_rate is not None:
        acceleration = acceleration * (dictionary.frame_rate / rate) ** 1.5
    if tolerance is None:
        tolerance = np.full(len(edges), USUAL_ACCELERATION)
    rate = rate or dictionary.frame_rate or ASSUMED_RATE
    lengths = find_usual_lengths(dictionary)
    return BodyMotion(
        edges, acceleration, np.maximum(tolerance, MIN_BONE_TOLERANCE), lengths, rate
    )


def find_usual_lengths(dictionary: Dictionary) -> Lengths | None:
    """Return the mean and precision of bone lengths over training bodies, or None.

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
    is_counted = usual > 0
    is_limb = find_limbs(dictionary.landmark_names, edges)
    if is_limb.any():
        is_counted &= is_limb
    rows = np.flatnonzero(is_counted)
    if not len(rows):
        return None
    Q = np.zeros_like(covariance)
    Q[np.ix_(rows, rows)] = precision_of_ratios(covariance[np.ix_(rows, rows)])
    lengths = np.full(len(usual), np.nan)
    lengths[rows] = usual[rows]
    return Lengths(lengths, Q)
