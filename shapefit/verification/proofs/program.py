"""Both sides of the certificate: the objective P of the transforms, the bound D of the dual.

    P = f(Omega o (V - sum_i M_i B_i - T 1^T)) + lambda sum_i ||M_i||_2
    D = <Y, Omega o V> - delta / 2 ||Y||_F^2
    where Y omega = 0, ||(Y o Omega) B_i^T||_* <= lambda for all i, |Y| <= the bound of the loss

V are the normalised landmarks; delta is 1 for the losses squared and sparse-error, else 0. With
each value comes a bound on its rounding; that of D also covers what a dual can lose that is
feasible to within rounding and is made feasible in full.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.verification.check import Check, check, largest
from shapefit.verification.images import Images
from shapefit.verification.proofs.block_norms import nuclear_norms
from shapefit.verification.proofs.transforms import Atoms
from shapefit.verification.terms import Terms

BLOCK = 128
"""Images whose products with the atoms are in the cache of the processor together."""


@dataclass(frozen=True)
class Value:
    """Numbers (n,) and bounds (n,) on how far rounding took them from what they are."""

    value: Floats
    error: Floats


def residual(
    images: Images, projections: Floats, translation: Floats, total: Floats, atoms: Atoms
) -> tuple[Floats, Floats]:
    """Omega o (V - X - T 1^T) (n, 2, p), and a bound (n,) on the error before weighting.

    projections X (n, 2, p) of transforms whose norms sum to total (n,); translation T (n, 2).
    """
    r = images.weights[:, None] * (images.points - projections - translation[..., None])
    far = images.reach + total * atoms.reach + np.abs(translation).max(axis=1)
    return r, images.points_error + images.factor * far


def objective(
    images: Images, r: Floats, error: Floats, total: Floats, loss: str, beta: float
) -> Value:
    """P of residuals r (n, 2, p) with errors (n,) before weighting, and norms that sum to total."""
    size = np.abs(r)
    if loss == "squared":
        terms, slope = r * r / 2, size
    elif loss == "sparse-error":
        terms = np.where(size <= beta, r * r / 2, beta * (size - beta / 2))
        slope = np.minimum(size, beta)
    elif loss == "l1":
        terms, slope = size, (images.weights[:, None] > 0).astype(float)
    else:
        terms, slope = np.zeros_like(r), np.zeros_like(r)
    P = terms.sum(axis=(1, 2)) + images.lam * total
    steep = (slope * images.weights[:, None]).sum(axis=(1, 2))
    bent = (images.weights**2).sum(axis=1)
    return Value(P, steep * error + bent * error**2 + images.factor * P)


def relative_residual(images: Images, r: Floats, error: Floats) -> Value:
    """||r||_F over that of the points about their mean, both weighted; r as in `residual`."""
    square = images.weights**2
    norm = np.sqrt(square.sum(axis=1))
    mean = np.einsum("nap,np->na", images.points, square) / (norm**2)[:, None]
    centred = images.weights[:, None] * (images.points - mean[..., None])
    whole = np.sqrt((centred**2).sum(axis=(1, 2)))
    share = np.sqrt((r**2).sum(axis=(1, 2))) / whole
    error = norm * (error + 2 * share * images.points_error) / whole + images.factor * share
    return Value(share, error)


def dual_bound(
    images: Images, dual: Floats, atoms: Atoms, kept: Flags | None, terms: Terms
) -> tuple[Value, list[Check]]:
    """D of the dual Y (n, 2, p), and the checks that it is feasible.

    kept (n, k): the atoms that the dictionary of each image has; None for all.
    """
    n, _, p = dual.shape
    omega, factor, lam = images.weights[:, None], images.factor, images.lam
    weighted = dual * omega
    most = np.empty(n)
    for some in (slice(start, start + BLOCK) for start in range(0, n, BLOCK)):
        N = (weighted[some].reshape(-1, p) @ atoms.columns).reshape(-1, 2, 3, atoms.count)
        norms = nuclear_norms(N[:, 0], N[:, 1])
        most[some] = largest(norms if kept is None else np.where(kept[some], norms, 0.0))
    magnitude = np.sqrt((weighted**2).sum(axis=1)).sum(axis=1) * atoms.reach
    slack = 2 * factor * (magnitude / lam + 1)
    checks = [check("the dual is feasible", most / lam - 1, slack)]
    unbalanced = np.abs(weighted.sum(axis=2))
    allowed = factor[:, None] * np.abs(weighted).sum(axis=2)
    checks.append(check("the dual is balanced", unbalanced, allowed))
    if np.isfinite(terms.bound):
        entries = largest(np.abs(dual)) / terms.bound - 1
        checks.append(check("the dual is bounded", entries, factor))

    V = images.points
    along = np.einsum("nap,nap->n", weighted, V)
    square = np.einsum("nap,nap->n", dual, dual) if terms.quadratic else np.zeros(n)
    terms_of_sum = np.einsum("nap,nap->n", np.abs(weighted), np.abs(V))
    error = np.abs(weighted).sum(axis=(1, 2)) * images.points_error
    error += factor * (terms_of_sum + square)
    error += 2 * slack * (np.abs(along) + square)
    error += allowed.sum(axis=1) * images.reach
    return Value(along - square / 2, error), checks


def gap_of(P: Value, D: Value) -> Value:
    """Return (P - D) / P; 0 where both are 0."""
    gap = np.where((P.value == 0) & (D.value == 0), 0.0, (P.value - D.value) / P.value)
    share = np.abs(D.value) / P.value
    error = (P.error * share + D.error) / P.value
    error = np.where((P.value == 0) & (D.value == 0), 0.0, error)
    return Value(gap, error)


def equal(claim: str, stated: Floats, found: Value) -> Check:
    """Return the check that what is stated is what is found."""
    return check(claim, np.abs(stated - found.value), found.error)
