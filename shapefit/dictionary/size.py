"""How large the objects of a dictionary are, and with that the shapes lifted by it, in metres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.dictionary.model import Dictionary
from shapefit.geometry.length_units import metres_in
from shapefit.geometry.normalisation import spread


def find_edge_length(shapes: Floats, edges: NDArray[np.integer]) -> Floats:
    """Mean length (e,) of each edge over shapes (n, 3, p), in their unit; edges (e, 2)."""
    i, j = edges.T
    found: Floats = np.linalg.norm(shapes[:, :, i] - shapes[:, :, j], axis=1).mean(axis=0)
    return found


def metres_per_unit(shapes: Floats, dictionary: Dictionary) -> Floats | None:
    """Metres (n,) in one unit of lifted shapes (n, 3, p): as large as the training shapes were.

    By the lengths of the edges where the dictionary has them, L_m / sum_e |X_i - X_j|: bones are as
    long in every pose. Else by their spread, which is that of the training shapes on average. nan
    for a shape without size; None where the dictionary does not say how large its shapes were.
    """
    metres = metres_in(dictionary.unit)
    if metres is None or not knows_size(dictionary):
        return None
    if has_lengths(dictionary):
        assert dictionary.edges is not None
        assert dictionary.edge_length is not None
        i, j = dictionary.edges.T
        sides = (shapes[:, a].take(i, axis=1) - shapes[:, a].take(j, axis=1) for a in range(3))
        extent = np.sqrt(sum(side**2 for side in sides)).sum(axis=1)
        size = float(dictionary.edge_length.sum())
    else:
        assert dictionary.atom_scale is not None
        extent = spread(shapes)
        size = float((dictionary.atom_scale * spread(dictionary.atoms)).mean())
    return np.divide(
        metres * size, extent, out=np.full(len(shapes), np.nan), where=np.asarray(extent > 0)
    )


def knows_size(dictionary: Dictionary) -> bool:
    """Whether the dictionary says how large its training shapes were, in a unit of length."""
    measured = has_lengths(dictionary) or dictionary.atom_scale is not None
    return measured and metres_in(dictionary.unit) is not None


def has_lengths(dictionary: Dictionary) -> bool:
    """Whether the dictionary says how long its edges are."""
    length = dictionary.edge_length
    return dictionary.edges is not None and length is not None and bool(length.sum() > 0)
