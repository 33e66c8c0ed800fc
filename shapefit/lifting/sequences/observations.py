"""What single images say about the frames of a sequence, in one unit and one frame of the camera.

A frame has some modes, as the posterior of its image gives them: Gaussians over the landmarks in
the frame of the camera, with shares. Their energy is the negative log of the mixture,

    -log sum_k share_k N(y_t; m_tk, C_tk),

and at given responsibilities of the modes a quadratic that touches it from above.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats

MOST_MODES = 4
"""Modes of a frame that count; the others have next to no share."""

DEPTH_VARIANCE = 1e-5
"""Added to the covariances, which know no mean depth: it stays where it is."""

UNSEEN_VARIANCE = 100.0
"""Of the frames whose image says nothing: the others place them."""


@dataclass(frozen=True)
class Observations:
    """The frames of one sequence, in units of the size of its landmarks.

    landmarks w (t, 2, p) as observed, nan where hidden; trust q (t, p), the belief that a landmark
    is where it was observed, 0 where it is hidden; start (t, 3, p), the mean of each image;
    misfit, the variance with which the posteriors took the landmarks; log_share (t, k),
    mean (t, k, 3p), precision (t, k, 3p, 3p) and log_det (t, k) of the modes, log_share -inf where
    a frame has fewer.
    """

    landmarks: Floats
    trust: Floats
    start: Floats
    misfit: float
    log_share: Floats
    mean: Floats
    precision: Floats
    log_det: Floats

    def __len__(self) -> int:
        return len(self.start)

    def take(self, frames: slice) -> Observations:
        """Return some of the frames."""
        of_frames = {name: values for name, values in vars(self).items() if name != "misfit"}
        return replace(self, **{name: values[frames] for name, values in of_frames.items()})


def observe(
    landmarks: Floats,
    trust: Floats,
    start: Floats,
    log_evidence: Floats,
    means: Floats,
    covariances: Floats,
    misfit: float,
    grow: Floats | float = 1.0,
) -> Observations:
    """Lay out the modes of t frames, all in one unit.

    log_evidence (t, k), -inf where a frame has fewer modes; means (t, k, 3, p); covariances
    (t, k, 3p, 3p), to be multiplied by grow^2 (t,), in whose memory the precisions then stand. A
    frame without modes starts between its neighbours. Raises ValueError where no frame has any.
    """
    t, k = log_evidence.shape[0], min(MOST_MODES, log_evidence.shape[1])
    d = 3 * landmarks.shape[2]
    there = np.isfinite(log_evidence[:, :k])
    known = there[:, 0]
    start = fill(start, known)
    best = np.where(known, log_evidence[:, 0], 0.0)[:, None]
    log_share = np.where(there, log_evidence[:, :k], -np.inf) - best
    log_share[~known, 0] = 0.0
    log_share = log_share - np.log(np.exp(log_share).sum(axis=1, keepdims=True))
    mean = np.where(there[..., None], means[:, :k].reshape(t, k, d), start.reshape(t, 1, d))
    precision, log_det = find_precisions(
        np.ascontiguousarray(covariances[:, :k]),
        np.where(there, np.reshape(grow, (-1, 1)) ** 2, 0.0),
        np.where(there, DEPTH_VARIANCE, UNSEEN_VARIANCE),
        there | ~known[:, None] & (np.arange(k) == 0),
    )
    return Observations(
        landmarks=landmarks,
        trust=np.where(
            np.isfinite(landmarks).all(axis=1) & known[:, None], np.nan_to_num(trust), 0.0
        ),
        start=start,
        misfit=misfit,
        log_share=log_share,
        mean=mean,
        precision=precision,
        log_det=log_det,
    )


def find_precisions(
    covariances: Floats, factor: Floats, more: Floats, there: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Inverses (t, k, d, d) of factor C + more I, and the log determinants (t, k) of these.

    factor, more (t, k); a factor of 0 takes C for 0. They are written over
    those C (t, k, d, d) that are `there` (t, k): of long sequences these take most of the memory.
    """
    log_det = np.zeros(there.shape)
    core.find_precisions(
        matrices=covariances, factor=factor, more=more, there=there, log_det=log_det, threads=1
    )
    return covariances, log_det


def fill(points: Floats, known: NDArray[np.bool_]) -> Floats:
    """Points (t, 3, p) with the frames that are not known between their neighbours in time."""
    if known.all():
        return points
    if not known.any():
        raise ValueError("no frame is known")
    frames = np.arange(len(points))
    flat = points[known].reshape(int(known.sum()), -1)
    filled = [np.interp(frames, frames[known], column) for column in flat.T]
    return np.stack(filled, axis=1).reshape(points.shape)
