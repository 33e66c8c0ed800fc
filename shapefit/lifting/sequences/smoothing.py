"""The shapes of a whole sequence at once: by its images, rigid bones, smooth motion.

The landmarks y_t (3, p) of the frames, in the frame of the camera, and the lengths l of
the bones minimise

    sum_t  -log p(y_t | image t)
         + 1/2 sum_(t,j) q_tj (1/sigma^2 - 1/v) ||w_tj - y_tj||^2
         + 1/2 sum_(t,j) ||c_t1 y_(t-1)j + c_t2 y_tj + c_t3 y_(t+1)j||^2 / a_j^2
         + 1/2 sum_(t, bones ij) (||y_ti - y_tj|| - l_ij)^2 / b^2.

The first term is the mixture of the modes of an image, whose posteriors took the
landmarks with the variance v of what the prior cannot place. Where their noise sigma is
stated to be smaller the second term makes up for it. c are (1, -2, 1) where no frame
lacks, see `Timeline.second_differences`. Bones are rigid but unknown; where their
lengths k are known up to the scale g of the images, with the precision Q of their
logarithms, 1/2 d^T Q d joins the objective, d = l / (g k) - 1. Levenberg and
Marquardt's method over frames and lengths together: the lengths are few, and are
eliminated from the banded system of the frames. No step raises the objective; the
minimum is a local one, near the start.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats, Integers
from shapefit.timeline import Timeline


@dataclass(frozen=True)
class Constants:
    """The numbers of the model of sequences, in one place; none is a key."""

    modes: int = 4
    """Of a frame that count; the others have next to no share."""

    max_deviation: float = 3.0
    """Standard deviation of a coordinate, in the size of the landmarks, beyond which an
    image says nothing.

    Its posterior then has next to no scale. Frames whose image says nothing have it:
    the others place them.
    """

    min_noise: float = 0.003
    """Deviation of a coordinate, in the size of the landmarks, as which a smaller one
    counts.

    Exact landmarks have rounding and a prior beside them. Of the levels 0.003, 0.01,
    0.03 and 0.06 the best on exact clips of subject 86. Its square is added to the
    covariances, which know no mean depth: it stays where it is.
    """

    max_displacement: float = 0.5
    """Median over the images of the mean square of what a sequence may move them, in
    their deviations.

    Beyond it bones are not rigid or the prior is too narrow, and they are left out. On
    film of bodies 01, 02 and 64 (97 clips, some with jumps or bones that stretch) 0.4
    to 0.5 loses more than 10% in 1 to 2 clips, 0.6 and no limit in 2, and no limit has
    1.4% less error; on 03 and 118 no limit loses in 3 of 40, and has 1% more.
    """

    scale_seconds: float = 0.5
    """Seconds over which the scale of a body in its images is smoothed.

    On film of bodies 01, 02 and 64 (79 clips, no limit) sequences have 0.824 of the
    error of images by 0.5, 0.825 by 0.35, 0.823 by 1, and 0.840 in one unit alone.
    """

    common_share: float = 0.4
    """r, the share of the deviations of single images that neighbouring frames have in
    common: in error bars, and in what images say of lengths.

    On film of six bodies 90% regions hold 0.91 to 0.97 in each of twelve cells; 0.5
    holds more than 0.97 in four, 0.3 less than 0.90 in three. Errors are the same.
    """

    correlation_seconds: float = 1 / 8
    """Seconds after which what a detector gets wrong has hardly anything to do with
    what it got wrong before: that of second differences, see `find_acceleration_scale`.
    """

    exchange_price: float = 8.0
    """Log likelihood that an exchange of left and right costs, see `exchanges`.

    At 8 no clean clip of 336 of film has one, and where 8 of 60 frames are exchanged or
    bursts of 8, 2 to 3 of 1,000 frames stay wrong.
    """


CONSTANTS = Constants()

MAX_SMOOTHING_ROUNDS = 100
"""Of Levenberg and Marquardt's method: on film 90% of the clips end within 15 rounds
and all within 20.
"""

MIN_FRAME_GAIN = 0.03
"""Gain of the objective for each frame with which rounds go on; what a smaller one adds
changes no error by more than 0.1%.
"""


class Lengths(NamedTuple):
    """What is known of the lengths of bones beforehand, but for the size of the body.

    usual k (e,), in any unit, nan where a bone's is unknown; precision Q (e, e) of the
    logarithms, 0 there.
    """

    usual: Floats
    precision: Floats


@dataclass(frozen=True, eq=False)
class SequenceModel:
    """How frames of a sequence hang together, in units of the size of its landmarks.

    bones (e, 2); stiffness 1/a^2 (p,); bone_tolerance b (e,), the deviation of a bone
    from its length; usual, the usual lengths; timeline, when the frames were taken: one
    after the other without it.
    """

    bones: Integers
    stiffness: Floats
    bone_tolerance: Floats
    usual: Lengths | None = None
    timeline: Timeline | None = None


@dataclass(frozen=True, eq=False)
class Observations:
    """What single images say of the frames of one sequence.

    In units of the size of its landmarks. A frame has some modes, as the posterior of
    its image gives them: Gaussians over the landmarks in the frame of the camera, with
    shares. Their energy is -log sum_k share_k N(y_t; m_tk, C_tk).

    landmarks w (t, 2, p) as observed, nan where hidden; trust q (t, p), the inlier
    probability, 0 where it is hidden; start (t, 3, p), the mean of each image;
    residual_variance, that with which the posteriors took the landmarks; log_share (t,
    k), mean (t, k, 3p), precision (t, k, 3p, 3p) and log_det (t, k) of the modes,
    log_share -inf where a frame has fewer. growth g (t,), the unit of each frame in
    that of its precision, which most of the memory is for: in the unit of all else it
    is g^2 precision.
    """

    landmarks: Floats
    trust: Floats
    start: Floats
    residual_variance: float
    log_share: Floats
    mean: Floats
    precision: Floats
    log_det: Floats
    growth: Floats

    def __len__(self) -> int:
        return len(self.start)

    def part(self, rows: slice) -> Observations:
        """Return the observations of the frames `rows`."""
        return replace(
            self,
            landmarks=self.landmarks[rows],
            trust=self.trust[rows],
            start=self.start[rows],
            log_share=self.log_share[rows],
            mean=self.mean[rows],
            precision=self.precision[rows],
            log_det=self.log_det[rows],
            growth=self.growth[rows],
        )

    def in_larger_unit(self, factor: Floats) -> Observations:
        """Return the observations with lengths divided by a factor (t,), per frame."""
        g = factor[:, None, None]
        d = self.mean.shape[2]
        return replace(
            self,
            landmarks=self.landmarks / g,
            start=self.start / g,
            mean=self.mean / g,
            log_det=self.log_det - 2 * d * np.log(factor)[:, None],
            growth=self.growth * factor,
        )


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The inferred frames of a sequence: the minimum of the objective.

    points (t, 3, p) and lengths (e,); the energy there, and energies (t,) of frames
    with the second differences that begin there. deviation (t, 3, p) of the points, the
    lengths held, and the correlation (t, 3, p) of x with y, x with z, and y with z of
    each landmark; covariance (t, 3p, 3p) of the frames, all x first, then y, then z.
    converged, whether the rounds ended before their limit.
    """

    points: Floats
    lengths: Floats
    energy: float
    energies: Floats
    converged: bool
    deviation: Floats
    correlation: Floats
    covariance: Floats


