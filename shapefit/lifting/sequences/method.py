"""The method `sequences`: the posterior of every image, and then of every sequence as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from shapefit.arrays import Floats
from shapefit.convex.problem import Problem
from shapefit.lifting.estimate import CORRELATION, Estimate
from shapefit.lifting.lift import Lifting
from shapefit.lifting.methods import Settings
from shapefit.lifting.posterior.method import lift_to_posterior
from shapefit.lifting.sequences.clips import Clips, Motion, parts, refine_clips, says_something
from shapefit.lifting.sequences.common_error import KEPT, SHARE, add_common_error, nearest_known
from shapefit.lifting.sequences.observations import MOST_MODES

NOISE = "sequence_noise"
"""Dataset of the noise (n,) of a coordinate that was found in the sequence of each image."""


def lift_frames(problem: Problem, settings: Settings) -> Estimate:
    """Return the posterior of each image, with the modes from which sequences are inferred."""
    found = lift_to_posterior(problem, settings, modes=MOST_MODES)
    unknown = np.full(len(problem.landmarks), np.nan)
    return replace(found, further={**found.further, NOISE: unknown})


def refine_lifting(
    lifting: Lifting,
    landmarks: Floats,
    sequences: Sequence[str],
    motion: Motion,
    misfit: float,
    widening: float,
    threads: int = 0,
) -> Lifting:
    """Infer the shapes of whole sequences from the modes of their images.

    landmarks (n, 2, p) as observed; misfit, the variance of normalised landmarks in the posteriors;
    widening of the variances; threads as in `refine_clips`. The covariances of the modes are
    written over. All but the shapes and what is known of them stays that of the images.
    """
    found = lifting.estimate
    modes = found.posterior_modes
    weights = lifting.problem.weights
    seen = (weights > 0)[:, None]
    own, own_mixed = found.deviation, found.further[CORRELATION]
    if modes is None or own is None:
        raise ValueError("the images have no modes, or no deviations")
    centre = lifting.translation - lifting.scale[:, None] * found.translation
    clips = Clips(
        landmarks=np.where(seen, landmarks, np.nan),
        trust=np.nan_to_num(found.further["belief"]) * weights**2,
        points=lifting.shapes,
        scale=lifting.scale,
        centre=centre,
        modes=modes,
        misfit=misfit,
        deviation=lifting.scale[:, None, None] * own / np.sqrt(widening),
    )
    whole = found.covariance
    refined = refine_clips(clips, sequences, motion, threads, covariances=whole is not None)
    single = np.isnan(refined.noise)[:, None, None]
    scale = lifting.scale[:, None, None] / np.sqrt(widening)
    rows = nearest_known(says_something(clips), parts(sequences))
    images = (own[rows], own_mixed[rows].swapaxes(1, 2).astype(np.float64))
    smoothed = (refined.deviation / scale, refined.correlation)
    constant = KEPT * refined.noise / scale[:, 0, 0]
    bars, correlation = add_common_error(smoothed, images, constant=constant)
    mixed = correlation.swapaxes(1, 2).astype(np.float32)
    if whole is not None and refined.covariance is not None:
        of_all = constant[:, None, None] ** 2 * np.eye(whole.shape[1])
        both = refined.covariance / scale**2 + SHARE**2 * whole[rows] + of_all
        whole = np.where(single, whole, both)
    return replace(
        lifting,
        shapes=refined.points,
        landmarks_fitted=refined.points[:, :2].copy(),
        estimate=replace(
            found,
            deviation=np.where(single, own, bars),
            covariance=whole,
            posterior_modes=None,
            further={
                **found.further,
                CORRELATION: np.where(single, own_mixed, mixed),
                NOISE: refined.noise,
            },
        ),
    )
