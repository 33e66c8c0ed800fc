"""The sequences of a fit: which frames belong together, and their shapes refined as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from shapefit.lifting.posterior.posterior import Modes
from shapefit.lifting.sequences.noise import find_haste, find_noise
from shapefit.lifting.sequences.observations import Observations, observe
from shapefit.lifting.sequences.smoothing import Model, smooth
from shapefit.lifting.sequences.steady import steady
from shapefit.lifting.sequences.uncertainty import deviations

Floats = NDArray[np.float64]
Indices = NDArray[np.integer]

FEWEST = 3
"""Frames of a sequence: fewer have no acceleration, and stay what their images say."""

FARTHEST = 0.6
"""Median over the images of the mean square of what a sequence moves them, in their deviations.

Where images and sequence agree it is below 0.5 on subject 86, whatever the noise; where it is
larger, bones are not rigid, landmarks are grossly wrong, or the prior is too sure.
"""

MOST = 4096
"""Frames that are refined together; longer sequences are cut into parts of about one length."""


@dataclass(frozen=True)
class Motion:
    """How bodies move and are built, in units of the size of their landmarks.

    bones (e, 2) keep their lengths but for deviations of give (e,); acceleration (p,), the root of
    the mean square of the second difference of a coordinate from frame to frame; known lengths (e,)
    of the bones in any unit, nan where a length is not known.
    """

    bones: Indices
    acceleration: Floats
    give: Floats
    known: Floats | None = None


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
    clips: Clips, sequences: Sequence[str], motion: Motion
) -> tuple[Floats, Floats, Floats, Floats]:
    """Points (n, 3, p), their deviations and correlations, and the noise (n,) of their sequence.

    All but correlations in the unit of the landmarks. nan in deviations, correlations and noise
    where the inference is that of the images: one is alone or nearly so in its sequence, or the
    sequence adds nothing (`find_noise`) or contradicts them (`FARTHEST`). Then the points are but
    steadied.
    """
    points = clips.points.copy()
    deviation, correlation = np.full_like(points, np.nan), np.full_like(points, np.nan)
    noise = np.full(len(points), np.nan)
    known: NDArray[np.bool_] = np.asarray(np.isfinite(clips.points).all(axis=(1, 2)))
    fewest = FEWEST if motion.known is None else 1
    for clip in parts(sequences):
        if known[clip].sum() < fewest:
            continue
        there = known[clip]
        unit = float(np.median(clips.scale[clip][there]))
        seen = in_unit(clips, clip, unit)
        acceleration = motion.acceleration * find_haste(seen, motion.acceleration)
        rows = np.arange(clip.start, clip.stop)[there]
        sd = clips.deviation[clip][there] / unit
        model = Model(motion.bones, acceleration**-2, motion.give, motion.known)
        sigma = find_noise(seen, model)
        found = None if sigma is None else smooth(seen, model, sigma)
        if (
            sigma is None
            or found is None
            or contradicts(seen.start[there], found.points[there], sd)
        ):
            spread = np.full_like(seen.start, np.inf)
            spread[there] = sd
            points[rows] = unit * steady(seen.start, spread, acceleration)[there]
            continue
        points[rows] = unit * found.points[there]
        spread, mixed = deviations(seen, model, sigma, found)
        deviation[rows], correlation[rows] = unit * spread[there], mixed[there]
        noise[rows] = unit * sigma
    return points, deviation, correlation, noise


def contradicts(images: Floats, sequence: Floats, sd: Floats) -> bool:
    """Whether a sequence moves the points (t, 3, p) of its images by more than `FARTHEST`."""
    return bool(np.median((((sequence - images) / sd) ** 2).mean(axis=(1, 2))) > FARTHEST)


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
        covariances=clips.modes.covariance[clip] * (grow**2)[:, None, None, None],
        misfit=clips.misfit,
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
