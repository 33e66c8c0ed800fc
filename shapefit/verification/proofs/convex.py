"""Claims of the convex program: objective, gap, and all that follows from the transforms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.verification.check import Check, check, flagged, largest
from shapefit.verification.proofs.program import (
    Value,
    equal,
    gap_of,
    objective,
    relative_residual,
    residual,
)
from shapefit.verification.proofs.reconstruction import (
    ACTIVE,
    check_active,
    check_nearest,
    check_place,
    check_shapes,
)
from shapefit.verification.proofs.transforms import Transforms
from shapefit.verification.statements import LIMITED, OPTIMAL
from shapefit.verification.subject import Subject

ORTHOGONAL = 1e-3
"""Most that M M^T / c^2 may differ from I, in the Frobenius norm, where M counts as orthogonal."""


@dataclass(frozen=True)
class Solution:
    """What the transforms of n images make of them.

    total (n,), the sum of their norms; translation T (n, 2); residual r (n, 2, p), weighted, with
    its error (n,) before weighting; objective P, gap, and the relative residual.
    """

    total: Floats
    translation: Floats
    residual: Floats
    error: Floats
    objective: Value
    gap: Value
    left: Value


def check_start(subject: Subject, M: Transforms, D: Value) -> list[Check]:
    """Check the program from which a refinement starts."""
    found = _solve(subject, M, D, M.combine(M.blocks, subject.atoms))
    gap = subject.stated("convex_relative_gap")
    return [
        equal("the convex objective is P", subject.stated("convex_objective"), found.objective),
        equal("the convex gap is (P - D) / P", gap, found.gap),
    ]


def check_fit(subject: Subject, M: Transforms, D: Value) -> list[Check]:
    """Check objective, gap and status of a fit, its shapes and what goes with them."""
    terms, images = subject.terms, subject.images
    turned, doubt = M.completed(orthogonal=terms.orthogonal)
    S = M.combine(turned, subject.atoms)
    projections = M.combine(M.blocks, subject.atoms) if terms.orthogonal else S[:, :2]
    found = _solve(subject, M, D, projections)
    shapes = Value(S, images.factor * subject.atoms.reach * (found.total + doubt))
    T = Value(found.translation, np.zeros(len(S)))
    allowed = images.factor * (found.total + doubt)
    checks = [
        equal("the objective is P", subject.stated("objective"), found.objective),
        equal("the gap is (P - D) / P", subject.stated("relative_gap"), found.gap),
        _check_optimal(subject, found),
        _check_limited(subject),
        *_check_transforms(subject, M, found.total),
        *check_place(subject, T),
        *check_nearest(subject.stated("rotation"), M.total(turned), found.total, allowed),
        *check_shapes(subject, shapes),
        _check_residual(subject, shapes, found),
    ]
    if terms.loss in ("l1", "sparse-error"):
        checks.append(_check_outliers(subject, found))
    return checks


def _solve(subject: Subject, M: Transforms, D: Value, projections: Floats) -> Solution:
    """Take P, the gap to D and the residual at the translation that the result states."""
    images, terms = subject.images, subject.terms
    total, T = M.total(M.norms), subject.stated("convex_translation")
    r, error = residual(images, projections, T, total, subject.atoms)
    P = objective(images, r, error, total, terms.loss, terms.beta)
    return Solution(total, T, r, error, P, gap_of(P, D), relative_residual(images, r, error))


def _check_optimal(subject: Subject, found: Solution) -> Check:
    """Check that images that are called optimal are, by the tolerance of the config.

    For the loss exact, P bounds the optimum only as far as the residual is 0: the residual is
    within the tolerance too, and so is a gap below 0.
    """
    gap, left = found.gap, found.left
    off, allowed = gap.value, gap.error
    if subject.terms.loss == "exact":
        worse = left.value > np.abs(gap.value)
        off = np.maximum(left.value, np.abs(gap.value))
        allowed = np.where(worse, left.error, gap.error)
    claim, made = "an optimal image is within the tolerance", subject.words() == OPTIMAL
    return check(claim, off - subject.terms.tolerance, allowed, made)


def _check_limited(subject: Subject) -> Check:
    """Check that an image that stopped at the limit states a gap beyond the tolerance."""
    tolerance = subject.terms.tolerance
    within = subject.stated("relative_gap") <= tolerance
    if subject.terms.loss == "exact":
        within &= subject.stated("residual") <= tolerance
    off = np.where(within, np.inf, 0.0)
    claim, made = "an image at the iteration limit is not optimal", subject.words() == LIMITED
    return check(claim, off, 0.0, made)


def _check_transforms(subject: Subject, M: Transforms, total: Floats) -> list[Check]:
    """Check coefficients and, where the result has them, the transforms of all atoms."""
    off = np.abs(subject.stated("coefficients") - M.coefficients)
    allowed = (subject.images.factor * total)[:, None]
    checks = [
        check("coefficients follow from the transforms", off, allowed),
        check_active(subject),
        _check_tight(subject, M),
    ]
    if subject.result.transforms is not None:
        dense = np.zeros((M.images, M.atoms, 2, 3))
        dense[M.image, M.atom] = M.blocks
        off = np.abs(subject.stated("transforms") - dense)
        checks.append(check("transforms are the active ones", off, 0.0))
    return checks


def _check_tight(subject: Subject, M: Transforms) -> Check:
    """Check that a fit is called tight where all active M_i / c_i have orthonormal rows.

    What lies at the limit to within rounding can be called either.
    """
    apart, error = M.skewness, subject.images.factor[M.image]
    active = M.norms > ACTIVE * largest(subject.stated("coefficients"))[M.image]
    some = np.bincount(M.image[active], minlength=M.images) > 0

    def all_within(limit: Floats) -> Flags:
        within = np.ones(M.images, dtype=bool)
        within[M.image[active & (apart > limit)]] = False
        return within & some

    stated = subject.stated("tight") != 0
    surely, perhaps = all_within(ORTHOGONAL - error), all_within(ORTHOGONAL + error)
    return flagged("tight follows from the transforms", np.where(stated, perhaps, ~surely))


def _check_residual(subject: Subject, shapes: Value, found: Solution) -> Check:
    """Check the relative residual of the shapes, whose x and y `orthogonal` changes."""
    images, left = subject.images, found.left
    if subject.terms.orthogonal:
        X, T = shapes.value[:, :2], found.translation
        r, error = residual(images, X, T, found.total, subject.atoms)
        left = relative_residual(images, r, error + shapes.error)
    return equal("residual follows from the fit", subject.stated("residual"), left)


def _check_outliers(subject: Subject, found: Solution) -> Check:
    """Check that outliers are the landmarks with a weighted residual beyond beta."""
    weights, factor = subject.images.weights, subject.images.factor
    labelled = subject.stated("outliers") != 0
    beyond = np.abs(found.residual).max(axis=1) - subject.terms.beta
    off = np.where(weights > 0, np.where(labelled, -beyond, beyond), 0.0)
    off[labelled & (weights == 0)] = np.inf
    return check("outliers are beyond beta", off, weights * found.error[:, None] + factor[:, None])
