"""Principal components of the shapes of one activity, for coefficients of either sign."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats


def principal_components(shapes: Floats, bases: float = 0.99) -> Floats:
    """Orthonormal directions (m, 3, p) in which the shapes differ most from their own mean.

    shapes (n, 3, p), n >= 1, normalised, aligned, centred. The strongest come first, each with
    its largest entry positive. m is `bases`, or, where that is below 1, the least number that holds
    this share of the summed squared distances from the mean; at most the rank, and so 0 for shapes
    that are all alike. The dictionary of matching pursuit concatenates those of all
    activities. Source: Ramakrishna, Kanade and Sheikh 2012.
    """
    X = (shapes - shapes.mean(axis=0)).reshape(len(shapes), -1)
    _, s, directions = np.linalg.svd(X, full_matrices=False)
    # Shapes come from files in single precision, and what aligns them rounds them differently.
    rounding = np.finfo(np.float32).eps * np.sqrt(X.size) * np.abs(shapes).max(initial=0.0)
    rank = int((s > rounding).sum())
    number = int(bases)
    if bases < 1:
        held = np.cumsum(s[:rank] ** 2)
        number = int((held < bases * held[-1]).sum()) + 1 if rank else 0
    kept = directions[: min(number, rank)]
    largest = np.take_along_axis(kept, np.abs(kept).argmax(axis=1)[:, None], axis=1)
    return (kept * np.sign(largest)).reshape(-1, *shapes.shape[1:])
