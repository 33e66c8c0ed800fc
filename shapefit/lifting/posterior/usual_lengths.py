"""The usual lengths of limbs of people, beside which single images are lifted.

How a posterior is conditioned on them is written down in
shapefit/core/posterior/limbs.hpp.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.dictionary.bodies import find_limbs, precision_of_ratios
from shapefit.dictionary.model import Dictionary

DETECTED_LENGTH_SD = 0.1
"""Standard deviation of the logarithm of a limb's length, beside that among training
bodies: detectors do not put joints where motion capture has them. On film errors are
the same from 0.03 to 0.1.
"""

MIN_LIMBS = 2
"""One limb of a body of any size may have any length."""


class LimbLengths(NamedTuple):
    """What is known beforehand of the lengths of limbs, but for the size of the body.

    limbs (e, 2), pairs of landmarks; log_length (e,), the logarithms of their usual
    lengths; precision (e, e) of these, the size left open.
    """

    limbs: Integers
    log_length: Floats
    precision: Floats

    @classmethod
    def none(cls) -> LimbLengths:
        """Make lengths of no limbs, which change nothing."""
        return cls(np.empty((0, 2), np.int64), np.empty(0), np.empty((0, 0)))


def find_limb_lengths(dictionary: Dictionary) -> LimbLengths | None:
    """Return the usual lengths of the limbs of people, None where they are unknown.

    None, too, where fewer than `MIN_LIMBS` are known.
    """
    usual = dictionary.edge_length
    covariance = dictionary.edge_covariance
    edges = dictionary.edges
    if usual is None or covariance is None or edges is None:
        return None
    is_limb = find_limbs(dictionary.landmark_names, edges) & (usual > 0)
    rows = np.flatnonzero(is_limb)
    if len(rows) < MIN_LIMBS:
        return None
    detected = DETECTED_LENGTH_SD**2 * np.eye(len(rows))
    S = covariance[np.ix_(rows, rows)] + detected
    return LimbLengths(edges[rows], np.log(usual[rows]), precision_of_ratios(S))
