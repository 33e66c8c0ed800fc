"""A dictionary seen through a map of its landmarks: y = A x + e.

    p(y) = sum_k pi_k N(y; A mu_k, A C_k A^T + V),  atoms A B_i

for the rows of weights A, each adding up to 1, and the variance V of what the map cannot say. All
that weighs landmarks against a dictionary works on y as it does on x.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from shapefit.dictionary.mixture import Mixture
from shapefit.dictionary.model import Dictionary

Floats = NDArray[np.float64]


def mapped(dictionary: Dictionary, A: Floats, apart: Floats) -> Dictionary:
    """Return the dictionary of the landmarks A x (p, p), `apart` (p,) their standard deviations.

    Landmark j stands for joint j: edges, motion and names stay as they are.
    """
    variance = np.tile(apart**2, 3)
    prior = dictionary.prior
    if prior is not None:
        every = np.kron(np.eye(3), A)
        prior = Mixture(
            prior.weights,
            prior.means @ A.T,
            every @ prior.covariances @ every.T + np.diag(variance),
        )
    return replace(
        dictionary,
        atoms=np.ascontiguousarray(dictionary.atoms @ A.T),
        mean_shape=dictionary.mean_shape @ A.T,
        prior=prior,
    )