def smooth(
    visible: Observations,
    model: SequenceModel,
    noise: float,
    max_rounds: int = MAX_SMOOTHING_ROUNDS,
) -> Smoothed:
    """Infer the shapes of all frames of a sequence by minimising the objective.

    noise: sigma, the standard deviation of a coordinate of the landmarks.
    """
    t, _, p = visible.start.shape
    points = visible.start.reshape(t, 3 * p).copy()
    lengths = mean_lengths(visible.start, model.bones)
    length_precision, usual_lengths = length_penalty(model, lengths)
    timeline = model.timeline or Timeline.of_frames(t)
    end = np.empty(2)
    energies = np.zeros(t)
    deviation, correlation = np.empty((2, t, 3 * p))
    covariance = np.empty((t, 3 * p, 3 * p))
    core.smooth_sequence(
        landmarks=np.nan_to_num(visible.landmarks).reshape(t, 2 * p),
        weight=remaining_precision(visible, noise),
        log_share=visible.log_share,
        means=visible.mean,
        precisions=visible.precision,
        growth=visible.growth,
        log_det=visible.log_det,
        stiffness=model.stiffness,
        differences=timeline.second_differences(),
        bones=np.ascontiguousarray(model.bones, np.int64).reshape(-1, 2),
        rigidity=model.bone_tolerance**-2.0,
        length_precision=length_precision,
        usual_lengths=usual_lengths,
        max_rounds=max_rounds,
        tolerance=MIN_FRAME_GAIN,
        points=points,
        lengths=lengths,
        deviation=deviation,
        correlation=correlation,
        covariance=covariance,
        energies=energies,
        end=end,
    )
    return Smoothed(
        points=points.reshape(t, 3, p),
        lengths=lengths,
        energy=float(end[0]),
        energies=energies,
        converged=end[1] < max_rounds,
        deviation=deviation.reshape(t, 3, p),
        correlation=correlation.reshape(t, 3, p),
        covariance=covariance,
    )


def remaining_precision(visible: Observations, noise: float) -> Floats:
    """Return the precisions (t, 2p) of landmarks that the images' posteriors left out.

    q (1/sigma^2 - 1/v). The posterior of an image took its landmarks with the variance
    v; where their noise sigma is smaller, this is the precision still to be added.
    noise is sigma; 0 where it is above sqrt(v).
    """
    remaining = max(1 / noise**2 - 1 / visible.residual_variance, 0.0)
    precision: Floats = remaining * np.tile(visible.trust, (1, 2))
    return precision


