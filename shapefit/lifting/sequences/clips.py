"""The method `sequences`: the posterior of every image, then of every sequence.

Error bars. Smoothing takes the errors of frames for independent. But what the prior and
the view get wrong in one frame they get wrong in its neighbours, too, and what a
detector gets wrong of a landmark in all frames does not average out either:

    C_t = S_t + r^2 P_t + sigma^2 I

for the covariance S_t of a landmark that smoothing gives, P_t of the image alone, and
the deviation sigma with which the landmarks were taken.

A body that walks towards the camera grows in its image, and so do its bones. So a
sequence is inferred twice: in one unit, and in units that follow the smoothed scales of
the images. What agrees better with the images, by the energy of the objective, is
taken. A sequence that would move its images too far (`CONSTANTS.max_displacement`) is
inferred without bones, and keeps the error bars of these; of a half body, whose unseen
landmarks smoothing would draw after them, the images stay as they are. Both are decided
for each stretch of the sequence between long gaps, and each has a unit in which its
lengths, inferred from it alone, are together as long as those of the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from math import ceil
from typing import NamedTuple

import numpy as np

from shapefit.arrays import (
    Flags,
    Floats,
    Indices,
    Integers,
    finite_median,
    median,
    split_runs,
)
from shapefit.convex.solver import Status
from shapefit.lifting.estimate import PAIRS, PosteriorEstimate
from shapefit.lifting.lift import Lifting
from shapefit.lifting.posterior.posterior import Modes
from shapefit.lifting.sequences.smoothing import (
    CONSTANTS,
    Lengths,
    Observations,
    SequenceModel,
    Smoothed,
    observe,
    smooth,
)
from shapefit.lifting.trust import expected_error
from shapefit.threads import map_ahead, on_threads, thread_count
from shapefit.timeline import ASSUMED_RATE, Timeline, begins_sequence

MAX_CLIP_FRAMES = 4096
"""Frames that are refined together; longer sequences are cut into parts of about one
length, for memory.
"""

MIN_CLIP_FRAMES = 3
"""Frames of a sequence: fewer have no acceleration and stay what their images say."""

GAP_WEIGHT = 1e-6
"""Of an interpolated scale beside that of an image: it decides in long gaps alone."""

MOTION_SHARE = 8.2
"""2.5 P - 0.5 N of a smooth motion in its mean squares, see
`find_acceleration_scale`."""

GAUSSIAN_MEDIAN = 0.6745
"""Median of |x| of a Gaussian, in standard deviations."""


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """How bodies move and are built, in units of the size of their landmarks.

    bones (e, 2) keep their lengths with standard deviations bone_tolerance (e,);
    acceleration (p,), the root of the mean square of the second difference of a
    coordinate from frame to frame; usual, the usual lengths; rate, frames a second;
    of_half_body, whether much of the body is never seen.
    """

    bones: Integers
    acceleration: Floats
    bone_tolerance: Floats
    usual: Lengths | None = None
    rate: float = ASSUMED_RATE
    of_half_body: bool = False


@dataclass(frozen=True, eq=False)
class Clips:
    """n images, sequence after sequence, in the unit of the landmarks.

    landmarks (n, 2, p); trust (n, p), the inlier probability times the square of its
    confidence; points (n, 3, p), the posterior means, nan where there is none; scale
    and centre (n,), (n, 2): a normalised point x is scale x + centre; modes,
    normalised; residual_variance, of normalised landmarks in the posteriors; noise, the
    stated deviation of a coordinate of the landmarks, None where they are no better
    than that; deviation (n, 3, p) of points; position (n,) of each image in its
    sequence, in frames, see `place_in_time`.
    """

    landmarks: Floats
    trust: Floats
    points: Floats
    scale: Floats
    centre: Floats
    modes: Modes
    residual_variance: float
    noise: float | None
    deviation: Floats
    position: Floats


class RefinedClips(NamedTuple):
    """Points and error bars of n images, into which each sequence writes its own.

    points, deviation and correlation (n, 3, p), noise (n,); covariance (n, 3p, 3p) of
    all landmarks of an image; converged (n,), whether the inference of the sequence
    ended at a minimum.
    """

    points: Floats
    deviation: Floats
    correlation: Floats
    noise: Floats
    covariance: Floats
    converged: Flags


def refine_lifting(
    lifting: Lifting[PosteriorEstimate],
    landmarks: Floats,
    sequences: Sequence[str],
    motion: BodyMotion,
    residual_variance: float,
    noise: float | None,
    bar_scale: Floats,
    shown: Flags | None = None,
    position: Floats | None = None,
    threads: int = 0,
) -> Lifting[PosteriorEstimate]:
    """Infer the shapes of whole sequences from the modes of their images.

    landmarks (n, 2, p) as observed; residual_variance and noise as in `Clips`;
    bar_scale (p,), by which standard deviations of the landmarks have been multiplied;
    position (n,) as in `Clips`, or one image after the other; threads as in
    `refine_clips`. The covariances of the modes are written over. All but the shapes
    and what is known of them stays that of the images.
    """
    estimate = lifting.estimate
    image_covariance = estimate.covariance
    assert image_covariance is not None, "the images were lifted with covariances"
    clips = _lay_out(lifting, landmarks, residual_variance, noise, bar_scale, position)
    refined = refine_clips(clips, sequences, motion, threads)
    is_single = np.isnan(refined.noise)
    # (n, p): from the unit of the landmarks to that of error bars, and widened
    to_bars = bar_scale / lifting.scale[:, None]
    rows = nearest_informative(
        is_informative(clips), split_into_clips(sequences), clips.position
    )
    constant = refined.noise[:, None] * to_bars
    bars, correlation = add_common_error(
        smoothed=(refined.deviation * to_bars[:, None], refined.correlation),
        images=(
            estimate.deviation[rows],
            estimate.correlation[rows].astype(np.float64),
        ),
        constant=constant,
    )
    one_image = is_single[:, None, None]
    covariance = _add_common_covariance(
        refined.covariance, to_bars, image_covariance, rows, constant
    )
    covariance[is_single] = image_covariance[is_single]
    error_of_images = expected_error(lifting.shapes, image_covariance, shown)
    return replace(
        lifting,
        shapes=refined.points,
        landmarks_fitted=refined.points[:, :2].copy(),
        estimate=replace(
            estimate,
            status=_mark_stopped(estimate.status, ~refined.converged),
            deviation=np.where(one_image, estimate.deviation, bars),
            correlation=np.where(
                one_image, estimate.correlation, correlation.astype(np.float32)
            ),
            covariance=covariance,
            modes=None,
            sequence_noise=refined.noise,
            image_error=lifting.scale * error_of_images,
        ),
    )


def _lay_out(
    lifting: Lifting[PosteriorEstimate],
    landmarks: Floats,
    residual_variance: float,
    noise: float | None,
    bar_scale: Floats,
    position: Floats | None,
) -> Clips:
    """Return the images of a lifting as `Clips`, before `bar_scale` widened error bars.

    The lifting must have modes.
    """
    estimate = lifting.estimate
    weights = lifting.problem.weights
    assert estimate.modes is not None, "the images were lifted with their modes"
    if position is None:
        position = np.arange(len(landmarks), dtype=np.float64)
    inlier_probability = np.nan_to_num(estimate.inlier_probability)
    return Clips(
        landmarks=np.where((weights > 0)[:, None], landmarks, np.nan),
        trust=inlier_probability * weights**2,
        points=lifting.shapes,
        scale=lifting.scale,
        centre=lifting.translation - lifting.scale[:, None] * estimate.translation,
        modes=estimate.modes,
        residual_variance=residual_variance,
        noise=noise,
        deviation=lifting.scale[:, None, None] * estimate.deviation / bar_scale,
        position=position,
    )


def _add_common_covariance(
    smoothed: Floats, to_bars: Floats, images: Floats, rows: Indices, constant: Floats
) -> Floats:
    """Return smoothed covariances with the errors added that frames have in common.

    C = S + r^2 P + sigma^2 I, all (n, 3p, 3p), sigma (n, p); see above. It is written
    over S, as these take most of the memory. S is in the unit of the landmarks, C in
    that of error bars, of to_bars (n, p) times the numbers; P of the image t is in row
    rows[t].
    """
    covariance = smoothed
    factor = np.tile(to_bars, 3)
    covariance *= factor[:, :, None]
    covariance *= factor[:, None]
    for t in range(len(covariance)):
        covariance[t] += CONSTANTS.common_share**2 * images[rows[t]]
    axes = range(covariance.shape[1])
    covariance[:, axes, axes] += np.tile(constant, 3) ** 2
    return covariance


def _mark_stopped(status: tuple[Status, ...], is_stopped: Flags) -> tuple[Status, ...]:
    """Return the statuses with ITERATION_LIMIT for images of stopped sequences."""
    if not is_stopped.any():
        return status
    both = zip(is_stopped, status, strict=True)
    return tuple(Status.ITERATION_LIMIT if stopped else old for stopped, old in both)


def refine_clips(
    clips: Clips,
    sequences: Sequence[str],
    motion: BodyMotion,
    threads: int = 0,
) -> RefinedClips:
    """Infer the shapes of each sequence from all of its images, and their error bars.

    All but correlations in the unit of the landmarks. nan in all but the points where
    the inference is that of the images: they are alone or nearly so in their sequence,
    or contradict it. Sequences are refined on `threads` threads, 0 means one per core;
    the results do not depend on them.
    """
    n, _, p = clips.points.shape
    refined = RefinedClips(
        points=clips.points.copy(),
        deviation=np.full_like(clips.points, np.nan),
        correlation=np.full_like(clips.points, np.nan),
        noise=np.full(n, np.nan),
        covariance=np.full((n, 3 * p, 3 * p), np.nan),
        converged=np.ones(n, bool),
    )
    is_finite: Flags = np.asarray(np.isfinite(clips.points).all(axis=(1, 2)))
    informative = is_informative(clips)
    clips = replace(
        clips,
        scale=np.where(informative, clips.scale, np.nan),
        points=np.where(informative[:, None, None], clips.points, np.nan),
    )
    long = [
        clip
        for clip in split_into_clips(sequences)
        if informative[clip].sum() >= MIN_CLIP_FRAMES
    ]

    def refine(clip: slice, workers: int = 0) -> None:
        refine_clip(
            clips, clip, informative[clip], is_finite[clip], motion, refined, workers
        )

    threads = thread_count(threads)
    # those that are left when each thread has as many as the others
    divided = len(long) % threads
    on_threads(refine, long[divided:], threads)
    on_threads(partial(refine, workers=2), long[:divided], threads // 2)
    return refined


def is_informative(clips: Clips) -> Flags:
    """Whether the posteriors of images (n,) are narrower than `max_deviation`."""
    is_finite = np.isfinite(clips.points).all(axis=(1, 2))
    width = np.sqrt((clips.deviation**2).mean(axis=(1, 2)))
    informative: Flags = is_finite & (width < CONSTANTS.max_deviation * clips.scale)
    return informative


def split_into_clips(sequences: Sequence[str]) -> list[slice]:
    """Return slices of images to refine together: of one sequence, not too many.

    Equal neighbours in `sequences` (n,), see `begins_sequence`, divided where they are
    more than MAX_CLIP_FRAMES.
    """
    slices = []
    for sequence in split_runs(begins_sequence(sequences), len(sequences)):
        frames = sequence.stop - sequence.start
        pieces = ceil(frames / MAX_CLIP_FRAMES)
        for piece in range(pieces):
            begin = sequence.start + frames * piece // pieces
            end = sequence.start + frames * (piece + 1) // pieces
            slices.append(slice(begin, end))
    return slices


def refine_clip(
    clips: Clips,
    clip: slice,
    informative: Flags,
    is_finite: Flags,
    motion: BodyMotion,
    refined: RefinedClips,
    workers: int,
) -> None:
    """Infer the t frames of one sequence, and write them into `refined`.

    clip: its rows of all images; informative and is_finite (t,): which of its images
    say something of their frame, and which have a shape at all. workers: threads on
    which both of its units are inferred side by side; with 0 it is one after the other.
    """
    inference = Inference(clips, clip, informative, is_finite, motion, refined)
    stretches = inference.stretches
    growth = relative_scales(
        (clips.scale * clips.modes.scale[:, 0])[clip],
        informative,
        CONSTANTS.scale_seconds * motion.rate,
        inference.timeline,
    )
    visible = observe_clip(clips, clip, inference.size)
    steady = np.ones(len(informative))
    if len(stretches) > 1:
        # how far away it is after a gap, only its images say
        for stretch in stretches:
            steady[stretch] = np.exp(np.log(growth[stretch]).mean())
        visible = visible.in_larger_unit(steady)
        larger = inference.relative_sizes(visible)
        visible = visible.in_larger_unit(larger)
        steady = steady * larger
        growth = growth * larger
    grown = visible.in_larger_unit(growth / steady)
    with closing(map_ahead(inference.infer, (visible, grown), workers)) as inferred:
        smoothed = next(inferred)
        inference.store(smoothed, steady, slice(0, len(informative)))
        energies = inference.energies_of(smoothed)
        del smoothed  # covariances take most of the memory
        smoothed = next(inferred)
    energies_grown = inference.energies_of(smoothed)
    for stretch, before, after in zip(stretches, energies, energies_grown, strict=True):
        if after < before:
            inference.store(smoothed, growth, stretch)
    del smoothed
    inference.leave_out_bones(grown, growth)


class Inference:
    """The inference of one sequence, in the unit `size` of its landmarks."""

    def __init__(
        self,
        clips: Clips,
        clip: slice,
        informative: Flags,
        is_finite: Flags,
        motion: BodyMotion,
        refined: RefinedClips,
    ) -> None:
        """Prepare the inference of a clip, with flags of its images (t,)."""
        self.clips = clips
        self.clip = clip
        self.informative = informative
        self.motion = motion
        self.refined = refined
        self.timeline = Timeline(clips.position[clip], motion.rate)
        self.stretches = self.timeline.stretches
        self.is_placed = is_finite.copy()
        for stretch in self.stretches:  # where all frames are blind nothing places them
            self.is_placed[stretch] &= informative[stretch].any()
        # before the covariances of the modes are written over
        self.points, self.deviation = moments_of_modes(clips, clip)
        self.size = median(clips.scale[clip][informative])
        sigma = float(np.sqrt(clips.residual_variance))
        if clips.noise is not None:
            stated = max(clips.noise / self.size, CONSTANTS.min_noise)
            sigma = min(stated, sigma)
        self.sigma = sigma
        frames = int(informative.sum()) * sigma**2 / clips.residual_variance
        self.usual = weigh_lengths(motion.usual, frames)

    def infer(
        self,
        visible: Observations,
        timeline: Timeline | None = None,
        *,
        rigid: bool = True,
    ) -> Smoothed:
        """Infer the shapes of the frames of a timeline, by default all of the clip.

        Bones are rigid, or there are none.
        """
        motion = self.motion
        if timeline is None:
            timeline = self.timeline
        lag = max(1, round(CONSTANTS.correlation_seconds * motion.rate))
        places = timeline.frame_numbers(max_missing=3 * lag)
        scale = find_acceleration_scale(visible, motion.acceleration, lag, places)
        model = SequenceModel(
            bones=motion.bones,
            stiffness=(motion.acceleration * scale) ** -2,
            bone_tolerance=motion.bone_tolerance,
            usual=self.usual,
            timeline=timeline,
        )
        if not rigid:
            model = replace(
                model,
                bones=motion.bones[:0],
                bone_tolerance=motion.bone_tolerance[:0],
                usual=None,
            )
        return smooth(visible, model, self.sigma)

    def relative_sizes(self, visible: Observations) -> Floats:
        """Return the size of bones (t,) in each frame's stretch, over the median size.

        1 for a stretch that is too short.
        """
        sizes = np.array(
            [self._size_in(visible, stretch) for stretch in self.stretches]
        )
        relative = np.nan_to_num(sizes / finite_median(sizes, 1.0), nan=1.0)
        frames = [stretch.stop - stretch.start for stretch in self.stretches]
        return np.repeat(relative, frames)

    def _size_in(self, visible: Observations, stretch: slice) -> float:
        """Return the sum of the bone lengths, inferred from a stretch alone.

        nan where it has too few informative images, or the body has no bones.
        """
        is_short = self.informative[stretch].sum() < MIN_CLIP_FRAMES
        if is_short or not len(self.motion.bones):
            return np.nan
        alone = Timeline(self.timeline.position[stretch], self.timeline.rate)
        return float(self.infer(visible.part(stretch), alone).lengths.sum())

    def store(self, smoothed: Smoothed, growth: Floats, stretch: slice) -> None:
        """Write the frames of a stretch into `refined`, in the unit of the landmarks.

        smoothed: all frames of the sequence, in the unit `size` times growth (t,).
        """
        refined = self.refined
        frames = self._placed_in(stretch)
        rows = self.clip.start + frames
        unit = self.size * growth
        factor = unit[frames][:, None, None]
        refined.converged[rows] = smoothed.converged
        refined.points[rows] = factor * smoothed.points[frames]
        refined.deviation[rows] = factor * smoothed.deviation[frames]
        refined.correlation[rows] = smoothed.correlation[frames]
        refined.noise[rows] = self.size * self.sigma
        for frame, row in zip(frames, rows, strict=True):
            refined.covariance[row] = unit[frame] ** 2 * smoothed.covariance[frame]

    def _placed_in(self, stretch: slice) -> Indices:
        """Return the indices of those frames of a stretch that get a shape."""
        rows: Indices = stretch.start + np.flatnonzero(self.is_placed[stretch])
        return rows

    def energies_of(self, smoothed: Smoothed) -> list[float]:
        """Return the objective (energy) of each stretch at the minimum.

        That of the lengths counts only where there is a single stretch.
        """
        if len(self.stretches) == 1:
            return [smoothed.energy]
        return [float(smoothed.energies[stretch].sum()) for stretch in self.stretches]

    def leave_out_bones(self, visible: Observations, growth: Floats) -> None:
        """Replace stretches that moved too far from their images by ones without bones.

        In `refined`; too far is beyond `CONSTANTS.max_displacement`. They keep the
        error bars of their images, and of a half body the points too.
        """
        refined = self.refined
        moved = refined.points[self.clip] - self.points
        square = ((moved / self.deviation) ** 2).mean(axis=(1, 2))
        limit = CONSTANTS.max_displacement
        loose = [
            stretch
            for stretch in self.stretches
            if median(square[find_judging_frames(stretch, self.informative)]) > limit
        ]
        points = self.clips.points[self.clip]
        if loose and not self.motion.of_half_body:
            without_bones = self.infer(visible, rigid=False).points
            points = (self.size * growth)[:, None, None] * without_bones
        for stretch in loose:
            frames = self._placed_in(stretch)
            rows = self.clip.start + frames
            refined.points[rows] = points[frames]
            refined.converged[rows] = True
            refined.noise[rows] = np.nan


def find_judging_frames(stretch: slice, informative: Flags) -> Indices:
    """Return the indices of informative frames that say how far a stretch has moved.

    Its own, or those of the sequence (t,) where these are fewer than MIN_CLIP_FRAMES.
    """
    own = stretch.start + np.flatnonzero(informative[stretch])
    return own if len(own) >= MIN_CLIP_FRAMES else np.flatnonzero(informative)


def relative_scales(
    scale: Floats, informative: Flags, width: float, timeline: Timeline
) -> Floats:
    """Return the scales (t,) of images, smoothed over time and divided by their mean.

    informative (t,): the images whose scales count. width: standard deviation of the
    window, in frames. The mean is the geometric one. Each stretch is smoothed by
    itself; one without an informative image is interpolated between others.
    """
    level = np.full(len(scale), np.nan)
    places = timeline.frame_numbers()
    for stretch in timeline.stretches:
        if informative[stretch].any():
            place = places[stretch] - places[stretch.start]
            level[stretch] = smooth_log_scale(
                scale[stretch], informative[stretch], width, place
            )
    known = np.isfinite(level)
    between = np.interp(timeline.position, timeline.position[known], level[known])
    level = np.where(known, level, between)
    relative: Floats = np.exp(level - level[informative].mean())
    return relative


MIN_NEIGHBOUR_WEIGHT = 1e-6
"""Of the frame beside that in the middle of a window, which holds one frame alone below
it, as at low frame rates.
"""


def smooth_log_scale(
    scale: Floats, informative: Flags, width: float, place: Integers
) -> Floats:
    """Return the logarithms (t,) of the scales of images, smoothed over time.

    Local linear regression, with a Gaussian window of `width` frames. informative (t,):
    the images whose scales count; place (t,) of the images among the frames, from 0.
    """
    rows = place[informative]
    level = np.interp(np.arange(place[-1] + 1), rows, np.log(scale[informative]))
    if len(level) == 1:
        return level
    weight = np.full(len(level), GAP_WEIGHT)
    weight[rows] = 1.0
    reach = min(int(4 * width) + 1, len(level) - 1)
    k = np.arange(-reach, reach + 1)
    window = np.exp(-0.5 * (k / width) ** 2)
    if window[reach + 1] < MIN_NEIGHBOUR_WEIGHT:
        return level[place]

    def total(x: Floats, power: int) -> Floats:
        """Return sum_k window_k k^power x_(t+k) at each frame t."""
        return np.convolve(x, window * (-k) ** power)[reach : len(x) + reach]

    S0 = total(weight, 0)
    S1 = total(weight, 1)
    S2 = total(weight, 2)
    T0 = total(weight * level, 0)
    T1 = total(weight * level, 1)
    line: Floats = (S2 * T0 - S1 * T1) / (S0 * S2 - S1**2)
    smooth: Floats = line[place]
    return smooth


def weigh_lengths(usual: Lengths | None, frames: float) -> Lengths | None:
    """Raise the precision of usual lengths for `frames` frames of correlated errors.

    Their precision becomes (1 + r^2 t) Q; None for None. What t images say of the
    lengths has the variance P (1 / t + r^2), as their deviations have the share r in
    common; the objective takes it for P / t. So images would count (1 + r^2 t) times
    too much beside Q: their errors do not average out, however many they are. Frames
    whose landmarks are stated to be exacter count for the share sigma^2 / v of their
    variance that is left.
    """
    if usual is None:
        return None
    worth = 1 + CONSTANTS.common_share**2 * frames
    return usual._replace(precision=worth * usual.precision)


def moments_of_modes(clips: Clips, clip: slice) -> tuple[Floats, Floats]:
    """Return means and deviations (t, 3, p) of the mixtures of the modes of a clip.

    They are what the landmarks of each image say without usual lengths of limbs, which
    a sequence has besides.
    """
    modes = clips.modes
    log_evidence = modes.log_evidence[clip]
    best = np.maximum(log_evidence.max(axis=1, keepdims=True), np.finfo(float).min)
    share = np.exp(log_evidence - best)
    share /= np.maximum(share.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    means = np.where(share[:, :, None, None] > 0, modes.mean[clip], 0.0)
    variance = np.diagonal(modes.covariance[clip], axis1=2, axis2=3)
    mean = np.einsum("tm,tmap->tap", share, means)
    apart = (means - mean[:, None]) ** 2 + variance.reshape(means.shape)
    deviation = np.sqrt(np.einsum("tm,tmap->tap", share, apart))
    scale = clips.scale[clip][:, None, None]
    points = scale * mean
    points[:, :2] += clips.centre[clip][:, :, None]
    return points, scale * deviation


def observe_clip(clips: Clips, clip: slice, unit: float) -> Observations:
    """Return the observations of a clip, its lengths divided by `unit`."""
    is_finite = np.isfinite(clips.scale[clip])
    relative_scale = np.where(is_finite, clips.scale[clip], unit) / unit
    centre = np.where(is_finite[:, None], clips.centre[clip], 0.0) / unit
    means = clips.modes.mean[clip] * relative_scale[:, None, None, None]
    means[:, :, :2] += centre[:, None, :, None]
    log_evidence = clips.modes.log_evidence[clip]
    return observe(
        landmarks=clips.landmarks[clip] / unit,
        trust=clips.trust[clip],
        start=clips.points[clip] / unit,
        log_evidence=np.where(is_finite[:, None], log_evidence, -np.inf),
        means=means,
        covariances=clips.modes.covariance[clip],
        residual_variance=clips.residual_variance,
        covariance_unit=relative_scale,
        position=clips.position[clip],
    )


def find_acceleration_scale(
    visible: Observations,
    acceleration: Floats,
    lag: int,
    place: Integers | None = None,
) -> float:
    """Return how many times faster than expected landmarks move in images, 1 at least.

    Second differences s_t = w_(t+L) - 2 w_t + w_(t-L) over a lag of L frames. Those of
    a smooth motion resemble their neighbours, with a correlation of 0.7; of white noise
    their variance is 6 and the covariance of neighbours -4 times that of the noise. So
    for the variances P and N of the sum and the difference of neighbours

        2.5 P - 0.5 N = 8.2 times the mean square of the motion's.

    It is 1, too, where there are too few frames to tell. By medians, which the jumps of
    a detector do not move, and over a lag beyond which its errors are no motion either.
    A mean square grows with L^3. place (t,) of the images among the frames, one after
    the other without it.
    """
    w = np.where(visible.trust[:, None] > 0, visible.landmarks, np.nan)
    if place is not None:
        seen = w
        w = np.full((place[-1] + 1, *seen.shape[1:]), np.nan)
        w[place] = seen
    if len(w) <= 3 * lag:
        return 1.0
    second = w[2 * lag :] - 2 * w[lag:-lag] + w[: -2 * lag]
    P = median_variance(second[lag:] + second[:-lag])
    N = median_variance(second[lag:] - second[:-lag])
    moving = np.maximum(2.5 * P - 0.5 * N, 0.0) / MOTION_SHARE / lag**3
    is_known = np.isfinite(moving)
    if not is_known.any():
        return 1.0
    expected = (acceleration[is_known] ** 2).sum()
    return float(np.sqrt(max(moving[is_known].sum() / expected, 1.0)))


def median_variance(values: Floats) -> Floats:
    """Return the variance (p,) of values (t, 2, p) about 0, estimated by their median.

    From the median of their sizes, as of a Gaussian; nan where nothing is known.
    """
    sizes = np.sort(np.abs(values.reshape(-1, values.shape[2])), axis=0)  # nan is last
    count = np.isfinite(sizes).sum(axis=0)
    low = np.maximum(count - 1, 0) // 2
    high = np.minimum(count // 2, len(sizes) - 1)
    columns = np.arange(sizes.shape[1])
    middle = (sizes[low, columns] + sizes[high, columns]) / 2
    return np.where(count > 0, (middle / GAUSSIAN_MEDIAN) ** 2, np.nan)


def add_common_error(
    smoothed: tuple[Floats, Floats], images: tuple[Floats, Floats], constant: Floats
) -> tuple[Floats, Floats]:
    """Return deviations and correlations with the errors that frames have in common.

    Those of C, from those of S (smoothed) and P (images), all (n, 3, p), and from sigma
    (n, p), the constant; see above. Correlations of x with y, x with z, and y with z of
    each landmark. A correlation of a landmark that has no deviation is 0.
    """
    sd, mixed = smoothed
    image_sd, image_mixed = images
    share = CONSTANTS.common_share
    deviation = np.hypot(np.hypot(sd, share * image_sd), constant[:, None])
    correlation = np.empty_like(deviation)
    for row, (a, b) in enumerate(PAIRS):
        of_smoothed = mixed[:, row] * sd[:, a] * sd[:, b]
        of_image = share**2 * image_mixed[:, row] * image_sd[:, a] * image_sd[:, b]
        product = deviation[:, a] * deviation[:, b]
        divisor = np.where(product == 0, 1.0, product)
        correlation[:, row] = (of_smoothed + of_image) / divisor
    return deviation, correlation


def nearest_informative(
    informative: Flags, clips: Iterable[slice], position: Floats
) -> Indices:
    """Return the row (n,) of the nearest informative frame of the same clip.

    Its own where none is; position (n,) in time. An image that says nothing has a
    covariance that says nothing of the errors of its frame.
    """
    rows = np.arange(len(informative))
    for clip in clips:
        there = np.flatnonzero(informative[clip])
        lacking = np.flatnonzero(~informative[clip])
        if len(there) and len(lacking):
            place = position[clip]
            distance = np.abs(place[lacking][:, None] - place[there])
            nearest = distance.argmin(axis=1)
            rows[clip.start + lacking] = clip.start + there[nearest]
    return rows
