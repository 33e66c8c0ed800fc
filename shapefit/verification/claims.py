"""All that a result claims of its images, checked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.errors import input_error
from shapefit.io import ResultSet
from shapefit.verification.camera import check_camera
from shapefit.verification.check import Check, check
from shapefit.verification.images import Images, needed, read_images
from shapefit.verification.program import (
    Value,
    dual_bound,
    gap_of,
    objective,
    relative_residual,
    residual,
)
from shapefit.verification.reconstruction import (
    check_nearest,
    check_place,
    check_points,
    check_proper,
)
from shapefit.verification.terms import CONVEX, Terms
from shapefit.verification.transforms import Atoms, Transforms

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Rows = NDArray[np.intp]

WITHOUT_SHAPE = ("degenerate input", "numerical failure")
OPTIMAL = "optimal"
HIDDEN, FITTED = "left_out", "landmarks_fitted"


def verify_images(
    result: ResultSet,
    atoms: Floats,
    atom_items: Sequence[str] | None,
    terms: Terms,
    file: Path,
) -> list[Check]:
    """Return the checks of all that a result claims of its n images.

    atoms (k, 3, p) of its dictionary, and the training shapes that they are, where they are such.
    Raises InputError where the file lacks what every result has, or contradicts itself in sizes.
    """
    with np.errstate(all="ignore"):  # what is not finite holds for nothing
        return _verify(result, atoms, atom_items, terms, file)


def _verify(
    result: ResultSet,
    atoms: Floats,
    atom_items: Sequence[str] | None,
    terms: Terms,
    file: Path,
) -> list[Check]:
    scale = _stated(result, "scale", file)
    rows = np.flatnonzero(np.isfinite(scale))
    images = read_images(result, rows, terms, file)
    layout = Atoms.of(atoms)
    kept = _find_kept(result, rows, atom_items, terms, file)
    claims = _Claims(result, rows, images, layout, kept, terms, file)
    checks = [_check_lambda(images, terms)]
    if terms.left_out:
        checks.append(_check_left_out(result, rows, atom_items or (), terms, file))
    checks += claims.check_fit()
    fitted = np.isfinite(scale)
    return [
        _check_words(result, fitted, terms, file),
        _check_absence(result, fitted),
        *(one.of_images(rows, len(result)) for one in checks),
    ]


class _Claims:
    """The claims of the images `rows` of a result, those that have a shape."""

    def __init__(
        self,
        result: ResultSet,
        rows: Rows,
        images: Images,
        atoms: Atoms,
        kept: Flags | None,
        terms: Terms,
        file: Path,
    ) -> None:
        self.result, self.rows, self.images = result, rows, images
        self.atoms, self.kept, self.terms, self.file = atoms, kept, terms, file

    def stated(self, name: str) -> Floats:
        """Return what the result says of the images."""
        return _stated(self.result, name, self.file)[self.rows]

    def check_fit(self) -> list[Check]:
        """Check the proof of the convex program, and all that follows from the fit."""
        checks: list[Check] = []
        bound = None
        if self.terms.has_program:
            M = self._transforms()
            checks.append(_flagged("the transforms are in order", M.in_order()))
            if self.kept is not None:
                whole = np.ones(len(self.rows), dtype=bool)
                whole[M.image[~self.kept[M.image, M.atom]]] = False
                checks.append(_flagged("atoms that are left out have no transform", whole))
            dual = self.stated("dual")
            bound, feasible = dual_bound(self.images, dual, self.atoms, self.kept, self.terms)
            checks += feasible
            checks += self._check_program(M, bound)
        if self.terms.is_program:
            return checks
        if self.terms.has_one_rotation:
            return checks + self._check_one_rotation(bound)
        return [*checks, *self._check_points_alone()]

    def _transforms(self) -> Transforms:
        r = self.result
        assert r.transform_count is not None
        assert r.transform_atom is not None
        assert r.active_transforms is not None
        if ((r.transform_atom < 0) | (r.transform_atom >= self.atoms.count)).any():
            found = f"transforms of atoms that are not among the {self.atoms.count}"
            raise input_error(self.file, found, "give the dictionary of the fit")
        fitted = np.zeros(len(r), dtype=bool)
        fitted[self.rows] = True
        mine = np.repeat(fitted, r.transform_count)
        return Transforms.of(
            r.active_transforms[mine],
            r.transform_atom[mine],
            r.transform_count[self.rows],
            self.atoms.count,
        )

    def _check_program(self, M: Transforms, D: Value) -> list[Check]:
        """Check objective, gap and status, and what is made of the transforms."""
        images, terms = self.images, self.terms
        total = M.total(M.norms)
        T = self.stated("convex_translation")
        turned, doubt = M.completed(orthogonal=terms.orthogonal and terms.is_program)
        S = M.combine(turned, self.atoms)
        replaced = terms.orthogonal and terms.is_program
        X = M.combine(M.blocks, self.atoms) if replaced else S[:, :2]
        r, error = residual(images, X, T, total, self.atoms)
        P = objective(images, r, error, total, terms.loss, terms.beta)
        gap, left = gap_of(P, D), relative_residual(images, r, error)
        if not terms.is_program:
            return [
                _equal("the convex objective is P", self.stated("convex_objective"), P),
                _at_most("the convex gap is (P - D) / P", gap, self.stated("convex_relative_gap")),
            ]
        checks = [
            _equal("the objective is P", self.stated("objective"), P),
            _at_most(
                "the gap is (P - D) / P",
                gap,
                self.stated("relative_gap"),
                self._words() == OPTIMAL,
            ),
            self._check_optimal(gap, left),
        ]
        shapes = Value(S, images.factor * self.atoms.reach * (total + doubt))
        return checks + self._check_reconstruction(M, turned, shapes, total, doubt, T, r, error)

    def _check_optimal(self, gap: Value, left: Value) -> Check:
        """Check that images that are called optimal are, by the tolerance of the config.

        For the loss exact, P bounds the optimum only as far as the residual is 0: the residual is
        within the tolerance too, and so is a gap below 0.
        """
        words = self._words()
        off, allowed = gap.value, gap.error
        if self.terms.loss == "exact":
            worse = left.value > np.abs(gap.value)
            off = np.maximum(left.value, np.abs(gap.value))
            allowed = np.where(worse, left.error, gap.error)
        off = off - self.terms.tolerance
        return check("an optimal image is within the tolerance", off, allowed, words == OPTIMAL)

    def _check_reconstruction(
        self,
        M: Transforms,
        turned: Floats,
        shapes: Value,
        total: Floats,
        doubt: Floats,
        T: Floats,
        r: Floats,
        error: Floats,
    ) -> list[Check]:
        images, factor = self.images, self.images.factor
        c = np.abs(self.stated("coefficients") - M.coefficients)
        scale, translation = self.stated("scale"), self.stated("translation")
        checks = [
            check("coefficients follow from the transforms", c, (factor * total)[:, None]),
            *check_place(images, scale, translation, Value(T, np.zeros(len(T)))),
            *check_nearest(
                self.stated("rotation"), M.total(turned), total, factor * (total + doubt)
            ),
            *self._check_shapes(shapes, scale, translation),
        ]
        if self.terms.orthogonal:
            far = residual(images, shapes.value[:, :2], T, total, self.atoms)
            r, error = far[0], far[1] + shapes.error
        checks.append(self._check_residual(images, r, error))
        if self.terms.loss in ("l1", "sparse-error"):
            checks.append(self._check_outliers(r, error))
        if self.result.transforms is not None:
            dense = np.zeros((len(self.rows), self.atoms.count, 2, 3))
            dense[M.image, M.atom] = M.blocks
            off = np.abs(self.stated("transforms") - dense)
            checks.append(check("transforms are the active ones", off, 0.0))
        return checks

    def _check_shapes(self, shapes: Value, scale: Floats, translation: Floats) -> list[Check]:
        """Check shapes and fitted landmarks; with refined depths, x and y of the shapes."""
        factor, fitted = self.images.factor, self.stated(FITTED)
        checks = [
            check_points(
                "landmarks_fitted follow from the fit", fitted, shapes, scale, translation, factor
            )
        ]
        stated = self.stated("shapes")
        if not self.terms.depths:
            claim = "shapes follow from the fit"
            return [*checks, check_points(claim, stated, shapes, scale, translation, factor)]
        images = self.images
        W = images.size[:, None, None] * images.points + images.centroid[..., None]
        expected = np.where(images.inliers[:, None] > 0, W, fitted)
        allowed = (3 * factor * images.extent)[:, None, None]
        claim = "x and y of the shapes are the landmarks seen"
        return [*checks, check(claim, np.abs(stated[:, :2] - expected), allowed)]

    def _check_residual(self, images: Images, r: Floats, error: Floats) -> Check:
        stated = needed(self.result, "residual", self.file)[self.rows]
        return _equal("residual follows from the fit", stated, relative_residual(images, r, error))

    def _check_outliers(self, r: Floats, error: Floats) -> Check:
        """Check that outliers are the landmarks with a weighted residual beyond beta."""
        labelled = needed(self.result, "outliers", self.file, self.images.weights.shape[1])[
            self.rows
        ].astype(bool)
        beyond = np.abs(r).max(axis=1) - self.terms.beta
        allowed = self.images.weights * error[:, None] + self.images.factor[:, None]
        off = np.where(self.images.weights > 0, np.where(labelled, -beyond, beyond), 0.0)
        off[labelled & (self.images.weights == 0)] = np.inf
        return check("outliers are beyond beta", off, allowed)

    def _check_one_rotation(self, D: Value | None) -> list[Check]:
        """Check a shape R sum_i c_i B_i, by itself or in perspective."""
        factor, c = self.images.factor, self.stated("coefficients")
        total = np.abs(c).sum(axis=1)
        R = self.stated("rotation")
        mixed = (c @ self.atoms.rows.reshape(self.atoms.count, -1)).reshape(len(c), 3, -1)
        S = np.where(np.isfinite(R), R, 0.0) @ mixed
        shapes = Value(S, 2 * factor * self.atoms.reach * total)
        checks = [check_proper(R, factor, total > 0)]
        if self.kept is not None:
            checks.append(
                _flagged(
                    "atoms that are left out have no coefficient",
                    ~(~self.kept & (c != 0)).any(axis=1),
                )
            )
        scale, translation = self.stated("scale"), self.stated("translation")
        if self.terms.perspective:
            stated = self.stated("shapes")
            extent = self.images.extent
            return [
                *checks,
                *check_camera(self.result, self.rows, shapes, factor, extent, self.file),
                check_points(
                    "shapes follow from the fit", stated, shapes, scale, translation, factor
                ),
            ]
        images = self.images.judged_by_inliers()
        square = images.weights**2
        with np.errstate(divide="ignore", invalid="ignore"):
            T = np.einsum("nap,np->na", images.points - S[:, :2], square)
            T /= square.sum(axis=1)[:, None]
        r, error = residual(images, S[:, :2], T, total, self.atoms)
        error += shapes.error
        P = objective(images, r, error, total, "squared", self.terms.beta)
        checks += [
            *check_place(images, scale, translation, Value(T, error)),
            *self._check_shapes(shapes, scale, translation),
            self._check_residual(images, r, error),
            _equal("the objective is that of the fit", self.stated("objective"), P),
        ]
        if D is not None and self.result.relative_gap is not None:
            gap = gap_of(P, D)
            checks.append(_at_most("the gap is that to the dual", gap, self.stated("relative_gap")))
        return checks

    def _check_points_alone(self) -> list[Check]:
        """Check what holds of a method of which the result does not hold the whole answer."""
        stated, shapes = self.stated(FITTED), self.stated("shapes")
        claim = "landmarks_fitted are x and y of the shapes"
        return [] if self.terms.depths else [check(claim, np.abs(stated - shapes[:, :2]), 0.0)]

    def _words(self) -> NDArray[np.str_]:
        return _words(self.result, self.file)[self.rows]


def _stated(result: ResultSet, name: str, file: Path) -> Floats:
    values: Floats | None = getattr(result, name)
    if values is None:
        found = f"there is no dataset '{name}'"
        raise input_error(file, found, "give a result that `shapefit fit` wrote")
    return values


def _words(result: ResultSet, file: Path) -> NDArray[np.str_]:
    return np.asarray(_stated(result, "status", file)).astype(str)


def _equal(claim: str, stated: Floats, found: Value) -> Check:
    return check(claim, np.abs(stated - found.value), found.error)


def _at_most(claim: str, found: Value, stated: Floats, must: Flags | None = None) -> Check:
    """Check that what is found is at most what is stated; nan states nothing, unless it must."""
    made = ~np.isnan(stated)
    return check(claim, found.value - stated, found.error, made if must is None else made | must)


def _flagged(claim: str, holds: Flags) -> Check:
    return check(claim, np.where(holds, 0.0, np.inf), 0.0)


def _check_lambda(images: Images, terms: Terms) -> Check:
    """Check that lambda is the one of the config; where that is `auto`, that it is one."""
    lam = 1.0 if terms.loss == "exact" else terms.lam
    off = np.where(images.lam > 0, 0.0, np.inf) if lam is None else np.abs(images.lam - lam)
    return check("lambda is that of the config", off, 0.0)


def _find_kept(
    result: ResultSet, rows: Rows, atom_items: Sequence[str] | None, terms: Terms, file: Path
) -> Flags | None:
    """Return the atoms (n, k) that are not of the item that an image had to do without."""
    if not terms.left_out:
        return None
    if atom_items is None:
        found = f"models were left out (`leave_out: {terms.left_out}`)"
        raise input_error(file, found, "give the dictionary of the fit, whose atoms have items")
    left_out = needed(result, HIDDEN, file, text=True)[rows]
    return left_out[:, None] != np.array(atom_items, dtype=str)


def _check_left_out(
    result: ResultSet, rows: Rows, atom_items: Sequence[str], terms: Terms, file: Path
) -> Check:
    """Check that each image did without the item that its dataset names."""
    if terms.left_out == "item":
        named = np.array(result.items, dtype=str)[rows]
    else:
        renamed = f"input_{terms.left_out}"
        name = renamed if renamed in result.extras else terms.left_out
        named = needed(result, name, file, text=True)[rows]
    named = np.where(np.isin(named, np.array(atom_items, dtype=str)), named, "")
    stated = needed(result, HIDDEN, file, text=True)[rows]
    return _flagged("left_out is the item that the image shows", stated == named)


def _check_words(result: ResultSet, fitted: Flags, terms: Terms, file: Path) -> Check:
    """Check that the status is one that the method can end with."""
    words = _words(result, file)
    good = {"iteration limit", OPTIMAL if terms.is_program else "converged"}
    if terms.by_change and terms.method == CONVEX:
        good.add("converged")
    right = np.where(fitted, np.isin(words, list(good)), np.isin(words, WITHOUT_SHAPE))
    return _flagged("status is one of the method", right)


def _check_absence(result: ResultSet, fitted: Flags) -> Check:
    """Check that images without a scale have no shape and no transform, and the others a shape."""
    whole = np.isfinite(result.shapes).all(axis=(1, 2))
    empty = np.isnan(result.shapes).all(axis=(1, 2))
    if result.transform_count is not None:
        empty &= result.transform_count == 0
    return _flagged("a shape is whole or absent", np.where(fitted, whole, empty))
