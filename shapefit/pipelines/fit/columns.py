"""Datasets of a result that families of methods lay out alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats
from shapefit.lifting.estimate import E
from shapefit.lifting.lift import Lifting

Columns = Mapping[str, NDArray[Any] | None]
"""Datasets of a result by name; None is absent."""


def certificate_columns(lifting: Lifting[E], *, of_result: bool) -> Columns:
    """Lay out what proves the optimum of the convex program; images that failed have
    nan.

    of_result, whether the objective of the program is that of the result, if that was
    not refined before a camera.
    """
    certificate = lifting.estimate.convex_proof
    if certificate is None:
        return {}
    failed: Flags = np.asarray(np.isnan(lifting.scale))
    M = certificate.transforms
    if failed.any():
        retained = ~failed[M.image]
        count = np.where(failed, 0, M.count)
        M = replace(M, count=count, atom=M.atom[retained], blocks=M.blocks[retained])
    columns = {
        "dual": blank(certificate.dual, failed),
        "convex_translation": blank(certificate.translation, failed),
        "transform_count": M.count,
        "transform_atom": M.atom,
        "active_transforms": M.blocks,
    }
    if not of_result or lifting.perspective is not None:
        columns["convex_objective"] = blank(certificate.objective, failed)
        columns["convex_relative_gap"] = blank(certificate.relative_gap, failed)
    return columns


def blank(values: Floats | None, failed: Flags) -> Floats | None:
    """Return values (n, ...) that are nan where an image has no shape: failed (n,)."""
    if values is None or not failed.any():
        return values
    rows = failed.reshape(-1, *(1,) * (values.ndim - 1))
    return np.where(rows, np.nan, values)
