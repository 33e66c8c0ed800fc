"""All that a result claims of its images, checked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.io import ResultSet
from shapefit.verification.check import Check, check, flagged
from shapefit.verification.images import read_images, stated_by
from shapefit.verification.proofs.camera import check_camera
from shapefit.verification.proofs.convex import check_fit, check_start
from shapefit.verification.proofs.one_rotation import check_one_rotation
from shapefit.verification.proofs.program import Value, dual_bound
from shapefit.verification.proofs.readings import check_readings
from shapefit.verification.proofs.reconstruction import check_proper
from shapefit.verification.proofs.rotation_tree import check_trees
from shapefit.verification.proofs.transforms import Atoms, Transforms
from shapefit.verification.statements import (
    OPTIMAL,
    check_absence,
    check_degenerate,
    check_lambda,
    check_left_out,
    check_words,
    find_kept,
)
from shapefit.verification.subject import Subject
from shapefit.verification.terms import Terms

MAP = "landmark_map"
"""Dataset (p, p) of a result whose landmarks are not those of the dictionary."""


def verify_images(
    result: ResultSet,
    atoms: Floats,
    atom_items: Sequence[str] | None,
    aside: NDArray[np.bool_],
    terms: Terms,
    file: Path,
) -> list[Check]:
    """Return the checks of all that a result claims of its n images.

    atoms (k, 3, p) of its dictionary, and the training shapes that they are, where they are such;
    aside (p,), the landmarks that were lifted without what images show of them.
    Raises InputError where the file lacks what every result has, or has it in another shape.
    """
    with np.errstate(all="ignore"):  # what is not finite holds for nothing
        fitted = np.isfinite(stated_by(result, "scale", file))
        rows = np.flatnonzero(fitted)
        images = read_images(result, rows, aside, terms, file)
        kept = find_kept(result, rows, atom_items, terms, file)
        seen = Atoms.of(atoms @ landmark_map(result).T)
        subject = Subject(result, rows, images, seen, kept, terms, file)
        checks = [check_lambda(images, subject.atoms, terms)]
        if terms.left_out:
            checks.append(check_left_out(result, rows, atom_items or (), terms, file))
        checks += check_subject(subject)
        return [
            check_words(result, fitted, terms, file),
            check_absence(result, fitted),
            check_degenerate(result, fitted, aside, file),
            *(one.of_images(rows, len(result)) for one in checks),
        ]


def check_subject(subject: Subject) -> list[Check]:
    """Check the proof of the convex program, and all that follows from the fit."""
    terms, checks, bound = subject.terms, check_rotation(subject), None
    if terms.has_program:
        M = subject.transforms()
        checks += check_atoms(subject, M)
        bound, feasible = dual_bound(
            subject.images, subject.stated("dual"), subject.atoms, subject.kept, terms
        )
        checks += feasible
        if terms.is_program:
            return checks + check_fit(subject, M, bound)
        checks += check_start(subject, M, bound)
    if terms.has_one_rotation:
        checks += check_one_rotation(subject, bound)
        return checks + (check_certificate(subject) if terms.is_global else [])
    return [*checks, *check_points_alone(subject)]


def check_rotation(subject: Subject) -> list[Check]:
    """Check that R is proper and orthonormal wherever it is stated; nan without transforms."""
    if subject.result.rotation is None or subject.terms.has_one_rotation:
        return []  # one rotation is checked with the shape that it turns
    R = subject.stated("rotation")
    stated = np.asarray(~np.isnan(R).all(axis=(1, 2)))
    return [check_proper(R, subject.images.factor, stated)]


def check_certificate(subject: Subject) -> list[Check]:
    """Check the trees that are there, and that an optimal image is within the tolerance."""
    gap, tolerance = subject.stated("relative_gap"), subject.terms.tolerance
    optimal = subject.words() == OPTIMAL
    within = check(
        "an optimal image is within the tolerance",
        gap - tolerance,
        subject.images.factor * value_share(subject),
        optimal,
    )
    return [within, *check_trees(subject), *check_readings(subject)]


def value_share(subject: Subject) -> Floats:
    """||Omega o V||^2 over the objective: what rounding of the bound weighs in the gap."""
    images = subject.images
    whole = (images.inliers[:, None] ** 2 * images.points**2).sum(axis=(1, 2))
    share: Floats = 1 + whole / subject.stated("objective")
    return share


def check_atoms(subject: Subject, M: Transforms) -> list[Check]:
    """Check that an image has at most one transform per atom, and none of an atom left out."""
    checks = [flagged("the transforms are in order", M.in_order())]
    if subject.kept is not None:
        without = np.ones(len(subject.rows), dtype=bool)
        without[M.image[~subject.kept[M.image, M.atom]]] = False
        checks.append(flagged("atoms that are left out have no transform", without))
    return checks


def check_points_alone(subject: Subject) -> list[Check]:
    """Check what holds of a method of which the result does not hold the whole answer."""
    if subject.terms.perspective:
        shapes, scale = subject.stated("shapes"), subject.stated("scale")
        seen = shapes @ landmark_map(subject.result).T
        middle = np.zeros((len(scale), 3))
        middle[:, :2] = subject.stated("translation")
        S = (seen - middle[..., None]) / scale[:, None, None]
        far = np.abs(shapes).max(axis=(1, 2)) / scale
        return check_camera(subject, Value(S, subject.images.factor * far))
    seen = subject.stated("shapes") @ landmark_map(subject.result).T
    off = np.abs(subject.stated("landmarks_fitted") - seen[:, :2])
    far = 0.0 if MAP not in subject.result.columns else np.abs(seen).max(axis=(1, 2))
    return [check("landmarks_fitted are x and y of the shapes", off, subject.images.factor * far)]


def landmark_map(result: ResultSet) -> Floats:
    """Weights A (p, p) of the joints of a result that give the landmarks seen."""
    p = len(result.landmark_names)
    A: Floats = np.asarray(result.columns.get(MAP, np.eye(p)), dtype=np.float64)
    return A if A.shape == (p, p) else np.full((p, p), np.nan)