def length_penalty(model: SequenceModel, lengths: Floats) -> tuple[Floats, Floats]:
    """Return H (e, e) and g k (e,) of the penalty 1/2 (l - g k)^T H (l - g k).

    H = Q / (g k)(g k)^T, with k the usual lengths and g the scale at which these agree
    with `lengths` (e,). Both are 0 for bones without a usual length.
    """
    e = len(model.bones)
    scaled, inverse = np.zeros((2, e))
    if model.usual is None:
        return np.zeros((e, e)), scaled
    usual = model.usual.usual
    known = np.isfinite(usual)
    scaled[known] = usual[known] * fit_scale(lengths, usual)
    inverse[known] = 1 / scaled[known]
    return model.usual.precision * np.outer(inverse, inverse), scaled


def mean_lengths(points: Floats, bones: Integers) -> Floats:
    """Return the mean lengths (e,) of the bones (e, 2) of points (t, 3, p)."""
    i, j = bones.T
    lengths = np.linalg.norm(points[:, :, i] - points[:, :, j], axis=1)
    return np.asarray(lengths.mean(axis=0))


def fit_scale(lengths: Floats, usual: Floats) -> float:
    """Return the scale at which usual lengths (e,) agree best with `lengths` (e,).

    The geometric mean of the ratios. Usual lengths that are nan do not count; one must
    be known.
    """
    known = np.isfinite(usual)
    ratios = lengths[known] / usual[known]
    return float(np.exp(np.log(ratios).mean()))


def observe(
    landmarks: Floats,
    trust: Floats,
    start: Floats,
    log_evidence: Floats,
    means: Floats,
    covariances: Floats,
    residual_variance: float,
    covariance_unit: Floats | float = 1.0,
    position: Floats | None = None,
) -> Observations:
    """Return the posteriors of the images of t frames as observations of a sequence.

    landmarks (t, 2, p), trust (t, p), start (t, 3, p) and residual_variance as in
    `Observations`. The posteriors are mixtures of Gaussians: log_evidence (t, k) of
    their modes, -inf where a frame has fewer; means (t, k, 3, p); covariances (t, k,
    3p, 3p), which are overwritten. All are in one unit, but for the covariances, whose
    unit is `covariance_unit` (t,) times that. A frame without modes starts between its
    neighbours by their position (t,) in time, one after the other without it. Raises
    ValueError where no frame has any.
    """
    t, modes = log_evidence.shape
    k = min(CONSTANTS.modes, modes)
    d = 3 * landmarks.shape[2]
    has_mode = np.isfinite(log_evidence[:, :k])
    has_modes = has_mode[:, 0]
    start = fill_missing_frames(start, has_modes, position)
    best = np.where(has_modes, log_evidence[:, 0], 0.0)[:, None]
    log_share = np.where(has_mode, log_evidence[:, :k], -np.inf) - best
    # a frame without modes has one that says next to nothing
    log_share[~has_modes, 0] = 0.0
    wanted = has_mode.copy()
    wanted[~has_modes, 0] = True
    mean = np.where(
        has_mode[..., None], means[:, :k].reshape(t, k, d), start.reshape(t, 1, d)
    )
    precision, log_det = find_precisions(
        np.ascontiguousarray(covariances[:, :k]),
        factor=np.where(has_mode, np.reshape(covariance_unit, (-1, 1)) ** 2, 0.0),
        ridge=np.where(has_mode, CONSTANTS.min_noise, CONSTANTS.max_deviation) ** 2,
        wanted=wanted,
    )
    is_seen = np.isfinite(landmarks).all(axis=1) & has_modes[:, None]
    return Observations(
        landmarks=landmarks,
        trust=np.where(is_seen, np.nan_to_num(trust), 0.0),
        start=start,
        residual_variance=residual_variance,
        log_share=log_share,
        mean=mean,
        precision=precision,
        log_det=log_det,
        growth=np.ones(t),
    )


def find_precisions(
    covariances: Floats, factor: Floats, ridge: Floats, wanted: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Return (factor C + ridge I)^-1 (t, k, d, d), and log det (factor C + ridge I).

    covariances C (t, k, d, d); factor and ridge (t, k); a factor of 0 takes C for 0.
    Only those that are `wanted` (t, k) are inverted, and written over C: of long
    sequences these take most of the memory.
    """
    log_det = np.zeros(wanted.shape)
    core.find_precisions(
        matrices=covariances,
        factor=factor,
        ridge=ridge,
        wanted=wanted,
        log_det=log_det,
        threads=1,
    )
    return covariances, log_det


def fill_missing_frames(
    points: Floats, present: NDArray[np.bool_], position: Floats | None = None
) -> Floats:
    """Interpolate missing frames of points (t, 3, p) between their neighbours in time.

    Frames have positions (t,), or come one after the other. Raises ValueError where no
    frame is present.
    """
    if present.all():
        return points
    if not present.any():
        raise ValueError("no frame is present")
    frames = np.arange(len(points)) if position is None else position
    flat = points[present].reshape(int(present.sum()), -1)
    filled = [np.interp(frames, frames[present], column) for column in flat.T]
    return np.stack(filled, axis=1).reshape(points.shape)
