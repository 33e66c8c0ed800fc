"""What follows from shapes and error bars: landmarks fitted, camera, residual, other points."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats
from shapefit.verification.checks import FLOOR, Checks, largest
from shapefit.verification.fit import Images
from shapefit.verification.program import Sum, check_scale

SINGLE = 2.0**-23
"""Rounding of correlations, which are stored in single precision."""
FREEDOM = 3
"""Landmarks up to which some view of any shape fits, so that nothing is implausible."""
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Coordinates of a landmark: variances, then pairs in the order of the correlations."""


def check_camera(images: Images, S: Sum, checks: Checks) -> None:
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
    far = largest(np.abs(S.value)) + largest(np.abs(t))
    error = (images.allow(2 * S.terms, far) / np.abs(z).min(axis=1))[:, None, None]
    pixel = FLOOR * (largest(np.abs(stated["landmarks_fitted"])) + largest(np.abs(centre)))
    place = pixel[:, None] + FLOOR * focal * (1 + np.abs(t[:, :2]) / depth[:, None])
    ray = focal[..., None] * error * (1 + np.abs(along))
    checks.equal("scale", "the camera", scale, FLOOR * np.abs(scale))
    checks.equal("translation", "the camera", origin, place)
    checks.equal("landmarks_fitted", "the camera", fitted, pixel[:, None, None] + ray)
    checks.settled.update(("focal", "camera_translation", "principal_point"))


def check_seen(images: Images, A: Floats, shape: Sum | None, checks: Checks) -> None:
    """Check the landmarks fitted: A S as the camera sees it, for the map A (p, p) of the landmarks.

    shape S in the camera's frame and normalised units, where coefficients give it.
    """
    stated, fit = images.columns, images.fit
    shapes, scale = stated["shapes"], stated["scale"]
    seen = shapes @ A.T
    if fit.perspective:
        if fit.has_posterior:
            middle = np.pad(stated["translation"], ((0, 0), (0, 1)))[..., None]
            S = (seen - middle) / scale[:, None, None]
            shape = Sum(S, largest(np.abs(shapes)) / scale)
        if shape is not None:
            check_camera(images, shape, checks)
        return
    far = largest(np.abs(seen))
    checks.equal("landmarks_fitted", "x and y of the shapes", seen[:, :2], images.allow(far, far))
    if "scale" not in checks.settled:  # a method without coefficients
        check_scale(images, checks)


def check_residual(images: Images, checks: Checks) -> None:
    """Check ||r||_F over that of the points about their mean, both weighted by what was kept.

    r = V - (landmarks_fitted - centroid) / size.
    """
    stated, fit, V = images.columns, images.fit, images.points
    if "residual" not in stated or fit.method == "sequences":
        return
    if fit.perspective and not fit.has_posterior:
        return
    omega = images.inliers if fit.has_one_rotation else images.weights
    fitted = (stated["landmarks_fitted"] - images.centroid[..., None]) / images.size[:, None, None]
    square = omega**2
    mean = np.einsum("nap,np->na", V, square) / square.sum(axis=1)[:, None]
    r, centred = (
        np.where(omega[:, None] > 0, omega[:, None] * apart, 0.0)
        for apart in (V - fitted, V - mean[..., None])
    )
    whole = np.sqrt((centred**2).sum(axis=(1, 2)))
    found = np.sqrt((r**2).sum(axis=(1, 2))) / whole
    share = np.sqrt(square.sum(axis=1)) / whole * (1 + found)
    far = 1 + largest(np.abs(V))
    allowed = share * images.allow(4 * far, far) + images.allow(found, 1.0)
    checks.equal("residual", "the landmarks fitted", found, allowed)


def check_bars(images: Images, checks: Checks) -> None:
    """Check error bars: finite, of a covariance, with correlations; chances; and the evidence."""
    stated, weighed = images.columns, images.weights > 0
    for name in ("shape_sd", "input_shape_sd"):
        if name in stated:
            fine = np.isfinite(stated[name]) & (stated[name] >= 0)
            checks.hold(f"{name} is finite and not negative", fine.all(axis=(1, 2)))
    for name in ("shape_correlation", "input_shape_correlation"):
        if name in stated:
            within = np.abs(stated[name]) <= 1 + SINGLE
            checks.hold(f"{name} is within -1 and 1", within.all(axis=(1, 2)))
    if "shape_covariance" in stated:
        check_covariance(images, checks)
    inlier_probability, p = stated["inlier_probability"], stated["p_value"]
    chance = np.where(
        weighed, (inlier_probability >= 0) & (inlier_probability <= 1), np.isnan(inlier_probability)
    ).all(axis=1)
    checks.hold("inlier_probability is a chance of each landmark seen", chance)
    chance = np.where(weighed.sum(axis=1) > FREEDOM, (p >= 0) & (p <= 1), np.isnan(p))
    checks.hold("p_value is a chance where 4 landmarks are seen", chance)
    off = np.abs(stated["log_evidence"] + stated["objective"])
    checks.add("objective is -log_evidence", off, FLOOR * np.abs(stated["objective"]))


def check_covariance(images: Images, checks: Checks) -> None:
    """Check covariances (n, 3p, 3p), x, y, z of one landmark after the other, against the bars."""
    sd, C = images.columns["shape_sd"], images.columns["shape_covariance"]
    n, _, p = sd.shape
    most = largest(sd**2)
    own = np.einsum("npapb->nabp", C.reshape(n, p, 3, p, 3))
    pairs = np.stack([own[:, a, b] for a, b in PAIRS], axis=1)  # (n, 6, p)
    scale = np.stack([sd[:, a] * sd[:, b] for a, b in PAIRS], axis=1)
    found = np.concatenate([np.ones((n, 3, p)), images.columns["shape_correlation"]], axis=1)
    claim = "shape_covariance has the deviations and correlations"
    allowed = 4 * SINGLE * scale + FLOOR * most[:, None, None]
    checks.add(claim, np.abs(pairs - found * scale), allowed)
    checks.add("shape_covariance is symmetric", np.abs(C - C.swapaxes(1, 2)), 1e-6 * most)
    least, good = np.zeros(n), np.isfinite(C).all(axis=(1, 2))
    least[good] = np.linalg.eigvalsh(C[good])[:, 0]
    checks.hold("shape_covariance has no negative variance", good & (least >= -1e-6 * most * p))


def check_inputs(images: Images, rows: Floats, checks: Checks) -> None:
    """Check the landmarks of the files in 3D: weights `rows` (m, p) of the shapes."""
    shapes = images.columns["shapes"]
    far = largest(np.abs(shapes)) * (1 + np.abs(rows).sum(axis=1).max(initial=0.0))
    checks.equal("input_shapes", "the shapes", shapes @ rows.T, FLOOR * far)
