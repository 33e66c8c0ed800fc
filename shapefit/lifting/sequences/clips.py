"""The method `sequences`: the posterior of every image, and then of every sequence as a
whole.

Error bars. Smoothing takes the errors of frames for independent. But what the prior and
the view get wrong in one frame they get wrong in its neighbours, too, and what a
detector gets wrong of a landmark in all frames does not average out either:

    C_t = S_t + r^2 P_t + sigma^2 I

for the covariance S_t of a landmark that smoothing gives, P_t of the image alone, and
the deviation sigma with which the landmarks were taken.

A body that walks towards the camera grows in its image, and so do its bones. So a
sequence is inferred twice: in one unit, and in units that follow the smoothed scales of
the images. What agrees better with the images, by the energy of the objective, is
taken. A sequence that would move its images too far (`CONSTANTS.farthest`) is inferred
without bones, and keeps the error bars of these; of a half body, whose unseen landmarks
smoothing would draw after them, the images stay as they are. Both are decided for each
stretch of the sequence between long gaps, and each has a unit in which its lengths,
inferred from it alone, are together as long as those of the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, finite_median, median
from shapefit.convex.problem import Problem
from shapefit.convex.solver import Status
from shapefit.lifting.estimate import CORRELATION, PAIRS, Estimate
from shapefit.lifting.lift import Lifting
from shapefit.lifting.methods import Settings
from shapefit.lifting.posterior.method import lift_to_posterior
from shapefit.lifting.posterior.posterior import Modes
from shapefit.lifting.sequences.smoothing import (
    CONSTANTS,
    Indices,
    Lengths,
    Model,
    Observations,
    Smoothed,
    observe,
    smooth,
)
from shapefit.lifting.trust import IMAGE_ERROR, expected_error
from shapefit.threads import on_threads
from shapefit.timeline import ASSUMED_RATE, Timeline

NOISE = "sequence_noise"
"""Dataset (n,) of the deviation of a coordinate with which the landmarks of a sequence
were taken, nan for images that are not refined.
"""

LONGEST = 4096
"""Frames that are refined together; longer sequences are cut into parts of about one
length, for memory.
"""

FEWEST = 3
"""Frames of a sequence: fewer have no acceleration and stay what their images say."""

GAP = 1e-6
"""Weight of an interpolated scale beside that of an image: it decides within long gaps
alone.
"""


@dataclass(frozen=True)
class Motion:
    """How bodies move and are built, in units of the size of their landmarks.

    bones (e, 2) keep their lengths with standard deviations bone_tolerance (e,);
    acceleration (p,), the root of the mean square of the second difference of a
    coordinate from frame to frame; usual, the usual lengths; rate, frames a second;
    of_half_body, whether much of the body is never seen.
    """

    bones: Indices
    acceleration: Floats
    bone_tolerance: Floats
    usual: Lengths | None = None
    rate: float = ASSUMED_RATE
    of_half_body: bool = False


@dataclass(frozen=True)
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


class Refined(NamedTuple):
    """Points, deviations, correlations (n, 3, p) and noise (n,): each sequence writes
    its own.

    covariance (n, 3p, 3p) of all landmarks of an image; converged (n,), whether the
    inference of the sequence ended at a minimum.
    """

    points: Floats
    deviation: Floats
    correlation: Floats
    noise: Floats
    covariance: Floats
    converged: Flags


def lift_frames(problem: Problem, settings: Settings) -> Estimate:
    """Return the posterior of each image, with the modes from which sequences are
    inferred.
    """
    posterior = lift_to_posterior(problem, settings, modes=CONSTANTS.modes)
    unknown = np.full(len(problem.landmarks), np.nan)
    return replace(posterior, further={**posterior.further, NOISE: unknown})


def refine_lifting(
    lifting: Lifting,
    landmarks: Floats,
    sequences: Sequence[str],
    motion: Motion,
    residual_variance: float,
    noise: float | None,
    bar_scale: Floats,
    shown: Flags | None = None,
    position: Floats | None = None,
    threads: int = 0,
) -> Lifting:
    """Infer the shapes of whole sequences from the modes of their images.

    landmarks (n, 2, p) as observed; residual_variance and noise as in `Clips`;
    bar_scale (p,), by which standard deviations of the landmarks have been multiplied;
    position (n,) as in `Clips`, or one image after the other; threads as in
    `refine_clips`. The covariances of the modes are written over. All but the shapes
    and what is known of them stays that of the images.
    """
    estimate = lifting.estimate
    modes = estimate.posterior_modes
    weights = lifting.problem.weights
    visible = (weights > 0)[:, None]
    image_sd, image_mixed, of_images = (
        estimate.deviation,
        estimate.further[CORRELATION],
        estimate.covariance,
    )
    assert modes is not None  # as lift_frames returns them, with covariances
    assert image_sd is not None
    assert of_images is not None
    centre = lifting.translation - lifting.scale[:, None] * estimate.translation
    clips = Clips(
        landmarks=np.where(visible, landmarks, np.nan),
        trust=np.nan_to_num(estimate.further["inlier_probability"]) * weights**2,
        points=lifting.shapes,
        scale=lifting.scale,
        centre=centre,
        modes=modes,
        residual_variance=residual_variance,
        noise=noise,
        deviation=lifting.scale[:, None, None] * image_sd / bar_scale,
        position=(
            np.arange(len(landmarks), dtype=np.float64)
            if position is None
            else position
        ),
    )
    refined = refine_clips(clips, sequences, motion, threads)
    single = np.isnan(refined.noise)[:, None, None]
    grow = (
        bar_scale / lifting.scale[:, None]
    )  # (n, p), of what is in the unit of the landmarks
    rows = nearest_informative(is_informative(clips), split(sequences), clips.position)
    images = (image_sd[rows], image_mixed[rows].swapaxes(1, 2).astype(np.float64))
    smoothed = (refined.deviation * grow[:, None], refined.correlation)
    constant = refined.noise[:, None] * grow
    bars, correlation = add_common_error(smoothed, images, constant)
    mixed = correlation.swapaxes(1, 2).astype(np.float32)
    covariance = refined.covariance  # written over, as these take most of the memory
    factor, axes = np.tile(grow, 3), range(covariance.shape[1])
    covariance *= factor[:, :, None]
    covariance *= factor[:, None]
    for t in range(len(covariance)):
        covariance[t] += CONSTANTS.shared**2 * of_images[rows[t]]
    covariance[:, axes, axes] += np.tile(constant, 3) ** 2
    covariance[single[:, 0, 0]] = of_images[single[:, 0, 0]]
    stopped = ~refined.converged
    status = estimate.status
    if stopped.any():
        limit = Status.ITERATION_LIMIT
        status = tuple(
            limit if s else old for s, old in zip(stopped, status, strict=True)
        )
    return replace(
        lifting,
        shapes=refined.points,
        landmarks_fitted=refined.points[:, :2].copy(),
        estimate=replace(
            estimate,
            status=status,
            deviation=np.where(single, image_sd, bars),
            covariance=covariance,
            posterior_modes=None,
            further={
                **estimate.further,
                CORRELATION: np.where(single, image_mixed, mixed),
                NOISE: refined.noise,
                IMAGE_ERROR: (
                    lifting.scale * expected_error(lifting.shapes, of_images, shown)
                ),
            },
        ),
    )


def refine_clips(
    clips: Clips,
    sequences: Sequence[str],
    motion: Motion,
    threads: int = 0,
) -> Refined:
    """Points (n, 3, p), their deviations and correlations, and the noise (n,) of their
    sequence.

    All but correlations in the unit of the landmarks. nan in all but the points where
    the inference is that of the images: they are alone or nearly so in their sequence,
    or contradict it. Sequences are refined on `threads` threads, 0 means one per core;
    the results do not depend on them.
    """
    unknown = np.full_like(clips.points, np.nan)
    noise = np.full(len(clips.points), np.nan)
    d, converged = 3 * clips.points.shape[2], np.ones(len(noise), bool)
    covariance = np.full((len(noise), d, d), np.nan)
    refined = Refined(
        clips.points.copy(), unknown, unknown.copy(), noise, covariance, converged
    )
    finite: Flags = np.asarray(np.isfinite(clips.points).all(axis=(1, 2)))
    informative = is_informative(clips)
    clips = replace(
        clips,
        scale=np.where(informative, clips.scale, np.nan),
        points=np.where(informative[:, None, None], clips.points, np.nan),
    )
    there = np.concatenate([[0], np.cumsum(informative)])
    long = [
        clip
        for clip in split(sequences)
        if there[clip.stop] - there[clip.start] >= FEWEST
    ]

    def refine(clip: slice) -> None:
        refine_clip(clips, clip, informative[clip], finite[clip], motion, refined)

    on_threads(refine, long, threads)
    return refined


def is_informative(clips: Clips) -> Flags:
    """Which images (n,) have a posterior that is not wider than `CONSTANTS.widest`."""
    finite = np.isfinite(clips.points).all(axis=(1, 2))
    width = np.sqrt((clips.deviation**2).mean(axis=(1, 2)))
    informative: Flags = finite & (width < CONSTANTS.widest * clips.scale)
    return informative


def split(sequences: Sequence[str]) -> list[slice]:
    """Slices of equal neighbours in `sequences` (n,), in pieces of at most
    `LONGEST`.
    """
    values = np.array(sequences, dtype=object)
    ends = [0, *(np.flatnonzero(values[1:] != values[:-1]) + 1).tolist(), len(values)]
    slices = []
    for start, stop in pairwise(ends):
        pieces = -(-(stop - start) // LONGEST)
        cuts = (
            [start + (stop - start) * k // pieces for k in range(pieces + 1)]
            if pieces
            else []
        )
        slices += [slice(a, b) for a, b in pairwise(cuts)]
    return slices


def refine_clip(
    clips: Clips,
    clip: slice,
    there: Flags,
    finite: Flags,
    motion: Motion,
    refined: Refined,
) -> None:
    """Refine one sequence from the images that are `there` (t,); write down the finite
    ones.
    """
    timeline = Timeline(clips.position[clip], motion.rate)
    stretches = timeline.stretches
    finite = finite.copy()
    for stretch in stretches:  # where all frames are blind nothing places them
        finite[stretch] &= there[stretch].any()
    # Before the covariances of the modes are written over.
    of_images, deviation = moments_of_modes(clips, clip)
    size = median(clips.scale[clip][there])
    sigma = float(np.sqrt(clips.residual_variance))
    if clips.noise is not None:
        sigma = min(max(clips.noise / size, CONSTANTS.least_noise), sigma)
    frames = int(there.sum()) * sigma**2 / clips.residual_variance
    usual = weigh_lengths(motion.usual, frames)

    def infer(
        visible: Observations, taken: Timeline = timeline, *, rigid: bool = True
    ) -> Smoothed:
        lag = max(1, round(CONSTANTS.memory * motion.rate))
        places = taken.on_grid(3 * lag)
        scale = find_acceleration_scale(visible, motion.acceleration, lag, places)
        stiffness = (motion.acceleration * scale) ** -2
        bones, tolerance = motion.bones, motion.bone_tolerance
        model = Model(bones, stiffness, tolerance, usual, taken)
        if not rigid:
            model = Model(bones[:0], stiffness, tolerance[:0], timeline=taken)
        return smooth(visible, model, sigma)

    def size_in(stretch: slice) -> float:
        """The sum of the lengths in a stretch alone; nan where it is too short."""
        if there[stretch].sum() < FEWEST or not len(motion.bones):
            return np.nan
        taken = Timeline(timeline.position[stretch], timeline.rate)
        return float(infer(visible.part(stretch), taken).lengths.sum())

    def rows_in(stretch: slice) -> NDArray[np.intp]:
        """The finite frames of a stretch, by their rows in the sequence."""
        rows: NDArray[np.intp] = stretch.start + np.flatnonzero(finite[stretch])
        return rows

    def store(smoothed: Smoothed, unit: Floats, stretch: slice) -> None:
        """Write a stretch down in the unit (t,) of the landmarks."""
        t = rows_in(stretch)
        rows = clip.start + t
        u = unit[t][:, None, None]
        refined.converged[rows] = smoothed.converged
        refined.points[rows] = u * smoothed.points[t]
        refined.deviation[rows] = u * smoothed.deviation[t]
        refined.correlation[rows] = smoothed.correlation[t]
        refined.noise[rows] = size * sigma
        for row in t:
            refined.covariance[clip.start + row] = (
                unit[row] ** 2 * smoothed.covariance[row]
            )

    def energies_of(smoothed: Smoothed) -> list[float]:
        """The energy of each stretch, but for that of lengths if there are several."""
        if len(stretches) == 1:
            return [smoothed.energy]
        return [float(smoothed.energies[stretch].sum()) for stretch in stretches]

    scale = (clips.scale * clips.modes.scale[:, 0])[clip]
    growth = find_growth(scale, there, CONSTANTS.scale_time * motion.rate, timeline)
    visible = in_unit(clips, clip, size)
    steady = np.ones(len(there))
    if len(stretches) > 1:  # how far away it is after a gap, only its images say
        for stretch in stretches:
            steady[stretch] = np.exp(np.log(growth[stretch]).mean())
        visible = visible.grown(steady)
        sizes = np.array([size_in(stretch) for stretch in stretches])
        larger = np.repeat(
            np.nan_to_num(sizes / finite_median(sizes, 1.0), nan=1.0),
            [stretch.stop - stretch.start for stretch in stretches],
        )
        visible = visible.grown(larger)
        steady, growth = steady * larger, growth * larger
    smoothed = infer(visible)
    store(smoothed, size * steady, slice(0, len(there)))
    energies = energies_of(smoothed)
    del smoothed  # covariances take most of the memory
    visible = visible.grown(growth / steady)
    smoothed = infer(visible)
    for stretch, before, after in zip(
        stretches, energies, energies_of(smoothed), strict=True
    ):
        if after < before:
            store(smoothed, size * growth, stretch)
    del smoothed
    moved = refined.points[clip] - of_images
    square = ((moved / deviation) ** 2).mean(axis=(1, 2))
    loose = [
        stretch
        for stretch in stretches
        if median(square[judged_by(stretch, there)]) > CONSTANTS.farthest
    ]
    points = clips.points[clip]
    if loose and not motion.of_half_body:
        without_bones = infer(visible, rigid=False).points
        points = (size * growth)[:, None, None] * without_bones
    for stretch in loose:
        t = rows_in(stretch)
        rows = clip.start + t
        refined.points[rows] = points[t]
        refined.converged[rows] = True
        refined.noise[rows] = np.nan


def judged_by(stretch: slice, there: Flags) -> NDArray[np.intp]:
    """The frames that are `there` (t,) by which a stretch is found to be moved too far:
    its own, or those of the sequence where these are fewer than `FEWEST`.
    """
    own = stretch.start + np.flatnonzero(there[stretch])
    return own if len(own) >= FEWEST else np.flatnonzero(there)


def find_growth(
    scale: Floats, there: Flags, width: float, timeline: Timeline
) -> Floats:
    """Smoothed scales (t,) of the images that are `there` (t,), beside their geometric
    mean: those of each stretch by itself. A stretch where none is lies between others.
    """
    level = np.full(len(scale), np.nan)
    places = timeline.on_grid()
    for stretch in timeline.stretches:
        if there[stretch].any():
            place = places[stretch] - places[stretch.start]
            level[stretch] = smooth_scale(scale[stretch], there[stretch], width, place)
    known = np.isfinite(level)
    between = np.interp(timeline.position, timeline.position[known], level[known])
    level = np.where(known, level, between)
    growth: Floats = np.exp(level - level[there].mean())
    return growth


def smooth_scale(
    scale: Floats, there: Flags, width: float, place: NDArray[np.integer]
) -> Floats:
    """Logarithms (t,) of the scales of images that are `there`, smoothed.

    By lines through them within a Gaussian window of so many frames about each (local
    linear regression); place (t,) of the images among the frames, from 0.
    """
    rows = place[there]
    level = np.interp(np.arange(place[-1] + 1), rows, np.log(scale[there]))
    if len(level) == 1:
        return level
    weight = np.full(len(level), GAP)
    weight[rows] = 1.0
    reach = min(int(4 * width) + 1, len(level) - 1)
    k = np.arange(-reach, reach + 1)
    window = np.exp(-0.5 * (k / width) ** 2)

    def total(x: Floats, power: int) -> Floats:
        return np.convolve(x, window * (-k) ** power)[reach : len(x) + reach]

    S0, S1, S2 = (total(weight, power) for power in range(3))
    T0, T1 = (total(weight * level, power) for power in range(2))
    line: Floats = (S2 * T0 - S1 * T1) / (S0 * S2 - S1**2)
    smooth: Floats = line[place]
    return smooth


def weigh_lengths(usual: Lengths | None, frames: float) -> Lengths | None:
    """Return the usual lengths with the precision (1 + r^2 t) Q, for t frames.

    What t images say of the lengths has the variance P (1 / t + r^2), as their
    deviations have the share r in common; the objective takes it for P / t. So images
    would count (1 + r^2 t) times too much beside Q: their errors do not average out,
    however many they are. Frames whose landmarks are stated to be exacter count for the
    share sigma^2 / v of their variance that is left.
    """
    if usual is None:
        return None
    return usual._replace(
        precision=(1 + CONSTANTS.shared**2 * frames) * usual.precision
    )


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


def in_unit(clips: Clips, clip: slice, unit: float) -> Observations:
    """What the images of a clip say, in the given unit."""
    finite = np.isfinite(clips.scale[clip])
    grow = np.where(finite, clips.scale[clip], unit) / unit
    centre = np.where(finite[:, None], clips.centre[clip], 0.0) / unit
    means = clips.modes.mean[clip] * grow[:, None, None, None]
    means[:, :, :2] += centre[:, None, :, None]
    return observe(
        landmarks=clips.landmarks[clip] / unit,
        trust=clips.trust[clip],
        start=clips.points[clip] / unit,
        log_evidence=np.where(finite[:, None], clips.modes.log_evidence[clip], -np.inf),
        means=means,
        covariances=clips.modes.covariance[clip],
        residual_variance=clips.residual_variance,
        grow=grow,
        position=clips.position[clip],
    )


def find_acceleration_scale(
    visible: Observations,
    acceleration: Floats,
    lag: int,
    place: NDArray[np.integer] | None = None,
) -> float:
    """Return how much faster than expected the landmarks move in their images: 1 or
    more.

    Second differences s_t = w_(t+L) - 2 w_t + w_(t-L) over a lag of L frames. Those of
    a smooth motion resemble their neighbours, with a correlation of 0.7; of white noise
    their variance is 6 and the covariance of neighbours -4 times that of the noise. So
    for the variances P and N of the sum and the difference of neighbours

        2.5 P - 0.5 N = 8.2 times the mean square of the motion's.

    By medians, which the jumps of a detector do not move, and over a lag beyond which
    its errors are no motion either. A mean square grows with L^3. place (t,) of the
    images among the frames, one after the other without it.
    """
    w = np.where(visible.trust[:, None] > 0, visible.landmarks, np.nan)
    if place is not None:
        seen, w = w, np.full((place[-1] + 1, *w.shape[1:]), np.nan)
        w[place] = seen
    if len(w) <= 3 * lag:
        return 1.0
    second = w[2 * lag :] - 2 * w[lag:-lag] + w[: -2 * lag]
    P, N = (median_variance(second[lag:] + sign * second[:-lag]) for sign in (1, -1))
    moving = np.maximum(2.5 * P - 0.5 * N, 0.0) / 8.2 / lag**3
    finite = np.isfinite(moving)
    expected = (acceleration[finite] ** 2).sum()
    return (
        float(np.sqrt(max(moving[finite].sum() / expected, 1.0)))
        if finite.any()
        else 1.0
    )


def median_variance(values: Floats) -> Floats:
    """Variance (p,) of values (t, 2, p) about 0 by the median of their sizes; nan:
    nothing known.

    The median of |x| of a Gaussian is 0.6745 standard deviations.
    """
    sizes = np.sort(np.abs(values.reshape(-1, values.shape[2])), axis=0)  # nan is last
    count = np.isfinite(sizes).sum(axis=0)
    columns = np.arange(sizes.shape[1])
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(sizes) - 1)
    middle = (sizes[low, columns] + sizes[high, columns]) / 2
    return np.where(count > 0, (middle / 0.6745) ** 2, np.nan)


def add_common_error(
    smoothed: tuple[Floats, Floats], images: tuple[Floats, Floats], constant: Floats
) -> tuple[Floats, Floats]:
    """Deviations and correlations of C, from those of S and P, all (n, 3, p), and sigma
    (n, p).

    Correlations of x with y, x with z, and y with z of each landmark. A correlation of
    a landmark that has no deviation is 0.
    """
    (single, mixed), (image, image_mixed), share = smoothed, images, CONSTANTS.shared
    deviation = np.hypot(np.hypot(single, share * image), constant[:, None])
    correlation = np.empty_like(deviation)
    for row, (a, b) in enumerate(PAIRS):
        covariance = mixed[:, row] * single[:, a] * single[:, b]
        covariance = (
            covariance + share**2 * image_mixed[:, row] * image[:, a] * image[:, b]
        )
        product = deviation[:, a] * deviation[:, b]
        correlation[:, row] = covariance / np.where(product == 0, 1.0, product)
    return deviation, correlation


def nearest_informative(
    informative: Flags, clips: Iterable[slice], position: Floats
) -> NDArray[np.intp]:
    """Row (n,) of the nearest informative frame of the same clip, its own where none
    is; position (n,) in time.

    An image that says nothing has a covariance that says nothing of the errors of its
    frame.
    """
    rows = np.arange(len(informative))
    for clip in clips:
        there, lacking = (
            np.flatnonzero(informative[clip]),
            np.flatnonzero(~informative[clip]),
        )
        if len(there) and len(lacking):
            place = position[clip]
            nearest = np.abs(place[lacking][:, None] - place[there]).argmin(axis=1)
            rows[clip.start + lacking] = clip.start + there[nearest]
    return rows
