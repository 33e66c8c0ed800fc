"""The certificate of the convex program, and of what refines it, from transforms and dual.

    P = f(Omega o (V - sum_i M_i B_i - T 1^T)) + lambda sum_i ||M_i||_2
    D = <Y, Omega o V> - delta / 2 ||Y||_F^2
    where Y omega = 0, ||(Y o Omega) B_i^T||_* <= lambda for all i, |Y| <= the bound of the loss

V are the normalised landmarks; delta is 1 for the losses squared and sparse-error, else 0. With one
rotation M_i = c_i Rbar, and f is the squared loss. The shape is scale sum_i c_i R_i B_i +
translation, c_i = ||M_i||_2 and R_i the rows of M_i / c_i and their cross product.

Norms of 2 x 3 blocks with rows x, y come from sums of terms that are not negative: with
g = ||x||^2 + ||y||^2 = s1^2 + s2^2 and v = ||x cross y|| = s1 s2 the nuclear norm is sqrt(g + 2 v),
and the spectral norm is the root of (g + h) / 2, h = sqrt((||x||^2 - ||y||^2)^2 + 4 (x . y)^2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.verification.checks import FLOOR, Checks, largest
from shapefit.verification.fit import PROOF, Images

Indices = NDArray[np.integer]

ACTIVE = 1e-6
"""Share of the largest coefficient of an image beyond which an atom is active."""
ORTHOGONAL = 1e-3
"""Most that M M^T / c^2 may differ from I, in the Frobenius norm, where M counts as orthogonal."""
MOST_CONDITION = 2.0**52
POSITIVE = 1e-6
"""Share of the cube of its size above which no rounding makes a determinant of 3 x 3 negative."""
BLOCK = 128
"""Images whose products with the atoms are in the cache of the processor together."""


class Sum(NamedTuple):
    """Numbers (n, ...), and the sums (n,) of the magnitudes of what adds up to them."""

    value: Floats
    terms: Floats


@dataclass(frozen=True)
class Atoms:
    """The dictionary: rows (3 k, p), for shapes; columns (p, 3 k), for correlations.

    The columns hold x, y and z of all atoms one after the other. `reach` is the largest distance
    of a landmark of an atom from its origin.
    """

    rows: Floats
    columns: Floats
    count: int
    reach: float

    @classmethod
    def of(cls, atoms: Floats) -> Atoms:
        """Lay out atoms B (k, 3, p)."""
        k, _, p = atoms.shape
        rows = np.ascontiguousarray(atoms.reshape(3 * k, p))
        columns = np.ascontiguousarray(atoms.transpose(2, 1, 0).reshape(p, 3 * k))
        return cls(rows, columns, k, float(np.sqrt((atoms**2).sum(axis=1)).max()))


@dataclass(frozen=True)
class Transforms:
    """The transforms M (a, 2, 3) of n images that are not 0, image after image.

    image and atom (a,): whose they are.
    """

    image: Indices
    atom: Indices
    blocks: Floats
    images: int

    @classmethod
    def of(cls, images: Images) -> Transforms:
        """Return those that a result states."""
        counts = images.columns["transform_count"]
        image = np.repeat(np.arange(len(counts)), counts)
        stated = images.columns["transform_atom"], images.columns["active_transforms"]
        return cls(image, *stated, len(counts))

    @cached_property
    def gram(self) -> tuple[Floats, Floats, Floats]:
        """||x||^2, ||y||^2 and x . y of the rows x, y of each block, (a,) each."""
        x, y = self.blocks[:, 0], self.blocks[:, 1]
        xx, yy, xy = (np.einsum("ai,ai->a", *pair) for pair in ((x, x), (y, y), (x, y)))
        return xx, yy, xy

    @cached_property
    def norms(self) -> Floats:
        """c_i (a,), the spectral norms."""
        xx, yy, xy = self.gram
        norms: Floats = np.sqrt((xx + yy + np.sqrt((xx - yy) ** 2 + 4 * xy**2)) / 2)
        return norms

    def total(self, values: NDArray[Any]) -> Floats:
        """Sum over the transforms of each image: (n, ...) of values (a, ...)."""
        rows = values.reshape(len(values), int(np.prod(values.shape[1:]))).T
        sums = [np.bincount(self.image, row, self.images) for row in rows]
        total: Floats = np.stack(sums, axis=-1).astype(np.float64, copy=False)
        return total.reshape(self.images, *values.shape[1:])

    def dense(self, values: Floats, atoms: Atoms) -> Floats:
        """Values (a, ...) at the places of their atoms, (n, k, ...), and 0 elsewhere."""
        dense = np.zeros((self.images, atoms.count, *values.shape[1:]))
        dense[self.image, self.atom] = values
        return dense

    def combine(self, turned: Floats, atoms: Atoms) -> Floats:
        """sum_i T_i B_i (n, d, p) of transforms T (a, d, 3) of the same atoms."""
        d = turned.shape[1]
        dense = np.zeros((self.images, d, atoms.count, 3))
        dense[self.image, :, self.atom] = turned
        shapes: Floats = dense.reshape(self.images * d, -1) @ atoms.rows
        return shapes.reshape(self.images, d, -1)

    def rotations(self, *, orthogonal: bool) -> Sum:
        """c_i R_i (a, 3, 3), and what their errors are sums of (n,), beside the norms.

        Where `orthogonal` R_i is the rotation nearest to M_i. It is as ill determined as s1 / s2 of
        M_i is large, which at most is 2 / u: that is all there is.
        """
        rows, norms, doubt = self.blocks, self.norms[:, None], np.zeros(self.images)
        if orthogonal:
            U, s, Vt = np.linalg.svd(self.blocks, full_matrices=False)
            rows = s[:, :1, None] * (U @ Vt)
            doubt = self.total(s[:, 0] * np.minimum(s[:, 0] / s[:, 1], MOST_CONDITION))
        across = np.cross(rows[:, 0], rows[:, 1])
        third = np.divide(across, norms, out=np.zeros_like(across), where=norms > 0)
        return Sum(np.concatenate([rows, third[:, None]], axis=1), doubt)


def nuclear_norms(x: Floats, y: Floats) -> Floats:
    """Return s1 + s2 of the blocks with rows x and y, (..., 3, k) each: (..., k)."""
    x0, x1, x2 = (x[..., axis, :] for axis in range(3))
    y0, y1, y2 = (y[..., axis, :] for axis in range(3))
    across = (x1 * y2 - x2 * y1) ** 2 + (x2 * y0 - x0 * y2) ** 2 + (x0 * y1 - x1 * y0) ** 2
    square = x0 * x0 + x1 * x1 + x2 * x2 + y0 * y0 + y1 * y1 + y2 * y2
    norms: Floats = np.sqrt(square + 2 * np.sqrt(across))
    return norms


def check_program(images: Images, atoms: Atoms, kept: Flags | None, checks: Checks) -> Sum:
    """Check the program from which the fit starts, or that it is; returns the dual bound.

    kept (n, k): the atoms that each image could use, None for all.
    """
    stated, own, M = images.columns, images.fit.is_program, Transforms.of(images)
    ordered = np.ones(M.images, dtype=bool)
    ordered[M.image[1:][(np.diff(M.atom) <= 0) & (np.diff(M.image) == 0)]] = False
    checks.hold("the transforms are in order", ordered)
    if kept is not None:
        unused = M.total(~kept[M.image, M.atom]) == 0
        checks.hold("atoms that are left out have no transform", unused)
    D = check_dual(images, atoms, kept, checks)
    T, total = stated["convex_translation"], M.total(M.norms)
    orthogonal = own and images.fit.key("rotations") == "orthogonal"
    turned = M.rotations(orthogonal=orthogonal) if own else Sum(M.blocks, np.zeros(M.images))
    S = Sum(M.combine(turned.value, atoms), (total + turned.terms) * atoms.reach)
    X = M.combine(M.blocks, atoms) if orthogonal else S.value[:, :2]
    P = objective(images, X, T, total, atoms)
    before = "" if own else "convex_"
    check_bound(images, f"{before}objective", f"{before}relative_gap", P, D, checks)
    if own:
        checks.settled.update(PROOF.split())
        c, blocks = M.dense(M.norms, atoms), None
        if "transforms" in stated:
            blocks = M.dense(M.blocks, atoms)
        check_coefficients(images, c, blocks, total, checks)
        _check_tight(images, M, checks)
        if images.fit.loss in ("l1", "sparse-error") and "outliers" in stated:
            _check_outliers(images, X, T, checks)
        allowed = images.allow(total + turned.terms, total)
        check_nearest(stated["rotation"], M.total(turned.value), total, allowed, checks)
        check_place(images, S, T, checks)
    return D


def check_one_rotation(
    images: Images, atoms: Atoms, kept: Flags | None, D: Sum | None, checks: Checks
) -> Sum:
    """Check a shape R sum_i c_i B_i, and its gap to the bound D if there is one; returns S."""
    images = replace(images, weights=images.inliers)
    c, n = images.columns["coefficients"], len(images.fitted)
    R, total = images.columns["rotation"], np.abs(c).sum(axis=1)
    stated = np.isfinite(R).all(axis=(1, 2))
    checks.hold("a shape has a rotation", stated, of=images.fitted & (total > 0))
    R = np.where(np.isfinite(R), R, 0.0)
    checks.settled.update(("rotation", "coefficients"))
    blocks = c[:, :, None, None] * R[:, None, :2] if "transforms" in images.columns else None
    check_coefficients(images, c, blocks, total, checks)
    if kept is not None:
        unused = ~(~kept & (c != 0)).any(axis=1)
        checks.hold("atoms that are left out have no coefficient", unused)
    S = R @ (c @ atoms.rows.reshape(atoms.count, -1)).reshape(n, 3, -1)
    shape = Sum(S, total * atoms.reach)
    if images.fit.perspective:
        check_points(images, shape, checks)
        return shape
    square = images.weights**2
    T = np.einsum("nap,np->na", images.points - S[:, :2], square) / square.sum(axis=1)[:, None]
    check_place(images, shape, T, checks)
    P = objective(images, S[:, :2], T, total, atoms, "squared")
    check_bound(images, "objective", "relative_gap", P, D if images.fit.has_gap else None, checks)
    return shape


def objective(
    images: Images, X: Floats, T: Floats, total: Floats, atoms: Atoms, loss: str = ""
) -> Sum:
    """P of projections X (n, 2, p) of transforms whose norms sum to `total`, translation T (n, 2).

    The loss is that of the fit unless it is named.
    """
    loss, beta, omega = loss or images.fit.loss, images.fit.beta, images.weights[:, None]
    size = np.abs(omega * (images.points - X - T[..., None]))
    f, slope = size**2 / 2, size
    if loss == "sparse-error":
        f, slope = np.where(size <= beta, f, beta * (size - beta / 2)), np.minimum(size, beta)
    elif loss == "l1":
        f, slope = size, (omega > 0) + 0.0
    elif loss == "exact":
        f, slope = np.zeros_like(size), np.zeros_like(size)
    P = f.sum(axis=(1, 2)) + images.lam * total
    far = 1 + largest(np.abs(images.points)) + total * atoms.reach + largest(np.abs(T))
    steep = (slope * omega).sum(axis=(1, 2)) + images.rounding * far * (omega**2).sum(axis=(1, 2))
    return Sum(P, P + steep * 2 * far)


def check_dual(images: Images, atoms: Atoms, kept: Flags | None, checks: Checks) -> Sum:
    """Check that the dual Y (n, 2, p) is feasible; returns D.

    The terms also cover what a dual loses that is feasible to within rounding, when it is made so.
    """
    Y, lam, fit = images.columns["dual"], images.lam, images.fit
    n, _, p = Y.shape
    weighted, most = Y * images.weights[:, None], np.empty(n)
    for some in (slice(start, start + BLOCK) for start in range(0, n, BLOCK)):
        N = (weighted[some].reshape(-1, p) @ atoms.columns).reshape(-1, 2, 3, atoms.count)
        norms = nuclear_norms(N[:, 0], N[:, 1])
        most[some] = largest(norms if kept is None else np.where(kept[some], norms, 0.0))
    magnitude = np.sqrt((weighted**2).sum(axis=1)).sum(axis=1) * atoms.reach / lam + 1
    checks.add("the dual is feasible", most / lam - 1, images.allow(2 * magnitude, 1.0))
    sizes = np.abs(weighted).sum(axis=2)
    allowed = np.maximum(images.rounding, FLOOR)[:, None] * sizes
    checks.add("the dual is balanced", np.abs(weighted.sum(axis=2)), allowed)
    hidden = np.abs(Y) * (images.weights[:, None] == 0)
    checks.add("the dual is 0 where nothing is seen", hidden, 0.0)
    bound = {"l1": 1.0, "sparse-error": fit.beta}.get(fit.loss)
    if bound is not None:
        checks.add("the dual is bounded", largest(np.abs(Y)) / bound - 1, images.allow(lam, 1.0))
    along = np.einsum("nap,nap->n", weighted, images.points)
    square = np.einsum("nap,nap->n", Y, Y) * (fit.loss in ("squared", "sparse-error"))
    reach = 1 + 2 * largest(np.abs(images.points))
    terms = sizes.sum(axis=1) * 2 * reach + square + 4 * magnitude * (np.abs(along) + square)
    return Sum(along - square / 2, terms)


def check_bound(
    images: Images, objective: str, gap: str, P: Sum, D: Sum | None, checks: Checks
) -> None:
    """Check the datasets of the objective P and of the gap (P - D) / P, 0 where both are 0."""
    checks.equal(objective, "the fit", P.value, images.allow(P.terms, P.value))
    if D is None:
        return
    none = (P.value == 0) & (D.value == 0)
    found = np.where(none, 0.0, (P.value - D.value) / P.value)
    terms = np.where(none, 0.0, (P.terms * np.abs(D.value) / P.value + D.terms) / P.value)
    checks.equal(gap, "objective and dual", found, images.allow(terms, 2 + np.abs(found)))


def check_coefficients(
    images: Images, c: Floats, blocks: Floats | None, total: Floats, checks: Checks
) -> None:
    """Check c (n, k), transforms (n, k, 2, 3) if stated, and which atoms are active.

    Coefficients at the limit to within rounding can count as active or not.
    """
    stated, allowed = images.columns["active_atoms"], images.allow(total, total)
    checks.equal("coefficients", "the transforms", c, allowed)
    if blocks is not None:
        checks.equal("transforms", "the coefficients or active ones", blocks, allowed)
    size = np.abs(c)
    limit = ACTIVE * largest(size)[:, None]
    surely, perhaps = ((size > limit * (1 + side)).sum(axis=1) for side in (FLOOR, -FLOOR))
    right = (stated >= surely) & (stated <= perhaps)
    checks.hold("active_atoms follows from the coefficients", right, "active_atoms")


def check_place(images: Images, S: Sum, T: Floats, checks: Checks) -> None:
    """Check scale = size, translation = size T + centroid, and the shapes; T (n, 2)."""
    check_scale(images, checks)
    far = images.size * (largest(np.abs(T)) + 1)
    found = images.size[:, None] * T + images.centroid
    number = far + largest(np.abs(images.centroid))
    allowed = images.allow(4 * (far + images.size * S.terms), number)
    checks.equal("translation", "the fit", found, allowed)
    check_points(images, S, checks)


def check_scale(images: Images, checks: Checks) -> None:
    """Check that scale is the size (n,) of the landmarks."""
    checks.equal("scale", "the landmarks", images.size, images.allow(3 * images.size, images.size))


def check_points(images: Images, S: Sum, checks: Checks) -> None:
    """Check that the shapes (n, 3, p) are scale x S + translation on x and y."""
    scale, translation = images.columns["scale"], images.columns["translation"]
    found = scale[:, None, None] * S.value
    found[:, :2] += translation[..., None]
    number = scale * largest(np.abs(S.value)) + largest(np.abs(translation))
    checks.equal("shapes", "the fit", found, images.allow(2 * scale * S.terms, number))


def check_proper(images: Images, checks: Checks) -> None:
    """Check that R (n, 3, 3) are rotations wherever they are stated: R^T R = I and det R = +1."""
    R = images.columns["rotation"]
    gram = np.abs(R.swapaxes(1, 2) @ R - np.eye(3)).reshape(len(R), 9)
    off = np.concatenate([gram, np.abs(np.linalg.det(R) - 1)[:, None]], axis=1)
    stated = np.asarray(~np.isnan(R).all(axis=(1, 2)))
    checks.add("rotation is proper and orthonormal", off, 4 * FLOOR, of=stated)


def check_nearest(rotation: Floats, A: Floats, size: Floats, error: Floats, checks: Checks) -> None:
    """Check that rotations R (n, 3, 3) are the nearest ones to A = sum_i c_i R_i.

    R maximises <R, A> over rotations where R^T A is symmetric and no two of its eigenvalues sum
    to less than 0. A is at most `error` (n,) off and of about the size (n,), 0 for no transforms:
    there R is nan.
    """
    turned, absent = (size > 0) & checks.fitted, np.isnan(rotation).all(axis=(1, 2))
    checks.hold("rotation is absent without transforms", absent, of=checks.fitted & ~turned)
    H = np.where(turned[:, None, None], rotation, np.eye(3)).swapaxes(1, 2) @ A
    skew = largest(np.abs(H - H.swapaxes(1, 2)))
    H = np.where(np.isfinite(H), H + H.swapaxes(1, 2), 0.0) / 2
    sums = np.trace(H, axis1=1, axis2=2)[:, None, None] * np.eye(3) - H
    minor = sums[:, 0, 0] * sums[:, 1, 1] - sums[:, 0, 1] ** 2
    sure = (sums[:, 0, 0] > 0) & (minor > 0) & (np.linalg.det(sums) > POSITIVE * size**3)
    off = skew.copy()
    off[~sure] = np.maximum(skew[~sure], -np.linalg.eigvalsh(sums[~sure])[:, 0])
    checks.add("rotation is nearest to the transforms", off, 3 * error, "rotation", turned)


def _check_tight(images: Images, M: Transforms, checks: Checks) -> None:
    """Check that a fit is called tight where all active M_i / c_i have orthonormal rows.

    What lies at the limit to within rounding can be called either.
    """
    xx, yy, xy = (each / M.norms**2 for each in M.gram)
    apart = np.sqrt((xx - 1) ** 2 + (yy - 1) ** 2 + 2 * xy**2)
    active = M.norms > ACTIVE * largest(images.columns["coefficients"])[M.image]
    error = FLOOR + images.rounding[M.image]
    some = M.total(active) > 0
    surely, perhaps = (
        some & (M.total(active & (apart > ORTHOGONAL + side * error)) == 0) for side in (-1, 1)
    )
    right = np.where(images.columns["tight"] != 0, perhaps, ~surely)
    checks.hold("tight follows from the transforms", right, "tight")


def _check_outliers(images: Images, X: Floats, T: Floats, checks: Checks) -> None:
    """Check that outliers are the landmarks with a weighted residual beyond beta."""
    omega, beta = images.weights, images.fit.beta
    r = omega[:, None] * (images.points - X - T[..., None])
    labelled = images.columns["outliers"] != 0
    beyond = np.abs(r).max(axis=1) - beta
    off = np.where(omega > 0, np.where(labelled, -beyond, beyond), np.where(labelled, np.inf, 0.0))
    far = largest(np.abs(images.points)) + largest(np.abs(X)) + largest(np.abs(T))
    allowed = (omega + beta) * images.allow(2 * far, 1.0)[:, None]
    checks.add("outliers are beyond beta", off, allowed, "outliers")
