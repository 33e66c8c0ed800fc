"""How well landmarks labelled as outliers agree with those that were corrupted.

Both functions take labels (n, p) of n images, and give nan for an image that leaves them
undefined: that is no failure.
"""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Flags, Floats


def precision(labelled: Flags, corrupted: Flags) -> Floats:
    """|labelled and corrupted| / |labelled| of each image (n,); nan where nothing is labelled."""
    return _share(labelled & corrupted, labelled)


def recall(labelled: Flags, corrupted: Flags) -> Floats:
    """|labelled and corrupted| / |corrupted| of each image (n,); nan where nothing is corrupted."""
    return _share(labelled & corrupted, corrupted)


def _share(part: Flags, whole: Flags) -> Floats:
    count = whole.sum(axis=-1)
    nothing = np.full(len(count), np.nan)
    return np.divide(part.sum(axis=-1), count, out=nothing, where=count > 0)
