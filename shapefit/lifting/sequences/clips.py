"""The sequences of a fit: which frames belong together, and their shapes refined as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, median
from shapefit.core.stretches import on_threads
from shapefit.lifting.posterior.posterior import Modes
from shapefit.lifting.sequences.noise import LEAST_TURN, find_haste, find_noise, find_turn
from shapefit.lifting.sequences.observations import Observations, observe
from shapefit.lifting.sequences.smoothing import Lengths, Model, smooth
from shapefit.lifting.sequences.steady import steady

Indices = NDArray[np.integer]

FEWEST = 3
"""Frames of a sequence: fewer have no acceleration, and stay what their images say."""

FARTHEST = 0.6
"""Median over the images of the mean square of what a sequence moves them, in their deviations.

Where images and sequence agree it is below 0.5 on subject 86, whatever the noise; where it is
larger, bones are not rigid, landmarks are grossly wrong, or the prior is too sure.
"""

NEAR = 0.3
"""The same where bones hardly turn (`LEAST_TURN`) and no length was measured: lengths then fit what
the images have wrong alike. Of footage of six bodies, whole or down to the hips, clips below it end
with 0.89 of the error of their images, and clips between it and `FARTHEST` with 0.99."""

STILL = 0.15
"""Turn (`find_turn`) below which such a sequence is only steadied: the noise of detectors alone
looks like as much."""

WIDEST = 3.0
"""Standard deviation of a coordinate, in the size of the landmarks, beyond which an image says
nothing: its posterior then has next to no scale. The frames beside it place it."""

MOST = 4096
"""Frames that are refined together; longer sequences are cut into parts of about one length."""


@dataclass(frozen=True)
class Motion:
    """How bodies move and are built, in units of the size of their landmarks.

    bones (e, 2) keep their lengths but for deviations of give (e,); acceleration (p,), the root of
    the mean square of the second difference of a coordinate from frame to frame; known, what is
    known of the lengths.
    """

    bones: Indices
    acceleration: Floats
    give: Floats
    known: Lengths | None = None

    @property
    def measured(self) -> bool:
        """Whether lengths were measured on the body itself."""
        return self.known is not None and self.known.measured


class Refined(NamedTuple):
    """Points, deviations, correlations (n, 3, p) and noise (n,): each sequence writes its own.

    covariance (n, 3p, 3p) of all landmarks of an image, None where it was not asked for.
    """

    points: Floats
    deviation: Floats
    correlation: Floats
    noise: Floats
    covariance: Floats | None


@dataclass(frozen=True)
class Clips:
    """n images, sequence after sequence, in the unit of the landmarks.

    landmarks (n, 2, p); trust (n, p), the belief that a landmark is where it was observed times
    the square of its confidence; points (n, 3, p), the posterior means, nan where there is none;
    scale and centre (n,), (n, 2): a normalised point x is scale x + centre; modes, normalised;
    misfit, the variance of normalised landmarks in the posteriors; deviation (n, 3, p) of points.
    """

    landmarks: Floats
    trust: Floats
    points: Floats
    scale: Floats
    centre: Floats
    modes: Modes
    misfit: float
    deviation: Floats


def refine_clips(
    clips: Clips,
    sequences: Sequence[str],
    motion: Motion,
    threads: int = 0,
    covariances: bool = False,
) -> Refined:
    """Points (n, 3, p), their deviations and correlations, and the noise (n,) of their sequence.

    All but correlations in the unit of the landmarks. nan in all but the points where the inference
    is that of the images: one is alone or nearly so in its sequence, or its bones stand
    still (`STILL`) and no length was measured, or the sequence contradicts the images (`FARTHEST`,
    `NEAR`). Then the points are but steadied. Sequences are refined on `threads` threads, 0 means
    one per core; the results do not depend on them.
    """
    unknown = np.full_like(clips.points, np.nan)
    noise = np.full(len(clips.points), np.nan)
    d = unknown[0].size if covariances else 0
    whole = np.full((len(noise), d, d), np.nan) if covariances else None
    found = Refined(clips.points.copy(), unknown, unknown.copy(), noise, whole)
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(clips.points).all(axis=(1, 2)))
    known = says_something(clips)
    clips = replace(
        clips,
        scale=np.where(known, clips.scale, np.nan),
        points=np.where(known[:, None, None], clips.points, np.nan),
    )
    fewest = 1 if motion.measured else FEWEST
    there = np.concatenate([[0], np.cumsum(known)])
    long = [clip for clip in parts(sequences) if there[clip.stop] - there[clip.start] >= fewest]

    def refine(clip: slice) -> None:
        refine_clip(clips, clip, known[clip], finite[clip], motion, found)

    on_threads(long, refine, threads)
    return found


def says_something(clips: Clips) -> NDArray[np.bool_]:
    """Which images (n,) have a posterior that is not wider than `WIDEST`."""
    finite = np.isfinite(clips.points).all(axis=(1, 2))
    width = np.sqrt((clips.deviation**2).mean(axis=(1, 2)))
    known: NDArray[np.bool_] = finite & (width < WIDEST * clips.scale)
    return known


def refine_clip(
    clips: Clips,
    clip: slice,
    there: NDArray[np.bool_],
    finite: NDArray[np.bool_],
    motion: Motion,
    found: Refined,
) -> None:
    """Refine one sequence from the images that are `there` (t,); write down the finite ones."""
    unit = median(clips.scale[clip][there])
    seen = in_unit(clips, clip, unit)
    acceleration = motion.acceleration * find_haste(seen, motion.acceleration)
    rows = np.arange(clip.start, clip.stop)[finite]
    sd = clips.deviation[clip][there] / unit
    model = Model(motion.bones, acceleration**-2, motion.give, motion.known)
    spread = np.full_like(seen.start, np.inf)
    spread[there] = sd

    def steady_images() -> None:
        found.points[rows] = unit * steady(seen.start, spread, acceleration)[finite]

    known = motion.measured or not len(motion.bones)
    turn = np.inf if known else find_turn(seen, model)
    if turn < STILL:
        steady_images()
        return
    sigma = find_noise(seen, model)
    wanted = found.covariance is not None
    smoothed = smooth(seen, model, sigma, deviations=True, covariances=wanted)
    assert smoothed.deviation is not None
    assert smoothed.correlation is not None
    away = (smoothed.points[there] - seen.start[there]) / sd
    if median((away**2).mean(axis=(1, 2))) > (NEAR if turn < LEAST_TURN else FARTHEST):
        steady_images()
        return
    found.points[rows] = unit * smoothed.points[finite]
    found.deviation[rows] = unit * smoothed.deviation[finite]
    found.correlation[rows] = smoothed.correlation[finite]
    found.noise[rows] = unit * sigma
    if found.covariance is not None:
        assert smoothed.covariance is not None
        found.covariance[rows] = unit**2 * smoothed.covariance[finite]


def in_unit(clips: Clips, clip: slice, unit: float) -> Observations:
    """What the images of a clip say, in the given unit."""
    known = np.isfinite(clips.scale[clip])
    grow = np.where(known, clips.scale[clip], unit) / unit
    centre = np.where(known[:, None], clips.centre[clip], 0.0) / unit
    means = clips.modes.mean[clip] * grow[:, None, None, None]
    means[:, :, :2] += centre[:, None, :, None]
    return observe(
        landmarks=clips.landmarks[clip] / unit,
        trust=clips.trust[clip],
        start=clips.points[clip] / unit,
        log_evidence=np.where(known[:, None], clips.modes.log_evidence[clip], -np.inf),
        means=means,
        covariances=clips.modes.covariance[clip],
        misfit=clips.misfit,
        grow=grow,
    )


def parts(sequences: Sequence[str]) -> list[slice]:
    """Slices of equal neighbours in `sequences` (n,), in pieces of at most `MOST`."""
    values = np.array(sequences, dtype=object)
    ends = [0, *(np.flatnonzero(values[1:] != values[:-1]) + 1).tolist(), len(values)]
    found = []
    for start, stop in pairwise(ends):
        pieces = -(-(stop - start) // MOST)
        cuts = [start + (stop - start) * k // pieces for k in range(pieces + 1)] if pieces else []
        found += [slice(a, b) for a, b in pairwise(cuts)]
    return found
