"""Posteriors of single images beside the usual lengths of limbs, of a body of any size.

A mode of the posterior is y ~ N(m, C). Its limbs have the lengths l(y), and of bodies
is known log l = k + g 1 + e with a size g that may be anything and e ~ N(0, S). Both
together are likeliest where

    (y - m)^T C^-1 (y - m) + r^T Q r,    r = log l(y) - k,

is least, with Q = P - P 1 1^T P / (1^T P 1) and P = S^-1: g is integrated out. With the
derivative J of r at y, Gauss-Newton steps go to

    y <- m - C J^T G (r + J (m - y)),    G = (I + Q J C J^T)^-1 Q.

The covariance there is C - C J^T G J C. The log evidence of the mode falls by half of
the least value and half of log det (I + Q J C J^T), and by what is left of it the modes
are mixed.

A limb joins two landmarks i and j, and its row of J holds u at i and -u at j, for
u = (y_i - y_j) / ||y_i - y_j||^2: products with J are differences of rows, three
numbers long, and no matrix J is ever made.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.dictionary.bodies import find_limbs, precision_of_ratios
from shapefit.dictionary.model import Dictionary
from shapefit.lifting.estimate import PAIRS
from shapefit.lifting.posterior.posterior import Modes, Posterior

MODES = 8
"""Modes of an image that are looked at; few images have more."""

STEPS = 3
"""Gauss-Newton steps of a mode: the fourth changes shapes by less than 1e-3."""

IMAGES_TOGETHER = 256
"""Images whose modes are held in memory together: 8 covariances of each."""

TOLERANCE = 0.1
"""Standard deviation of the logarithm of a limb's length, beside that among training
bodies: detectors do not put joints where motion capture has them. On film errors are
the same from 0.03 to 0.1.
"""

MIN_SHARE = 1e-6
"""Share of the evidence of an image below which a mode adds nothing to its mixture."""

MIN_LIMBS = 2
"""One limb of a body of any size may have any length."""


class LimbLengths(NamedTuple):
    """Limbs (e, 2), the logarithms k (e,) of their usual lengths, and Q (e, e)."""

    limbs: Integers
    log_length: Floats
    precision: Floats


def find_limb_lengths(dictionary: Dictionary) -> LimbLengths | None:
    """Return the usual lengths of the limbs of people, None where they are unknown."""
    usual = dictionary.edge_length
    covariance = dictionary.edge_covariance
    edges = dictionary.edges
    if usual is None or covariance is None or edges is None:
        return None
    is_limb = find_limbs(dictionary.landmark_names, edges) & (usual > 0)
    rows = np.flatnonzero(is_limb)
    if len(rows) < MIN_LIMBS:
        return None
    S = covariance[np.ix_(rows, rows)] + TOLERANCE**2 * np.eye(len(rows))
    return LimbLengths(edges[rows], np.log(usual[rows]), precision_of_ratios(S))


def condition_on_lengths(
    posterior: Posterior, lengths: LimbLengths, *, covariance: bool
) -> Posterior:
    """Return the posteriors of n images given the usual lengths, mixed of their modes.

    The modes themselves stay as they are. Images without a mode keep what they have.
    With `covariance` that of all landmarks together is returned too.
    """
    modes = posterior.modes
    n, M, _, p = modes.mean.shape
    there: Flags = np.asarray(modes.component >= 0)
    there &= np.isfinite(modes.log_evidence)
    conditioned = condition_modes(modes, there, lengths)
    log_evidence = np.full((n, M), -np.inf)
    log_evidence[there] = modes.log_evidence[there] - conditioned.lost_evidence
    found: Flags = np.asarray(there.any(axis=1))
    total = total_log_evidence(log_evidence)
    share = np.exp(log_evidence - total[:, None])
    best = np.arange(n), log_evidence.argmax(axis=1)

    mean = np.zeros((n, M, 3, p))
    mean[there] = share[there][:, None, None] * conditioned.mean
    mean = mean.sum(axis=1)
    whole = mix_covariances(modes.covariance, conditioned, there, share, mean)
    variance = np.diagonal(whole, axis1=1, axis2=2).reshape(n, 3, p)
    deviation = np.sqrt(np.maximum(variance, 0.0))
    each = found[:, None, None]
    gain = total - total_log_evidence(np.where(there, modes.log_evidence, -np.inf))
    return posterior._replace(
        log_evidence=posterior.log_evidence + gain,
        mean=np.where(each, mean, posterior.mean),
        deviation=np.where(each, deviation, posterior.deviation),
        correlation=np.where(
            each, correlate_axes(whole, deviation), posterior.correlation
        ),
        covariance=whole if covariance else None,
        rotation=np.where(each, modes.rotation[best], posterior.rotation),
        scale=np.where(found, modes.scale[best], posterior.scale),
    )


class ConditionedModes(NamedTuple):
    """What the usual lengths make of r modes.

    mean (r, 3, p); across J C (r, e, 3p) and gain G (r, e, e), by which covariances
    fall; lost_evidence (r,), by which the log evidence falls.
    """

    mean: Floats
    across: Floats
    gain: Floats
    lost_evidence: Floats


def condition_modes(
    modes: Modes, there: Flags, lengths: LimbLengths
) -> ConditionedModes:
    """Condition the modes that are `there` (n, M) on the usual lengths of limbs."""
    m = modes.mean[there]
    Q = lengths.precision
    i, j = lengths.limbs.T
    r, _, p = m.shape
    e = len(i)
    # The rows of C at one end of each limb, less those at the other: (r, e, 3, 3p).
    rows = modes.covariance[there].reshape(r, 3, p, 3 * p).swapaxes(1, 2)
    C_limbs = rows[:, i] - rows[:, j]
    m_limbs = (m[..., i] - m[..., j]).swapaxes(1, 2)
    y = m
    for _ in range(STEPS):
        bone = (y[..., i] - y[..., j]).swapaxes(1, 2)
        square = np.maximum((bone**2).sum(axis=2), np.finfo(float).tiny)
        excess = np.log(square) / 2 - lengths.log_length
        u = bone / square[..., None]
        JC = np.einsum("rea,reac->rec", u, C_limbs)
        columns = JC.reshape(r, e, 3, p)
        JCJ = np.einsum("rfae,rea->rfe", columns[..., i] - columns[..., j], u)
        system = np.eye(e) + Q @ JCJ
        G = np.linalg.solve(system, np.broadcast_to(Q, JCJ.shape))
        ahead = excess + (u * (m_limbs - bone)).sum(axis=2)
        force = G @ ahead[..., None]
        y = m - (force.swapaxes(1, 2) @ JC).reshape(m.shape)
    moved = force.swapaxes(1, 2) @ JCJ @ force
    strained = excess[:, None] @ Q @ excess[..., None]
    _, log_det = np.linalg.slogdet(system)
    lost = ((moved + strained)[:, 0, 0] + log_det) / 2
    return ConditionedModes(y, JC, G, lost)


def total_log_evidence(log_evidence: Floats) -> Floats:
    """Return log sum_m exp of those of the modes (n, M), 0 where there is none."""
    best = log_evidence.max(axis=1, initial=-np.inf)
    best = np.where(np.isfinite(best), best, 0.0)
    likelihood = np.exp(log_evidence - best[:, None]).sum(axis=1)
    total: Floats = best + np.log(np.where(likelihood > 0, likelihood, 1.0))
    return total


def mix_covariances(
    covariance: Floats,
    conditioned: ConditionedModes,
    there: Flags,
    share: Floats,
    mean: Floats,
) -> Floats:
    """Return the covariances (n, 3p, 3p) of mixtures with the means y (n, 3, p).

    sum_m a_m (C_m - C_m J_m^T G_m J_m C_m + (y_m - y)(y_m - y)^T), with the
    covariances C_m (n, M, 3p, 3p) of the modes before, of which those `there` (n, M)
    were conditioned, and their shares a_m (n, M).
    """
    n, M = there.shape
    d = covariance.shape[2]
    place = np.cumsum(there).reshape(n, M) - 1
    whole = np.zeros((n, d, d))
    for rank in range(M):
        some = np.flatnonzero(share[:, rank] > MIN_SHARE)
        rows = place[some, rank]
        apart = (conditioned.mean[rows] - mean[some]).reshape(-1, d)
        JC = conditioned.across[rows]
        C = covariance[some, rank] - JC.swapaxes(1, 2) @ (conditioned.gain[rows] @ JC)
        C += apart[:, :, None] * apart[:, None]
        C *= share[some, rank][:, None, None]
        whole[some] += C
    return whole


def correlate_axes(covariance: Floats, deviation: Floats) -> Floats:
    """Correlations (n, 3, p) of x with y, x with z and y with z of each landmark."""
    n, _, p = deviation.shape
    blocks = np.diagonal(covariance.reshape(n, 3, p, 3, p), axis1=2, axis2=4)
    correlation = np.zeros_like(deviation)
    for row, (a, b) in enumerate(PAIRS):
        product = deviation[:, a] * deviation[:, b]
        np.divide(blocks[:, a, b], product, out=correlation[:, row], where=product > 0)
    return correlation
