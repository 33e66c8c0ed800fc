"""What follows from shapes and their error bars: landmarks fitted, place, verdict, other points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.verification.checks import FLOOR, Checks, largest
from shapefit.verification.fit import LIMITED, Images, seen_in
from shapefit.verification.program import (
    Atoms,
    Value,
    check_active,
    check_place,
    check_points,
    check_scale,
    gap_of,
    objective,
    relative,
    residual,
)

SINGLE = 2.0**-23
"""Rounding of correlations, which are stored in single precision."""
VIEWED = 6
"""Numbers of a view: rotation, scale, translation."""
PAIRS = ((0, 1), (0, 2), (1, 2))
"""Coordinates of a landmark, in the order of the correlations."""
DOUBTS = (
    "too few landmarks seen",
    "implausible landmarks",
    "near and far not told apart",
    "wide error bars",
    "not optimal",
)
"""Why an image is not trusted: the first of these that holds."""


def check_one_rotation(
    images: Images, atoms: Atoms, kept: Flags | None, D: Value | None, checks: Checks
) -> None:
    """Check a shape R sum_i c_i B_i, and its gap to the bound D if there is one."""
    images = replace(images, weights=images.inliers)
    stated, n = images.columns, len(images.fitted)
    c, R = stated["coefficients"], stated["rotation"]
    R = np.where(np.isfinite(R), R, 0.0)
    total = np.abs(c).sum(axis=1)
    S = R @ (c @ atoms.rows.reshape(atoms.count, -1)).reshape(n, 3, -1)
    shapes = Value(S, images.allow(2 * total, total) * atoms.reach)
    turned = checks.fitted & (total > 0)
    checks.hold(
        "a shape has a rotation", np.isfinite(stated["rotation"]).all(axis=(1, 2)), of=turned
    )
    checks.settled.update(("rotation", "coefficients"))
    check_active(images, checks)
    if "transforms" in stated:
        found, claim = c[:, :, None, None] * R[:, None, :2], "transforms are those of the rotation"
        checks.equal("transforms", claim, found, images.allow(total, total))
    if kept is not None:
        unused = ~(~kept & (c != 0)).any(axis=1)
        checks.hold("atoms that are left out have no coefficient", unused)
    if images.fit.perspective:
        check_camera(images, shapes, checks)
        check_points(images, shapes, checks)
        return
    square = images.weights**2
    T = np.einsum("nap,np->na", images.points - S[:, :2], square) / square.sum(axis=1)[:, None]
    r, error = residual(images, S[:, :2], T, total, atoms)
    P = objective(images, r, error + shapes.error, total, "squared")
    check_place(images, Value(T, error + shapes.error), checks)
    check_points(images, shapes, checks)
    checks.equal("objective", "the objective is that of the fit", P.value, P.error)
    if D is not None and images.fit.has_gap:
        gap = gap_of(images, P, D)
        checks.equal("relative_gap", "the gap is that to the dual", gap.value, gap.error)


def check_camera(images: Images, S: Value, checks: Checks) -> None:
    """Check scale, translation and fitted landmarks under u = centre + focal X_xy / (sign X_z).

    X = S + t, for shapes S (n, 3, p) in the frame of the camera and t the camera's translation.
    scale is the geometric mean of focal / depth at t, translation where t is seen.
    """
    stated = images.columns
    t, focal, centre = (stated[name] for name in ("camera_translation", "focal", "principal_point"))
    sign = 1.0 if str(stated["y_axis"]) == "down" else -1.0
    depth = sign * t[:, 2]
    scale = np.sqrt(focal[:, 0] * focal[:, 1]) / depth
    origin = centre + focal * t[:, :2] / depth[:, None]
    X = S.value + t[..., None]
    z = sign * X[:, 2]
    along = X[:, :2] / z[:, None]
    fitted = centre[..., None] + focal[..., None] * along
    far = np.abs(S.value).max(axis=(1, 2)) + np.abs(t).max(axis=1)
    error = (S.error + images.allow(far, far))[:, None] / np.abs(z)
    ray = focal[..., None] * (error[:, None] * (1 + np.abs(along)))
    size = images.extent + np.abs(centre).max(axis=1)
    pixel = images.allow(size, size)[:, None]
    place = pixel + images.allow(np.ones(len(t)), 1.0)[:, None] * (
        focal * (1 + np.abs(t[:, :2]) / depth[:, None])
    )
    checks.equal("scale", "scale follows from the camera", scale, images.allow(scale, scale))
    checks.equal("translation", "translation follows from the camera", origin, place)
    claim = "landmarks_fitted follow from the camera"
    checks.equal("landmarks_fitted", claim, fitted, pixel[..., None] + ray)
    checks.settled.update(("focal", "camera_translation", "principal_point"))


def check_seen(images: Images, A: Floats, checks: Checks) -> None:
    """Check the points seen, A S for the map A (p, p) of the landmarks: those fitted, their place.

    A method without coefficients states no more of its shapes.
    """
    stated, fit = images.columns, images.fit
    shapes, scale = stated["shapes"], stated["scale"]
    seen = shapes @ A.T
    if fit.perspective:
        if fit.has_posterior:
            middle = np.pad(stated["translation"], ((0, 0), (0, 1)))[..., None]
            S = (seen - middle) / scale[:, None, None]
            check_camera(
                images, Value(S, images.allow(largest(np.abs(shapes)) / scale, 0.0)), checks
            )
        return
    far = largest(np.abs(seen))
    claim = "landmarks_fitted are x and y of the shapes"
    checks.equal("landmarks_fitted", claim, seen[:, :2], images.allow(far, far))
    if not (fit.is_program or fit.has_one_rotation):
        check_scale(images, checks)


def check_residual(images: Images, checks: Checks) -> None:
    """Check the relative residual of the landmarks fitted, the weighted ones that were kept."""
    stated, fit = images.columns, images.fit
    if "residual" not in stated or fit.method == "sequences" or "residual" in checks.settled:
        return
    if fit.perspective and not fit.has_posterior:
        return
    r = (
        images.points
        - (stated["landmarks_fitted"] - images.centroid[..., None]) / (images.size[:, None, None])
    )
    if fit.has_one_rotation:
        images = replace(images, weights=images.inliers)
    r = images.weights[:, None] * np.where(images.weights[:, None] > 0, r, 0.0)
    far = images.points_error + images.factor * images.extent / images.size
    left = relative(images, r, far + FLOOR * images.reach)
    checks.equal("residual", "residual follows from the landmarks", left.value, left.error)


def check_bars(images: Images, checks: Checks) -> None:
    """Check error bars: finite, of a covariance, with correlations; chances; and the verdict."""
    stated, everyone = images.columns, np.ones_like(images.fitted)
    sd, weighed = stated["shape_sd"], images.weights > 0
    with_bars = np.isfinite(sd).all(axis=(1, 2)) & (sd >= 0).all(axis=(1, 2))
    checks.hold("shape_sd is finite and not negative", with_bars)
    if "input_shape_sd" in stated:
        own = stated["input_shape_sd"]
        finite = (np.isfinite(own) & (own >= 0)).all(axis=(1, 2))
        checks.hold("input_shape_sd is finite and not negative", finite)
    for name in ("shape_correlation", "input_shape_correlation"):
        if name in stated:
            within = (np.abs(stated[name]) <= 1 + SINGLE).all(axis=(1, 2))
            checks.hold(f"{name} is within -1 and 1", within)
    if "shape_covariance" in stated:
        _check_covariance(images, checks)
    belief, p = stated["belief"], stated["plausibility"]
    chance = np.where(weighed, (belief >= 0) & (belief <= 1), np.isnan(belief)).all(axis=1)
    checks.hold("belief is a chance of each landmark seen", chance)
    some = weighed.sum(axis=1) > VIEWED // 2
    checks.hold(
        "plausibility is a chance where 4 landmarks are seen",
        np.where(some, (p >= 0) & (p <= 1), np.isnan(p)),
    )
    off = np.abs(stated["log_evidence"] + stated["objective"])
    checks.add("objective is -log_evidence", off, FLOOR * np.abs(stated["objective"]))
    if "trusted" in stated and "doubt" in stated:
        good = np.zeros_like(everyone)
        for nearly in (1 - FLOOR, 1 + FLOOR):
            doubt = find_doubts(images, nearly)
            good |= (stated["doubt"].astype(str) == doubt) & (stated["trusted"] == (doubt == ""))
        checks.hold("trusted and doubt follow from bars", good, "trusted doubt", everyone)


def find_doubts(images: Images, nearly: float) -> np.ndarray[tuple[int], np.dtype[np.str_]]:
    """Why each image (n,) is not trusted, "" where it is; limits are multiplied by `nearly`.

    The bars mean_j sqrt(sum_a sd_aj^2) are wide beside the spread of the shape, the root of the
    mean variance of its coordinates.
    """
    stated, fit = images.columns, images.fit
    spread = np.sqrt(stated["shapes"].var(axis=2).mean(axis=1))
    bar = np.sqrt((stated["shape_sd"] ** 2).sum(axis=1)).mean(axis=1)
    widest = fit.key("posterior.widest", np.inf)
    reasons = (
        2 * seen_in(stated).sum(axis=1) <= VIEWED,
        stated["plausibility"] < fit.key("posterior.implausible", 0.0) * nearly,
        np.full(len(bar), fit.depth_is_open),
        ~(bar <= widest * nearly * spread),
        stated["status"].astype(str) == LIMITED,
    )
    doubt = np.select(reasons, DOUBTS, "")
    return np.asarray(np.where(images.fitted, doubt, "no shape"))


def _check_covariance(images: Images, checks: Checks) -> None:
    """Check covariances (n, 3p, 3p), x, y, z of one landmark after the other, against the bars."""
    stated = images.columns
    sd, C = stated["shape_sd"], stated["shape_covariance"]
    n, _, p = sd.shape
    most = largest(sd**2)
    j = np.arange(p)
    own = np.moveaxis(C.reshape(n, p, 3, p, 3)[:, j, :, j], 0, -1)  # (n, 3, 3, p)
    scale = sd[:, :, None] * sd[:, None]
    found = np.zeros((n, 3, 3, p))
    found[:, range(3), range(3)] = 1.0
    for row, (a, b) in enumerate(PAIRS):
        found[:, a, b] = found[:, b, a] = stated["shape_correlation"][:, row]
    allowed = 4 * SINGLE * scale + FLOOR * most[:, None, None, None]
    checks.add(
        "shape_covariance has the deviations and correlations", np.abs(own - found * scale), allowed
    )
    off = np.abs(C - C.swapaxes(1, 2))
    checks.add("shape_covariance is symmetric", off, 1e-6 * most)
    least = np.zeros(n)
    good = np.isfinite(C).all(axis=(1, 2))
    least[good] = np.linalg.eigvalsh(C[good])[:, 0]
    checks.hold("shape_covariance has no negative variance", good & (least >= -1e-6 * most * p))


def check_inputs(images: Images, rows: Floats, checks: Checks) -> None:
    """Check the landmarks of the files in 3D: weights `rows` (m, p) of the shapes."""
    shapes, claim = images.columns["shapes"], "input_shapes follow from the shapes"
    far = largest(np.abs(shapes)) * (1 + np.abs(rows).sum(axis=1).max(initial=0.0))
    checks.equal("input_shapes", claim, shapes @ rows.T, images.allow(far, far))


def check_metres(images: Images, found: Floats, checks: Checks) -> None:
    """Check the metres (n,) in one unit of each shape: as large as the training shapes were."""
    stated, allowed = images.columns["metres_per_unit"], images.allow(found, found)
    off = np.where(np.isnan(stated) & np.isnan(found), 0.0, np.abs(stated - found))
    allowed = np.where(np.isnan(found), 0.0, allowed)
    checks.add("metres_per_unit follow from the shapes", off, allowed, "metres_per_unit")


def check_position(images: Images, unit: Floats, checks: Checks) -> None:
    """Check the camera's translation in the dictionary's unit, of which one is `unit` (n,)."""
    found = unit[:, None] * images.columns["camera_translation"]
    far, claim = largest(np.abs(found)), "position follows from the camera_translation"
    checks.equal("position", claim, found, images.allow(far, far))
