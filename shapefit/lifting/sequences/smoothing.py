"""The shapes of a whole sequence at once: what the images say, rigid bones, and steady motion.

The landmarks y_t (3, p) of the frames, in the frame of the camera, and the lengths l of the bones
minimise

    sum_t  -log p(y_t | image t)                                   mixture of the image's modes
         + 1/2 sum_(t,j) q_tj (1/sigma^2 - 1/v) ||w_tj - y_tj||^2   the landmarks, of noise sigma
         + 1/2 sum_(t,j) ||y_(t-1)j - 2 y_tj + y_(t+1)j||^2 / a_j^2
         + 1/2 sum_(t, bones ij) (||y_ti - y_tj|| - l_ij)^2 / b^2.

The posteriors of the images took their landmarks with the variance v of what the prior cannot
place; over a sequence the landmarks themselves may be worth more, and the second term makes up for
it. Bones are rigid but unknown; where a body was measured, its lengths k are known up to the scale
g of the images, and sum (l - g k)^2 / (2 (s g k)^2) joins the objective. Levenberg and Marquardt's
method over frames and lengths together: the lengths are few, and are eliminated from the banded
system of the frames. No step raises the objective; the minimum is a local one, near the start.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.lifting.sequences.banded import Factor, accelerations, spread_back
from shapefit.lifting.sequences.observations import Observations, mixture

Floats = NDArray[np.float64]
Indices = NDArray[np.integer]

LONGEST_STEP = 0.5
LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e6
STILL = 1e-5
"""Rounds end when one lowers the objective by a smaller share of the number of frames."""


@dataclass(frozen=True)
class Model:
    """How frames of a sequence hang together, in units of the size of its landmarks.

    bones (e, 2); stiffness 1/a^2 (p,); give b (e,), by which a bone differs from its length; known
    lengths k (e,), in any unit, nan where a bone's is unknown, with the relative deviation s.
    """

    bones: Indices
    stiffness: Floats
    give: Floats
    known: Floats | None = None
    spread: float = 0.01


@dataclass(frozen=True)
class Smoothed:
    """points (t, 3, p), lengths (e,), energy, log evidence of the noise up to a constant."""

    points: Floats
    lengths: Floats
    energy: float
    log_evidence: float


@dataclass(frozen=True)
class _At:
    energy: float
    share: Floats
    pull: Floats
    away: Floats
    bone: Floats
    size: Floats
    short: Floats


def smooth(
    seen: Observations, model: Model, noise: float, start: Smoothed | None = None, rounds: int = 12
) -> Smoothed:
    """Minimise the objective above for landmarks of the given noise, from a start or the images."""
    t, _, p = seen.start.shape
    y = (seen.start if start is None else start.points).reshape(t, 3 * p)
    lengths = first_lengths(seen.start, model) if start is None else start.lengths
    problem = _Problem(seen, model, noise, lengths)
    at = problem.look(y, lengths)
    damping = 1e-3
    log_det = 0.0
    for _ in range(rounds):
        moved = None
        while damping < MOST_DAMPING:
            step, longer, log_det = problem.step(y, lengths, at, damping)
            shrink = min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), 1e-300))
            tried = y + shrink * step, lengths + shrink * longer
            moved = problem.look(*tried)
            if moved.energy <= at.energy:
                break
            damping, moved = 6 * damping, None
        if moved is None:
            break
        (y, lengths), gain, at = tried, at.energy - moved.energy, moved
        damping = max(damping / 5, LEAST_DAMPING)
        if gain < STILL * t:
            break
    spread = 2 * float(np.log(noise)) * float(seen.trust.sum())
    evidence = -at.energy - 0.5 * log_det - spread
    return Smoothed(y.reshape(t, 3, p), lengths, at.energy, evidence)


def first_lengths(points: Floats, model: Model) -> Floats:
    """Mean lengths (e,) of the bones of points (t, 3, p), or the known ones."""
    i, j = model.bones.T
    mean: Floats = np.linalg.norm(points[:, :, i] - points[:, :, j], axis=1).mean(axis=0)
    if model.known is None:
        return mean
    there = np.isfinite(model.known)
    return np.where(there, model.known * scale_of(mean, model.known), mean)


def scale_of(lengths: Floats, known: Floats) -> float:
    """Scale g at which known lengths (e,), nan where unknown, agree best with others."""
    there = np.isfinite(known)
    return float(np.exp(np.log(lengths[there] / known[there]).mean()))


def normal_blocks(
    seen: Observations, model: Model, noise: float, found: Smoothed
) -> tuple[Floats, Floats]:
    """Blocks (t, 3p, 3p) of the frames in the Hessian, and the stiffness (3p,) of the motion."""
    problem = _Problem(seen, model, noise, found.lengths)
    y = found.points.reshape(len(seen), -1)
    return problem.equations(y, problem.look(y, found.lengths))[0], problem.stiffness


class _Problem:
    """The objective of one sequence at one level of noise, and its Gauss-Newton steps."""

    def __init__(self, seen: Observations, model: Model, noise: float, lengths: Floats) -> None:
        self.seen, self.model = seen, model
        self.stiffness = np.tile(model.stiffness, 3)
        more = max(1 / noise**2 - 1 / seen.misfit, 0.0)
        self.weight = more * np.tile(seen.trust, (1, 2))  # (t, 2p)
        self.w = np.nan_to_num(seen.landmarks).reshape(len(seen), -1)
        e = len(model.bones)
        self.hold = np.zeros(e)
        self.known = np.zeros(e)
        if model.known is not None:
            there = np.isfinite(model.known)
            scaled = model.known[there] * scale_of(lengths, model.known)
            self.hold[there] = 1 / (model.spread * scaled) ** 2
            self.known[there] = scaled

    def look(self, y: Floats, lengths: Floats) -> _At:
        """Evaluate the objective and its terms at frames y (t, 3p) and lengths (e,)."""
        t, p = len(y), y.shape[1] // 3
        i, j = self.model.bones.T
        energy, share, pull = mixture(self.seen, y)
        away = y[:, : 2 * p] - self.w
        points = y.reshape(t, 3, p)
        bone = points[:, :, i] - points[:, :, j]
        size = np.linalg.norm(bone, axis=1)
        short = size - lengths
        energy += 0.5 * float((self.weight * away**2).sum())
        energy += 0.5 * float((self.stiffness * accelerations(y) ** 2).sum())
        energy += 0.5 * float(((short / self.model.give) ** 2).sum())
        energy += 0.5 * float((self.hold * (lengths - self.known) ** 2).sum())
        return _At(energy, share, pull, away, bone, size, short)

    def equations(self, y: Floats, at: _At) -> tuple[Floats, Floats, Floats]:
        """Blocks (t, d, d) and gradient (t, d) of the frames, and the bones' directions (t, e, d).

        Of the motion the gradient alone: its part of the Hessian is banded.
        """
        t, d = y.shape
        p, e = d // 3, len(self.model.bones)
        i, j = self.model.bones.T
        share = at.share[:, None, :]
        blocks = np.matmul(share, self.seen.precision.reshape(t, -1, d * d)).reshape(t, d, d)
        gradient = np.matmul(share, at.pull)[:, 0]
        diagonal = np.arange(2 * p)
        blocks[:, diagonal, diagonal] += self.weight
        gradient[:, : 2 * p] += self.weight * at.away
        gradient += spread_back(self.stiffness * accelerations(y), t)
        give = self.model.give**-2
        along = at.bone / np.maximum(at.size, 1e-12)[:, None]
        J = np.zeros((t, e, d))
        for axis in range(3):
            J[:, np.arange(e), axis * p + i] = along[:, axis]
            J[:, np.arange(e), axis * p + j] = -along[:, axis]
        blocks += np.matmul(J.swapaxes(1, 2), give[:, None] * J)
        gradient += np.matmul((give * at.short)[:, None], J)[:, 0]
        return blocks, gradient, J

    def step(
        self, y: Floats, lengths: Floats, at: _At, damping: float
    ) -> tuple[Floats, Floats, float]:
        """Damped Gauss-Newton step of frames (t, 3p) and lengths (e,), and log det of frames."""
        t, d = y.shape
        blocks, gradient, J = self.equations(y, at)
        give = self.model.give**-2
        blocks[:, np.arange(d), np.arange(d)] += 100 * damping
        factor = Factor(blocks, self.stiffness)
        mixed = -(give * J.swapaxes(1, 2))  # (t, d, e), second derivatives of frames and lengths
        solved = factor.solve(np.concatenate([gradient[..., None], mixed], axis=2))
        schur = np.diag(t * give + self.hold + 1e-9) - np.einsum(
            "tda,tdb->ab", mixed, solved[..., 1:]
        )
        pulled = self.hold * (lengths - self.known) - give * at.short.sum(axis=0)
        longer = -np.linalg.solve(schur, pulled - np.einsum("tda,td->a", mixed, solved[..., 0]))
        return -solved[..., 0] - solved[..., 1:] @ longer, longer, factor.log_det
