"""The shapes of a whole sequence at once: what the images say, rigid bones, and steady motion.

The landmarks y_t (3, p) of the frames, in the frame of the camera, and the lengths l of the bones
minimise

    sum_t  -log p(y_t | image t)                                   mixture of the image's modes
         + 1/2 sum_(t,j) q_tj (1/sigma^2 - 1/v) ||w_tj - y_tj||^2   the landmarks, of noise sigma
         + 1/2 sum_(t,j) ||y_(t-1)j - 2 y_tj + y_(t+1)j||^2 / a_j^2
         + 1/2 sum_(t, bones ij) (||y_ti - y_tj|| - l_ij)^2 / b^2.

The posteriors of the images took their landmarks with the variance v of what the prior cannot
place; over a sequence the landmarks themselves may be worth more, and the second term makes up for
it. Bones are rigid but unknown; where their lengths k are known up to the scale g of the images,
with the precision Q of their logarithms, d^T Q d / 2 of d = l / (g k) - 1 joins the objective.
Levenberg and Marquardt's
method over frames and lengths together: the lengths are few, and are eliminated from the banded
system of the frames. No step raises the objective; the minimum is a local one, near the start.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit import core
from shapefit.arrays import Floats
from shapefit.lifting.sequences.observations import Observations

Indices = NDArray[np.integer]

STILL = 1e-2
"""Rounds end when one lowers the objective by a smaller share of the number of frames."""


class Lengths(NamedTuple):
    """What is known of the lengths of bones beforehand, but for the size of the body.

    usual k (e,), in any unit, nan where a bone's is unknown; precision Q (e, e) of the logarithms,
    0 there; whether they were measured on the body itself, or on others of its kind.
    """

    usual: Floats
    precision: Floats
    measured: bool


@dataclass(frozen=True)
class Model:
    """How frames of a sequence hang together, in units of the size of its landmarks.

    bones (e, 2); stiffness 1/a^2 (p,); give b (e,), by which a bone differs from its length; known,
    what is known of these lengths.
    """

    bones: Indices
    stiffness: Floats
    give: Floats
    known: Lengths | None = None


@dataclass(frozen=True)
class Smoothed:
    """points (t, 3, p), lengths (e,), energy, log evidence of the noise up to a constant.

    deviation (t, 3, p) of the points, the lengths held, where it was asked for, and the correlation
    (t, 3, p) of x with y, x with z, and y with z of each landmark; covariance (t, 3p, 3p) of the
    frames, all x first, then y, then z, where it was asked for as well.
    """

    points: Floats
    lengths: Floats
    energy: float
    log_evidence: float
    deviation: Floats | None = None
    correlation: Floats | None = None
    covariance: Floats | None = None


def smooth(
    seen: Observations,
    model: Model,
    noise: float,
    start: Smoothed | None = None,
    rounds: int = 8,
    deviations: bool = False,
    covariances: bool = False,
) -> Smoothed:
    """Minimise the objective above for landmarks of the given noise, from a start or the images."""
    t, _, p = seen.start.shape
    points = (seen.start if start is None else start.points).reshape(t, 3 * p).copy()
    lengths = (first_lengths(seen.start, model) if start is None else start.lengths).copy()
    hold, known = held_lengths(model, lengths)
    end = np.empty(3)
    deviation, correlation = np.empty((2, t if deviations else 0, 3 * p))
    covariance = np.empty((t if deviations and covariances else 0, 3 * p, 3 * p))
    core.smooth_sequence(
        landmarks=np.nan_to_num(seen.landmarks).reshape(t, 2 * p),
        weight=further_weight(seen, noise),
        log_share=seen.log_share,
        means=seen.mean,
        precisions=seen.precision,
        log_det=seen.log_det,
        stiffness=model.stiffness,
        bones=np.ascontiguousarray(model.bones, np.int64).reshape(-1, 2),
        rigidity=model.give**-2.0,
        hold=hold,
        known=known,
        most_rounds=rounds,
        still=STILL,
        points=points,
        lengths=lengths,
        deviation=deviation,
        correlation=correlation,
        covariance=covariance,
        end=end,
    )
    energy, log_det = end[:2].tolist()
    spread = 2 * float(np.log(noise)) * float(seen.trust.sum())
    return Smoothed(
        points=points.reshape(t, 3, p),
        lengths=lengths,
        energy=energy,
        log_evidence=-energy - 0.5 * log_det - spread,
        deviation=deviation.reshape(t, 3, p) if deviations else None,
        correlation=correlation.reshape(t, 3, p) if deviations else None,
        covariance=covariance if len(covariance) else None,
    )


def further_weight(seen: Observations, noise: float) -> Floats:
    """Weight q (1/sigma^2 - 1/v) (t, 2p) of the landmarks beside what the images say of them."""
    more = max(1 / noise**2 - 1 / seen.misfit, 0.0)
    weight: Floats = more * np.tile(seen.trust, (1, 2))
    return weight


def held_lengths(model: Model, lengths: Floats) -> tuple[Floats, Floats]:
    """Weights H = Q / (g k)(g k)^T (e, e) and lengths g k (e,) of known bones; 0 of the others."""
    e = len(model.bones)
    known, shorter = np.zeros((2, e))
    if model.known is None:
        return np.zeros((e, e)), known
    usual = model.known.usual
    there = np.isfinite(usual)
    known[there] = usual[there] * scale_of(lengths, usual)
    shorter[there] = 1 / known[there]
    return model.known.precision * np.outer(shorter, shorter), known


def first_lengths(points: Floats, model: Model) -> Floats:
    """Mean lengths (e,) of the bones of points (t, 3, p), or those measured on the body."""
    i, j = model.bones.T
    mean: Floats = np.linalg.norm(points[:, :, i] - points[:, :, j], axis=1).mean(axis=0)
    if model.known is None or not model.known.measured:
        return mean
    usual = model.known.usual
    return np.where(np.isfinite(usual), usual * scale_of(mean, usual), mean)


def scale_of(lengths: Floats, known: Floats) -> float:
    """Scale g at which known lengths (e,), nan where unknown, agree best with others."""
    there = np.isfinite(known)
    return float(np.exp(np.log(lengths[there] / known[there]).mean()))
