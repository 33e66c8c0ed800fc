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

    Landmark j stands for joint j: edges, motion and names stay as they are; edges get longer as
    their root mean square lengths do.
    """
    variance = np.tile(apart**2, 3)
    prior, length = dictionary.prior, dictionary.edge_length
    if prior is not None:
        before = prior
        every = np.kron(np.eye(3), A)
        prior = Mixture(
            prior.weights,
            prior.means @ A.T,
            every @ prior.covariances @ every.T + np.diag(variance),
        )
        if length is not None and dictionary.edges is not None:
            longer = edge_squares(prior, dictionary.edges) / edge_squares(before, dictionary.edges)
            length = length * np.sqrt(longer)
    return replace(
        dictionary,
        atoms=np.ascontiguousarray(dictionary.atoms @ A.T),
        mean_shape=dictionary.mean_shape @ A.T,
        prior=prior,
        edge_length=length,
    )


def edge_squares(prior: Mixture, edges: NDArray[np.integer]) -> Floats:
    """E ||x_i - x_j||^2 (e,) of the edges ij: of the means, and the trace of the covariance."""
    i, j = edges.T
    second = prior.by_landmark + np.einsum("kap,kbq->kpaqb", prior.means, prior.means)
    own = np.einsum("k,kpaqa->pq", prior.weights, second)
    found: Floats = own[i, i] + own[j, j] - own[i, j] - own[j, i]
    return found
