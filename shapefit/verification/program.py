"""The certificate of the convex program, computed again from transforms and dual.

    P = f(Omega o (V - sum_i M_i B_i - T 1^T)) + lambda sum_i ||M_i||_2
    D = <Y, Omega o V> - delta / 2 ||Y||_F^2
    where Y omega = 0, ||(Y o Omega) B_i^T||_* <= lambda for all i, |Y| <= the bound of the loss

V are the normalised landmarks; delta is 1 for the losses squared and sparse-error, else 0.

Norms of 2 x 3 blocks with rows x, y come from sums of terms that are not negative: with
g = ||x||^2 + ||y||^2 = s1^2 + s2^2 and v = ||x cross y|| = s1 s2 the nuclear norm is sqrt(g + 2 v),
and the spectral norm is the root of (g + h) / 2, h = sqrt((||x||^2 - ||y||^2)^2 + 4 (x . y)^2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.verification.checks import FLOOR, Checks, largest
from shapefit.verification.fit import LIMITED, OPTIMAL, Images
from shapefit.verification.rotation import check_nearest

Indices = NDArray[np.integer]

ACTIVE = 1e-6
"""Share of the largest coefficient of an image beyond which an atom is active."""
ORTHOGONAL = 1e-3
"""Most that M M^T / c^2 may differ from I, in the Frobenius norm, where M counts as orthogonal."""
MOST_CONDITION = 2.0**52
BLOCK = 128
"""Images whose products with the atoms are in the cache of the processor together."""


@dataclass(frozen=True)
class Value:
    """Numbers (n,) and bounds (n,) on how far rounding took them from what they are."""

    value: Floats
    error: Floats


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
    """The transforms of n images that are not 0, image after image.

    image and atom (a,): whose they are; blocks M (a, 2, 3); norms (a,), their spectral norms.
    """

    image: Indices
    atom: Indices
    blocks: Floats
    norms: Floats
    images: int
    atoms: int

    @classmethod
    def of(cls, images: Images, atoms: int) -> Transforms:
        """Return those that a result states."""
        columns = images.columns
        blocks, counts = columns["active_transforms"], columns["transform_count"]
        x, y = blocks[:, 0], blocks[:, 1]
        xx, yy, xy = (np.einsum("ai,ai->a", *pair) for pair in ((x, x), (y, y), (x, y)))
        norms = np.sqrt((xx + yy + np.sqrt((xx - yy) ** 2 + 4 * xy**2)) / 2)
        image = np.repeat(np.arange(len(counts)), counts)
        return cls(image, columns["transform_atom"], blocks, norms, len(counts), atoms)

    def total(self, values: Floats) -> Floats:
        """Sum over the transforms of each image: (n, ...) of values (a, ...)."""
        sums = np.zeros((self.images, *values.shape[1:]))
        counts = np.bincount(self.image, minlength=self.images)
        some = counts > 0
        if some.any():
            sums[some] = np.add.reduceat(values, (np.cumsum(counts) - counts)[some], axis=0)
        return sums

    def combine(self, turned: Floats, atoms: Atoms) -> Floats:
        """sum_i T_i B_i (n, d, p) of transforms T (a, d, 3) of the same atoms."""
        d = turned.shape[1]
        dense = np.zeros((self.images, d, self.atoms, 3))
        dense[self.image, :, self.atom] = turned
        shapes: Floats = dense.reshape(self.images * d, 3 * self.atoms) @ atoms.rows
        return shapes.reshape(self.images, d, -1)

    def completed(self, *, orthogonal: bool) -> tuple[Floats, Floats]:
        """c_i R_i (a, 3, 3), and a bound (n,) on what `orthogonal` adds to their errors.

        The rows of M_i and their cross product over c_i; where `orthogonal` c_i times the nearest
        orthonormal rows and theirs. These are as ill determined as s1 / s2 of M_i is large: the
        bound is sum_i c_i s1 / s2, at most 2 c_i / u, which is all there is.
        """
        rows, doubt = self.blocks, np.zeros(self.images)
        if orthogonal:
            rows, condition = polar_rows(self.blocks, self.norms)
            doubt = self.total(self.norms * np.minimum(condition, MOST_CONDITION))
        across = np.cross(rows[:, 0], rows[:, 1])
        norms = self.norms[:, None]
        third = np.divide(across, norms, out=np.zeros_like(across), where=norms > 0)
        return np.concatenate([rows, third[:, None]], axis=1), doubt


def nuclear_norms(x: Floats, y: Floats) -> Floats:
    """Return s1 + s2 of the blocks with rows x and y, (..., 3, k) each: (..., k)."""
    x0, x1, x2 = (x[..., axis, :] for axis in range(3))
    y0, y1, y2 = (y[..., axis, :] for axis in range(3))
    across = (x1 * y2 - x2 * y1) ** 2 + (x2 * y0 - x0 * y2) ** 2 + (x0 * y1 - x1 * y0) ** 2
    square = x0 * x0 + x1 * x1 + x2 * x2 + y0 * y0 + y1 * y1 + y2 * y2
    norms: Floats = np.sqrt(square + 2 * np.sqrt(across))
    return norms


def polar_rows(blocks: Floats, norms: Floats) -> tuple[Floats, Floats]:
    """s1 (M M^T)^(-1/2) M of blocks M (a, 2, 3), and its condition s1 / s2 (a,), inf for rank 1.

    The nearest pair of orthonormal rows, times s1. A = M M^T and v = s1 s2 give
    A^(-1/2) = ((tr A + v) I - A) / (v (s1 + s2)).
    """
    v = np.linalg.norm(np.cross(blocks[:, 0], blocks[:, 1]), axis=1)
    A = blocks @ blocks.swapaxes(1, 2)
    trace = A[:, 0, 0] + A[:, 1, 1]
    inverse = (trace + v)[:, None, None] * np.eye(2) - A
    inverse *= (norms / (v * np.sqrt(trace + 2 * v)))[:, None, None]
    condition = np.where(v > 0, norms**2 / v, np.inf)
    return np.where(v[:, None, None] > 0, inverse @ blocks, 0.0), condition


def check_program(
    images: Images, M: Transforms, atoms: Atoms, kept: Flags | None, checks: Checks
) -> Value:
    """Check the program from which the fit starts, or that it is; returns the dual bound.

    kept (n, k): the atoms that each image could use, None for all.
    """
    stated, own = images.columns, images.fit.is_program
    ordered = np.ones(M.images, dtype=bool)
    ordered[M.image[1:][(np.diff(M.atom) <= 0) & (np.diff(M.image) == 0)]] = False
    checks.hold("the transforms are in order", ordered)
    if kept is not None:
        unused = np.ones(M.images, dtype=bool)
        unused[M.image[~kept[M.image, M.atom]]] = False
        checks.hold("atoms that are left out have no transform", unused)
    D = dual_bound(images, stated["dual"], atoms, kept, checks)
    total, orthogonal = M.total(M.norms), images.fit.key("rotations") == "orthogonal"
    turned, doubt = M.completed(orthogonal=orthogonal) if own else (M.blocks, 0.0)
    S = M.combine(turned, atoms)
    X = M.combine(M.blocks, atoms) if own and orthogonal else S[:, :2]
    r, error = residual(images, X, stated["convex_translation"], total, atoms)
    P = objective(images, r, error, total, images.fit.loss)
    gap, before, of = gap_of(images, P, D), *(("", "") if own else ("convex_", "convex "))
    checks.equal(f"{before}objective", f"the {of}objective is P", P.value, P.error)
    claim = f"the {of}gap is (P - D) / P"
    checks.equal(f"{before}relative_gap", claim, gap.value, gap.error)
    if own and not orthogonal:
        left = relative(images, r, error)
        checks.equal("residual", "residual follows from the fit", left.value, left.error)
    if own:
        _check_solution(images, M, r, error, gap, checks)
        size = total + doubt
        allowed = images.allow(size, size)
        check_nearest(stated["rotation"], M.total(turned), total, allowed, checks)
        check_place(images, Value(stated["convex_translation"], np.zeros(M.images)), checks)
        check_points(images, Value(S, allowed * atoms.reach), checks)
    return D


def residual(
    images: Images, projections: Floats, translation: Floats, total: Floats, atoms: Atoms
) -> tuple[Floats, Floats]:
    """Omega o (V - X - T 1^T) (n, 2, p), and a bound (n,) on the error before weighting.

    projections X (n, 2, p) of transforms whose norms sum to total (n,); translation T (n, 2).
    """
    r = images.weights[:, None] * (images.points - projections - translation[..., None])
    far = images.reach + total * atoms.reach + np.abs(translation).max(axis=1)
    return r, images.points_error + images.factor * far


def objective(images: Images, r: Floats, error: Floats, total: Floats, loss: str) -> Value:
    """P of residuals r (n, 2, p) with errors (n,) before weighting, and norms that sum to total."""
    size, beta = np.abs(r), images.fit.beta
    terms, slope = r * r / 2, size
    if loss == "sparse-error":
        terms = np.where(size <= beta, terms, beta * (size - beta / 2))
        slope = np.minimum(size, beta)
    elif loss == "l1":
        terms, slope = size, (images.weights[:, None] > 0).astype(float)
    elif loss == "exact":
        terms, slope = np.zeros_like(r), np.zeros_like(r)
    P = terms.sum(axis=(1, 2)) + images.lam * total
    steep = (slope * images.weights[:, None]).sum(axis=(1, 2))
    bent = (images.weights**2).sum(axis=1)
    return Value(P, steep * error + bent * error**2 + images.allow(P, P))


def relative(images: Images, r: Floats, error: Floats) -> Value:
    """||r||_F over that of the points about their mean, both weighted; r as in `residual`."""
    square = images.weights**2
    norm = np.sqrt(square.sum(axis=1))
    mean = np.einsum("nap,np->na", images.points, square) / (norm**2)[:, None]
    centred = images.weights[:, None] * (images.points - mean[..., None])
    whole = np.sqrt((centred**2).sum(axis=(1, 2)))
    share = np.sqrt((r**2).sum(axis=(1, 2))) / whole
    error = norm * (error + 2 * share * images.points_error) / whole
    return Value(share, error + images.allow(share, 1.0))


def dual_bound(
    images: Images, dual: Floats, atoms: Atoms, kept: Flags | None, checks: Checks
) -> Value:
    """D of the dual Y (n, 2, p); checks that it is feasible.

    The error also covers what a dual loses that is feasible to within rounding, when it is made so.
    """
    n, _, p = dual.shape
    loss, lam = images.fit.loss, images.lam
    bound = {"l1": 1.0, "sparse-error": images.fit.beta}.get(loss)
    weighted, most = dual * images.weights[:, None], np.empty(n)
    for some in (slice(start, start + BLOCK) for start in range(0, n, BLOCK)):
        N = (weighted[some].reshape(-1, p) @ atoms.columns).reshape(-1, 2, 3, atoms.count)
        norms = nuclear_norms(N[:, 0], N[:, 1])
        most[some] = largest(norms if kept is None else np.where(kept[some], norms, 0.0))
    magnitude = np.sqrt((weighted**2).sum(axis=1)).sum(axis=1) * atoms.reach
    slack = images.allow(2 * (magnitude / lam + 1), 1.0)
    checks.add("the dual is feasible", most / lam - 1, slack)
    sizes = np.abs(weighted).sum(axis=2)
    allowed = np.maximum(images.factor[:, None] * sizes, FLOOR * sizes)
    checks.add("the dual is balanced", np.abs(weighted.sum(axis=2)), allowed)
    hidden = np.abs(dual) * (images.weights[:, None] == 0)
    checks.add("the dual is 0 where nothing is seen", hidden, 0.0)
    if bound is not None:
        checks.add("the dual is bounded", largest(np.abs(dual)) / bound - 1, images.allow(lam, 1.0))
    V = images.points
    along = np.einsum("nap,nap->n", weighted, V)
    squared = loss in ("squared", "sparse-error")
    square = np.einsum("nap,nap->n", dual, dual) if squared else np.zeros(n)
    terms = np.einsum("nap,nap->n", np.abs(weighted), np.abs(V)) + square
    error = sizes.sum(axis=1) * images.points_error + images.factor * terms
    error += 2 * slack * (np.abs(along) + square) + allowed.sum(axis=1) * images.reach
    return Value(along - square / 2, error)


def gap_of(images: Images, P: Value, D: Value) -> Value:
    """Return (P - D) / P; 0 where both are 0."""
    none = (P.value == 0) & (D.value == 0)
    gap = np.where(none, 0.0, (P.value - D.value) / P.value)
    error = (P.error * np.abs(D.value) / P.value + D.error) / P.value
    return Value(gap, np.where(none, 0.0, error) + images.allow(np.abs(gap), 1.0))


def check_active(images: Images, checks: Checks) -> None:
    """Check how many coefficients are not negligible; those at the limit may count or not."""
    size, stated = np.abs(images.columns["coefficients"]), images.columns["active_atoms"]
    limit = ACTIVE * largest(size)[:, None]
    surely = (size > limit * (1 + FLOOR)).sum(axis=1)
    perhaps, more = surely.copy(), np.flatnonzero(stated > surely)
    perhaps[more] = (size[more] > limit[more] * (1 - FLOOR)).sum(axis=1)
    off = np.maximum(surely - stated, stated - perhaps)
    checks.add("active_atoms follow from the coefficients", off, 0.0, "active_atoms")


def check_place(images: Images, T: Value, checks: Checks) -> None:
    """Check that scale is the size (n,), and translation size x T + centroid, T (n, 2)."""
    check_scale(images, checks)
    far = images.size * (np.abs(T.value).max(axis=1) + 1)
    found = images.size[:, None] * T.value + images.centroid
    allowed = images.allow(3 * images.extent + far, images.extent + far) + images.size * T.error
    checks.equal("translation", "translation follows from the fit", found, allowed)


def check_scale(images: Images, checks: Checks) -> None:
    """Check that scale is the size (n,) of the landmarks."""
    allowed = images.allow(3 * images.extent, images.size)
    checks.equal("scale", "scale follows from the landmarks", images.size, allowed)


def check_points(images: Images, shapes: Value, checks: Checks) -> None:
    """Check that the shapes (n, 3, p) are scale x shapes + translation on x and y."""
    scale, translation = images.columns["scale"], images.columns["translation"]
    expected = scale[:, None, None] * shapes.value
    expected[:, :2] += translation[..., None]
    size = scale * largest(np.abs(shapes.value)) + np.abs(translation).max(axis=1)
    allowed = scale * shapes.error + images.allow(size, size)
    checks.equal("shapes", "shapes follow from the fit", expected, allowed)


def _check_solution(
    images: Images, M: Transforms, r: Floats, error: Floats, gap: Value, checks: Checks
) -> None:
    """Check status, coefficients and labels of images with transforms of residuals r."""
    fit, stated, total = images.fit, images.columns, M.total(M.norms)
    exact, words = fit.loss == "exact", stated["status"].astype(str)
    off, allowed = gap.value, gap.error
    if exact:
        left = relative(images, r, error)
        off, allowed = np.maximum(np.abs(off), left.value), np.maximum(allowed, left.error)
    claim = "an optimal image is within the tolerance"
    checks.add(claim, off - fit.tolerance, allowed, "status", words == OPTIMAL)
    beyond = ~(stated["relative_gap"] <= fit.tolerance)
    beyond |= ~(stated["residual"] <= fit.tolerance) if exact else False
    checks.hold("an image at the iteration limit is not optimal", beyond, of=words == LIMITED)
    c = np.zeros((M.images, M.atoms))
    c[M.image, M.atom] = M.norms
    claim = "coefficients follow from the transforms"
    checks.equal("coefficients", claim, c, images.allow(total, total))
    checks.settled.update(("transform_count", "transform_atom", "active_transforms"))
    checks.settled.update(("dual", "convex_translation"))
    check_active(images, checks)
    _check_tight(images, M, checks)
    if "transforms" in stated:
        dense = np.zeros((M.images, M.atoms, 2, 3))
        dense[M.image, M.atom] = M.blocks
        checks.equal("transforms", "transforms are the active ones", dense, 0.0)
    if fit.loss in ("l1", "sparse-error") and "outliers" in stated:
        _check_outliers(images, r, error, checks)


def _check_tight(images: Images, M: Transforms, checks: Checks) -> None:
    """Check that a fit is called tight where all active M_i / c_i have orthonormal rows.

    What lies at the limit to within rounding can be called either.
    """
    x, y, square = M.blocks[:, 0], M.blocks[:, 1], M.norms**2
    xx, yy, xy = (np.einsum("ai,ai->a", *pair) / square for pair in ((x, x), (y, y), (x, y)))
    apart = np.sqrt((xx - 1) ** 2 + (yy - 1) ** 2 + 2 * xy**2)
    error = FLOOR + images.factor[M.image]
    active = M.norms > ACTIVE * largest(images.columns["coefficients"])[M.image]
    some = np.bincount(M.image[active], minlength=M.images) > 0

    def all_within(limit: Floats) -> Flags:
        within = np.ones(M.images, dtype=bool)
        within[M.image[active & (apart > limit)]] = False
        return within & some

    surely, perhaps = all_within(ORTHOGONAL - error), all_within(ORTHOGONAL + error)
    right = np.where(images.columns["tight"] != 0, perhaps, ~surely)
    checks.hold("tight follows from the transforms", right, "tight")


def _check_outliers(images: Images, r: Floats, error: Floats, checks: Checks) -> None:
    """Check that outliers are the landmarks with a weighted residual beyond beta."""
    weights, beta = images.weights, images.fit.beta
    labelled = images.columns["outliers"] != 0
    beyond = np.abs(r).max(axis=1) - beta
    off = np.where(weights > 0, np.where(labelled, -beyond, beyond), 0.0)
    off[labelled & (weights == 0)] = np.inf
    allowed = weights * error[:, None] + FLOOR * beta
    checks.add("outliers are beyond beta", off, allowed, "outliers")
