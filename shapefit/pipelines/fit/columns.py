"""Columns of a fit that families of methods lay out alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.lifting.estimate import E
from shapefit.lifting.lift import Lifting
from shapefit.records import Fit


def with_certificate(fit: Fit, lifting: Lifting[E], *, is_of_fit: bool) -> Fit:
    """Add the certificate of the convex program to a fit, nan for images that failed.

    is_of_fit, whether the objective of the program is that of the fit, if this was not
    refined in perspective.
    """
    certificate = lifting.estimate.convex_proof
    if certificate is None:
        return fit
    failed: Flags = np.asarray(np.isnan(lifting.scale))
    M = certificate.transforms
    if failed.any():
        retained = ~failed[M.image]
        count = np.where(failed, 0, M.count)
        M = replace(M, count=count, atom=M.atom[retained], blocks=M.blocks[retained])
    fit = replace(
        fit,
        dual=as_rows(blank_failed(certificate.dual, failed)),
        convex_translation=blank_failed(certificate.translation, failed),
        transform_count=M.count,
        transform_atom=M.atom,
        active_transforms=M.blocks,
    )
    if is_of_fit and lifting.perspective is None:
        return fit
    return replace(
        fit,
        convex_objective=blank_failed(certificate.objective, failed),
        convex_relative_gap=blank_failed(certificate.relative_gap, failed),
    )


def blank_failed(values: Floats | None, failed: Flags) -> Floats | None:
    """Return values (n, ...) of images, nan for those that `failed` (n,) flags."""
    if values is None or not failed.any():
        return values
    rows = failed.reshape(-1, *(1,) * (values.ndim - 1))
    return np.where(rows, np.nan, values)


def as_rows(points: Floats | None) -> Floats | None:
    """Return points (n, d, p) with one landmark a row, as records have them."""
    return None if points is None else points.swapaxes(1, 2)
