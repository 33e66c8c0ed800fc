"""Claims of shapes R sum_i c_i B_i with one rotation, under weak perspective or a camera."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats
from shapefit.verification.check import Check, check, flagged
from shapefit.verification.proofs.camera import check_camera
from shapefit.verification.proofs.program import (
    Value,
    equal,
    gap_of,
    objective,
    relative_residual,
    residual,
)
from shapefit.verification.proofs.reconstruction import (
    check_active,
    check_place,
    check_points,
    check_proper,
    check_shapes,
)
from shapefit.verification.subject import Subject


def check_one_rotation(subject: Subject, D: Value | None) -> list[Check]:
    """Check a shape from rotation and coefficients, and its gap to the bound D if there is one."""
    atoms, c, R = subject.atoms, subject.stated("coefficients"), subject.stated("rotation")
    total, factor = np.abs(c).sum(axis=1), subject.images.factor
    mixed = (c @ atoms.rows.reshape(atoms.count, -1)).reshape(len(c), 3, -1)
    S = np.where(np.isfinite(R), R, 0.0) @ mixed
    shapes = Value(S, 2 * factor * atoms.reach * total)
    checks = [check_proper(R, factor, total > 0), check_active(subject)]
    if subject.result.transforms is not None:
        shared = c[:, :, None, None] * np.where(np.isfinite(R), R, 0.0)[:, None, :2]
        off = np.abs(subject.stated("transforms") - shared)
        checks.append(
            check("transforms are those of the rotation", off, factor[:, None, None, None])
        )
    if subject.kept is not None:
        unused = ~(~subject.kept & (c != 0)).any(axis=1)
        checks.append(flagged("atoms that are left out have no coefficient", unused))
    if subject.terms.perspective:
        stated, claim = subject.stated("shapes"), "shapes follow from the fit"
        return [
            *checks,
            *check_camera(subject, shapes),
            check_points(claim, stated, shapes, subject),
        ]
    return checks + _check_objective(subject, shapes, total, D)


def _check_objective(
    subject: Subject, shapes: Value, total: Floats, D: Value | None
) -> list[Check]:
    """Check objective, gap and place, under the squared loss on the landmarks kept."""
    images = subject.images.judged_by_inliers()
    square = images.weights**2
    T = np.einsum("nap,np->na", images.points - shapes.value[:, :2], square)
    T /= square.sum(axis=1)[:, None]
    r, error = residual(images, shapes.value[:, :2], T, total, subject.atoms)
    error += shapes.error
    P = objective(images, r, error, total, "squared", subject.terms.beta)
    left = relative_residual(images, r, error)
    checks = [
        *check_place(subject, Value(T, error)),
        *check_shapes(subject, shapes),
        equal("residual follows from the fit", subject.stated("residual"), left),
        equal("the objective is that of the fit", subject.stated("objective"), P),
    ]
    if D is not None and subject.result.relative_gap is not None:
        stated = subject.stated("relative_gap")
        checks.append(equal("the gap is that to the dual", stated, gap_of(P, D)))
    return checks
