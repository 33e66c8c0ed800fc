"""Claims of a result: the certificate of the convex program, the ranges of datasets.

    P = f(Omega o (V - sum_i M_i B_i - T 1^T)) + lambda sum_i ||M_i||_2
    D = <Y, Omega o V> - delta / 2 ||Y||_F^2

    where Y omega = 0, ||(Y o Omega) B_i^T||_* <= lambda for all i,
    |Y| <= the bound of the loss

V are the normalised landmarks; delta is 1 for the losses squared and sparse-error, else
0. The shape is scale sum_i c_i R_i B_i + translation, c_i = ||M_i||_2 and R_i the rows
of M_i / c_i and their cross product; with one rotation R of all atoms M_i = c_i Rbar,
and D bounds its objective, too.

With g = ||x||^2 + ||y||^2 = s1^2 + s2^2 and v = ||x cross y|| = s1 s2 the nuclear norm
of the rows x, y is sqrt(g + 2 v).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shapefit.arrays import Flags, Floats
from shapefit.geometry.normalisation import normalise

CLAIM_TOLERANCE = 1e-9
"""Share of its size by which a number may be off from that which is computed again."""

ORTHONORMAL_WITHIN = 1e-8
"""By which entries of R^T R may differ from those of the identity."""

SUM_ROUNDING = 64 * 2.0**-53
"""Share of the magnitudes of its terms by which a sum may be off, in the fit and here.
"""

Numeric = NDArray[Any]
"""Values as a file has them, numbers of any type."""

ImageColumns = Mapping[str, Numeric]
"""Datasets of n images by name; points one a column, (n, 3, p) or (n, 2, p)."""

STATUS_WITHOUT_SHAPE = ("degenerate input", "numerical failure")
STATUS_WITH_SHAPE = ("optimal", "converged", "iteration limit")

POSITIVE = (np.nextafter(0.0, 1.0), np.inf)
NOT_NEGATIVE = (0.0, np.inf)
SHARE_RANGE = (0.0, 1.0)
CORRELATION_RANGE = (-1.0 - 2.0**-23, 1.0 + 2.0**-23)  # in single precision
FINITE = (-np.inf, np.inf)

RANGES: Mapping[tuple[float, float], str] = {
    POSITIVE: "scale lambda metres_per_unit focal",
    NOT_NEGATIVE: (
        "shape_sd input_shape_sd active_atoms iterations residual expected_error "
        "image_error"
    ),
    SHARE_RANGE: "p_value inlier_probability trusted tight outliers",
    CORRELATION_RANGE: "shape_correlation input_shape_correlation",
    FINITE: (
        "shapes input_shapes landmarks_fitted coefficients translation objective "
        "log_evidence camera_translation principal_point shape_covariance"
    ),
}
"""(least, greatest) -> datasets with finite numbers in this range, or nan."""

CERTIFICATE = "dual convex_translation transform_count transform_atom active_transforms"
"""Datasets that certify the optimum of the convex program."""


class CertifiedProgram(NamedTuple):
    """The convex program of a fit.

    atoms B (k, 3, p), and the items of the training shapes that they are, where they
    are such; refined: the shapes have one rotation, refined from the solution of the
    program; has_bound: their objective has a gap to its bound; hides_outliers:
    landmarks labelled outliers have no weight; loss, with the threshold beta; tolerance
    of the relative gap.
    """

    atoms: Floats
    atom_items: Sequence[str] | None
    refined: bool
    has_bound: bool
    hides_outliers: bool
    loss: str
    beta: float
    tolerance: float


class ProgramImages(NamedTuple):
    """n images as the program has them: landmarks = size x points + centroid.

    points V (n, 2, p), 0 where hidden; weights omega (n, p); centroid (n, 2); size, lam
    (n,); retained (n, k): the atoms that an image may use, None for all.
    """

    points: Floats
    weights: Floats
    centroid: Floats
    size: Floats
    lam: Floats
    retained: Flags | None


def check_certificate(
    columns: ImageColumns, program: CertifiedProgram, claims: Claims
) -> Flags:
    """Check the certificates of n images; return which images (n,) have one.

    A certificate is the dual point, the objective, its gap, and the shape that these
    belong to; an image whose gap is nan has none. All are computed again. Where a
    number differs from what the file states, that is noted in `claims`.
    """
    images = normalise_images(columns, program)
    k, _, p = program.atoms.shape
    n = len(images.size)
    rows = program.atoms.reshape(3 * k, p)
    prefix = "convex_" if program.refined else ""
    gap = stated_gap(columns, program)
    states_gap = np.asarray(claims.fitted & np.isfinite(gap))
    M, c = build_transforms(columns, n, k, claims)
    D = check_dual(images, columns["dual"], program, claims, states_gap)
    T = columns["convex_translation"]
    X = (M.swapaxes(1, 2).reshape(2 * n, -1) @ rows).reshape(n, 2, p)
    P = objective(images, X, T, c.sum(axis=1), program)
    stated = (columns[f"{prefix}objective"], gap)
    check_gap(P, D, stated, prefix, claims, states_gap)
    if images.retained is not None:
        is_right = images.retained | (c == 0)
        claims.hold("atoms that are left out have no coefficient", is_right)
    if not program.refined:
        is_optimal = columns["status"].astype(str) == "optimal"
        claims.near(
            "the gap of an optimal image is within the tolerance",
            np.abs(gap),
            program.tolerance + CLAIM_TOLERANCE,
            where=claims.fitted & is_optimal,
        )
        third = np.nan_to_num(np.cross(M[:, :, 0], M[:, :, 1]) / c[..., None])
        turned = np.concatenate([M, third[:, :, None]], axis=2)
        S = (turned.swapaxes(1, 2).reshape(3 * n, -1) @ rows).reshape(n, 3, p)
        check_shapes(columns, images, c, S, T, claims)
    elif program.has_bound:
        check_refined(columns, images, program, D, claims, states_gap)
    return states_gap


def check_refined(
    columns: ImageColumns,
    images: ProgramImages,
    program: CertifiedProgram,
    D: Floats,
    claims: Claims,
    where: Flags,
) -> None:
    """Check shapes with one rotation, their objective and its gap to the bound D (n,).

    They must be what coefficients and rotations give; gaps are checked of the images
    `where` (n,).
    """
    k, _, p = program.atoms.shape
    c = columns["coefficients"]
    R = np.nan_to_num(columns["rotation"])
    S = R @ (c @ program.atoms.reshape(k, -1)).reshape(len(c), 3, p)
    square = images.weights**2
    total = np.einsum("nap,np->na", images.points - S[:, :2], square)
    T = total / square.sum(1)[:, None]
    P = objective(images, S[:, :2], T, np.abs(c).sum(axis=1), program)
    stated = (columns["objective"], columns["relative_gap"])
    check_gap(P, D, stated, "", claims, where)
    check_shapes(columns, images, c, S, T, claims)


def build_transforms(
    columns: ImageColumns, n: int, k: int, claims: Claims
) -> tuple[Floats, Floats]:
    """Return the transforms M (n, k, 2, 3) of a result and their spectral norms (n, k).

    Checks that they are finite; those that are not count as 0.
    """
    image = np.repeat(np.arange(n), columns["transform_count"])
    # Of an atom that is not there another one is taken, with which the objective is
    # false.
    atom = columns["transform_atom"] % k
    transforms = columns["active_transforms"]
    is_finite = np.asarray(np.isfinite(transforms).all(axis=(1, 2)))
    M = np.zeros((n, k, 2, 3))
    M[image, atom] = np.where(is_finite[:, None, None], transforms, 0.0)
    are_finite = np.ones(n, bool)
    are_finite[image[~is_finite]] = False
    claims.hold("transforms are finite", are_finite, where=np.ones(n, bool))
    c = np.zeros((n, k))
    c[image, atom] = np.linalg.norm(M[image, atom], 2, axis=(1, 2))
    return M, c


def stated_gap(columns: ImageColumns, program: CertifiedProgram) -> Floats:
    """Return the relative gap (n,) of the convex program that a result states."""
    name = "convex_relative_gap" if program.refined else "relative_gap"
    return np.asarray(columns[name])


def normalise_images(columns: ImageColumns, program: CertifiedProgram) -> ProgramImages:
    """Weigh and normalise the landmarks of n images of a result.

    omega is the confidence, 1 without one, and 0 where a landmark is unseen or was set
    aside as an outlier.
    """
    landmarks = columns["landmarks"]
    visible = np.isfinite(landmarks).all(axis=1)
    confidence = columns.get("confidence", visible)
    weights = np.asarray(np.where(visible, confidence, 0.0), dtype=np.float64)
    if program.hides_outliers and "outliers" in columns:
        weights = np.where(columns["outliers"] != 0, 0.0, weights)
    normalised = normalise(landmarks, np.asarray(weights > 0))
    retained = None
    if "omitted" in columns and program.atom_items is not None:
        items = np.array(program.atom_items, dtype=str)
        retained = columns["omitted"].astype(str)[:, None] != items
    return ProgramImages(
        points=normalised.points,
        weights=weights,
        centroid=normalised.centroid,
        size=normalised.scale,
        lam=columns["lambda"],
        retained=retained,
    )


def objective(
    images: ProgramImages,
    X: Floats,
    T: Floats,
    total: Floats,
    program: CertifiedProgram,
) -> tuple[Floats, Floats]:
    """Return the objective P (n,) of projections X moved by T, and its scale (n,).

    X (n, 2, p), the projections, at the translations T (n, 2); total (n,), the sum of
    the norms of transforms. Differences are to be compared with the size: P and the
    objective without a shape.
    """
    beta = program.beta

    def loss(r: Floats) -> Floats:
        """Return f(Omega o r) (n,) of residuals r (n, 2, p)."""
        size = np.abs(images.weights[:, None] * r)
        f = size**2 / 2
        if program.loss == "sparse-error":
            f = np.where(size <= beta, f, beta * (size - beta / 2))
        elif program.loss == "l1":
            f = size
        return np.asarray(f.sum(axis=(1, 2)))

    P = loss(images.points - X - T[..., None]) + images.lam * total
    return P, P + loss(images.points)


def check_dual(
    images: ProgramImages,
    Y: Floats,
    program: CertifiedProgram,
    claims: Claims,
    where: Flags,
) -> Floats:
    """Check that dual points Y (n, 2, p) are feasible; return their bounds D (n,).

    They are checked for the images `where` (n,).
    """
    n, _, p = Y.shape
    k = len(program.atoms)
    columns = np.ascontiguousarray(program.atoms.transpose(2, 1, 0).reshape(p, 3 * k))
    weighted = Y * images.weights[:, None]
    products = (weighted.reshape(-1, p) @ columns).reshape(n, 2, 3, k)
    norms = nuclear_norms(products[:, 0], products[:, 1])
    if images.retained is not None:
        norms = norms * images.retained
    most = largest_of_images(norms)
    farthest = np.sqrt((program.atoms**2).sum(axis=1)).max()
    lengths = np.sqrt((weighted**2).sum(axis=1))
    terms = lengths.sum(axis=1) * farthest / images.lam
    tolerance = CLAIM_TOLERANCE + SUM_ROUNDING * terms
    claims.near("the dual point is feasible", most / images.lam - 1, tolerance, where)
    sums = np.abs(weighted.sum(axis=2))
    sizes = np.abs(weighted).sum(axis=2).max(axis=1)
    claims.near("the dual point is balanced", sums, CLAIM_TOLERANCE * sizes, where)
    bound = np.inf
    if program.loss == "l1":
        bound = 1.0
    elif program.loss == "sparse-error":
        bound = program.beta
    difference = np.abs(Y).max(axis=(1, 2)) / bound - 1
    claims.near(
        "the dual point is within the bound of the loss", difference, where=where
    )
    along = np.einsum("nap,nap->n", weighted, images.points)
    delta = 0.0 if program.loss == "l1" else 1.0
    return np.asarray(along - delta / 2 * (Y**2).sum(axis=(1, 2)))


def check_gap(
    objective: tuple[Floats, Floats],
    D: Floats,
    stated: tuple[Floats, Floats],
    prefix: str,
    claims: Claims,
    where: Flags,
) -> None:
    """Check that stated objectives and gaps are P and (P - D) / P, computed again.

    objective: P and the size of its terms; D, the bound; stated: objective and gap as
    the result has them, (n,) each; prefix of their names; where: images with a gap.
    0 / 0 is 0.
    """
    P, size = objective
    stated_objective, stated_gap = stated
    text = f"{prefix}objective is that of the shape"
    claims.near(text, np.abs(stated_objective - P), CLAIM_TOLERANCE * size, where)
    is_nothing = (P == 0) & (D == 0)
    gap = np.where(is_nothing, 0.0, (P - D) / P)
    gap_size = np.where(is_nothing, 1.0, 1 + np.abs(gap) + size / P)
    text = f"{prefix}relative_gap is that between objective and dual point"
    claims.near(text, np.abs(stated_gap - gap), CLAIM_TOLERANCE * gap_size, where)


def check_shapes(
    columns: ImageColumns,
    images: ProgramImages,
    c: Floats,
    S: Floats,
    T: Floats,
    claims: Claims,
) -> None:
    """Check coefficients, scale, translation and shapes of a result against c, S, T.

    c (n, k), the coefficients; S (n, 3, p) and T (n, 2), shapes and translations in
    normalised units, which the landmarks' size and centroid bring into their own.
    """
    size = images.size
    place = size[:, None] * T + images.centroid
    distance = largest_of_images(np.abs(images.centroid)) + size * largest_of_images(
        np.abs(T)
    )
    rounding = SUM_ROUNDING * distance
    X = size[:, None, None] * S
    X[:, :2] += place[..., None]
    claims.near(
        "coefficients are those of the transforms",
        np.abs(columns["coefficients"] - c),
        CLAIM_TOLERANCE * (1 + largest_of_images(np.abs(c))),
    )
    claims.near(
        "scale is the size of the landmarks",
        np.abs(columns["scale"] / size - 1),
        CLAIM_TOLERANCE,
    )
    claims.near(
        "translation is that of the shape",
        np.abs(columns["translation"] - place),
        CLAIM_TOLERANCE * size + rounding,
    )
    shape_tolerance = CLAIM_TOLERANCE * (1 + largest_of_images(np.abs(S)))
    claims.near(
        "shapes are those of the certificate",
        np.abs(columns["shapes"] - X),
        shape_tolerance * size + rounding,
    )


def nuclear_norms(x: Floats, y: Floats) -> Floats:
    """Return s1 + s2 of the blocks with rows x and y, (..., 3, k) each: (..., k)."""
    x0, x1, x2 = (x[..., axis, :] for axis in range(3))
    y0, y1, y2 = (y[..., axis, :] for axis in range(3))
    z0 = x1 * y2 - x2 * y1
    z1 = x2 * y0 - x0 * y2
    z2 = x0 * y1 - x1 * y0
    across = z0**2 + z1**2 + z2**2
    square = x0 * x0 + x1 * x1 + x2 * x2 + y0 * y0 + y1 * y1 + y2 * y2
    return np.asarray(np.sqrt(square + 2 * np.sqrt(across)))


class Claims:
    """What is claimed of n images, of which `fitted` (n,) have a shape.

    missed (n,): the images for which a claim is false; reasons: the first such claim of
    each.
    """

    def __init__(self, fitted: Flags) -> None:
        self.fitted = fitted
        self.missed: Flags = np.zeros_like(fitted)
        self.reasons: dict[int, str] = {}

    def near(
        self,
        text: str,
        difference: Floats,
        tolerance: ArrayLike = CLAIM_TOLERANCE,
        where: Flags | None = None,
    ) -> None:
        """Check the claim that differences (n, ...) are at most `tolerance` (n,).

        Images for which it is false, as for nan, join `missed`. text: the claim in
        words; where (n,): the images of which it is claimed, by default those with a
        shape.
        """
        if where is None:
            where = self.fitted
        difference = largest_of_images(np.asarray(difference, dtype=np.float64))
        is_near = difference <= np.asarray(tolerance)  # nan is not
        false = where & ~is_near
        for image in np.flatnonzero(false & ~self.missed).tolist():
            off = f"off by {difference[image]:.2g}"
            self.reasons[image] = f"not true: {text}; {off}"
        self.missed |= false

    def hold(self, text: str, holds: ArrayLike, where: Flags | None = None) -> None:
        """Check the claim that `holds` (n, ...) is true; the rest as in `near`."""
        self.near(text, np.where(holds, 0.0, np.inf), 0.0, where)


def largest_of_images(values: Floats) -> Floats:
    """Return the largest value of each image (n,), nan where any of its values is.

    values (n, ...); -inf for an image without values.
    """
    axes = tuple(range(1, values.ndim))
    return np.asarray(values.max(axis=axes, initial=-np.inf))


def check_ranges(columns: ImageColumns, claims: Claims) -> None:
    """Check that numbers are in their `RANGES`, rotations proper, shapes whole or nan.

    And that the status says whether there is a shape.
    """
    for (low, high), names in RANGES.items():
        for name in columns.keys() & set(names.split()):
            values = np.asarray(columns[name], dtype=np.float64)
            is_inside = (values >= low) & (values <= high) & np.isfinite(values)
            claims.hold(f"{name} is in its range", is_inside | np.isnan(values))
    everyone = np.ones_like(claims.fitted)
    is_absent = np.isnan(columns["shapes"]).all(axis=(1, 2))
    claims.hold("a shape is whole or absent", is_absent | claims.fitted, where=everyone)
    status = columns["status"].astype(str)
    is_right = np.where(
        claims.fitted,
        np.isin(status, STATUS_WITH_SHAPE),
        np.isin(status, STATUS_WITHOUT_SHAPE),
    )
    claims.hold("the status says whether there is a shape", is_right, where=everyone)
    R = columns["rotation"]
    has_rotation = np.asarray(~np.isnan(R).all(axis=(1, 2)))
    difference = np.abs(R.swapaxes(1, 2) @ R - np.eye(3))
    claims.near(
        "the rotation is orthonormal",
        difference,
        ORTHONORMAL_WITHIN,
        where=has_rotation,
    )
    claims.hold("the rotation is proper", np.linalg.det(R) > 0, where=has_rotation)
