"""Points of a result as a perspective camera saw them."""

from __future__ import annotations

import numpy as np

from shapefit.verification.check import Check, check
from shapefit.verification.proofs.program import Value
from shapefit.verification.subject import Subject


def check_camera(subject: Subject, S: Value) -> list[Check]:
    """Check scale, translation and fitted landmarks under u = centre + focal X_xy / (sign X_z).

    X = S + t, for shapes S (n, 3, p) in the frame of the camera and t the camera's translation.
    scale is the geometric mean of focal / depth at t, translation where t is seen.
    """
    t, focal, centre = (
        subject.stated(name) for name in ("camera_translation", "focal", "principal_point")
    )
    factor, extent = subject.images.factor, subject.images.extent
    sign = 1.0 if subject.result.y_axis == "down" else -1.0
    depth = sign * t[:, 2]
    scale = np.sqrt(focal[:, 0] * focal[:, 1]) / depth
    origin = centre + focal * t[:, :2] / depth[:, None]
    X = S.value + t[..., None]
    z = sign * X[:, 2]
    along = X[:, :2] / z[:, None]
    fitted = centre[..., None] + focal[..., None] * along
    far = (np.abs(S.value).max(axis=(1, 2)) + np.abs(t).max(axis=1))[:, None]
    error = (S.error[:, None] + factor[:, None] * far) / np.abs(z)
    ray = focal[..., None] * (error[:, None] * (1 + np.abs(along)))
    pixel = (factor * (extent + np.abs(centre).max(axis=1)))[:, None]
    at_origin = focal * (1 + np.abs(t[:, :2]) / depth[:, None])
    return [
        check(
            "scale follows from the camera", np.abs(subject.stated("scale") - scale), factor * scale
        ),
        check(
            "translation follows from the camera",
            np.abs(subject.stated("translation") - origin),
            pixel + factor[:, None] * at_origin,
        ),
        check(
            "landmarks_fitted follow from the camera",
            np.abs(subject.stated("landmarks_fitted") - fitted),
            pixel[..., None] + ray,
        ),
    ]
