"""The last guard of lifting: no image counts as fitted whose shape is not a shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from shapefit.convex.solution import Status
from shapefit.lifting.lift import Lifting

REASON = "the shape found is not finite"


def withhold_broken(lifting: Lifting) -> Lifting:
    """Fail the images whose shape is not finite throughout, and that have not failed before.

    They end with NUMERICAL_FAILURE and without a shape (nan), whatever the solver says of them.
    """
    whole = np.isfinite(lifting.shapes).all(axis=(1, 2))
    broken = [i for i in np.flatnonzero(~whole).tolist() if i not in lifting.failures]
    if not broken:
        return lifting
    status = list(lifting.estimate.status)
    changed = {
        name: getattr(lifting, name).copy()
        for name in ("shapes", "landmarks_fitted", "translation", "scale")
    }
    for image in broken:
        status[image] = Status.NUMERICAL_FAILURE
        for values in changed.values():
            values[image] = np.nan
    return replace(
        lifting,
        **changed,
        estimate=replace(lifting.estimate, status=tuple(status)),
        failures={**lifting.failures, **dict.fromkeys(broken, REASON)},
    )
