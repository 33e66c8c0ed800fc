"""Sizes in metres or in the unit of the dictionary, which says how large its shapes were."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.geometry.length_units import metres_in
from shapefit.geometry.normalisation import spread
from shapefit.io import ResultSet
from shapefit.verification.check import Check, check, largest, rounding_factor

EDGES, SPREAD = "edges", "spread"


@dataclass(frozen=True)
class Size:
    """How large the training shapes of a dictionary were.

    by: edges, whose lengths sum to metres, or spread, which was so many metres on average, '' where
    it is not known; atoms B (k, 3, p) measure atom_scale (k,) in the dictionary's unit, None where
    that is not known.
    """

    by: str
    metres: float
    edges: NDArray[np.integer]
    atoms: Floats
    atom_scale: Floats | None

    @classmethod
    def of(cls, dictionary: Any) -> Self:
        """Return the size that a dictionary states: of its edges where these have lengths."""
        metres, length = metres_in(dictionary.unit), dictionary.edge_length
        scale, edges = dictionary.atom_scale, np.empty((0, 2), np.int64)
        by, size = "", 0.0
        if metres is not None and dictionary.edges is not None and length is not None:
            by, size, edges = EDGES, metres * float(length.sum()), dictionary.edges
        if metres is not None and not size > 0 and scale is not None:
            by, size = SPREAD, metres * float((scale * spread(dictionary.atoms)).mean())
        return cls(by if size > 0 else "", size, edges, dictionary.atoms, scale)


def _stated(result: ResultSet, name: str, *axes: int) -> Floats:
    """Return a dataset (n, *axes); inf throughout where it is absent."""
    stated = result.columns.get(name, np.full((len(result.shapes), *axes), np.inf))
    return np.asarray(stated, np.float64)


def check_metres(result: ResultSet, size: Size) -> list[Check]:
    """Check the metres in one unit of each shape: as large as the training shapes were."""
    if "metres_per_unit" not in result.columns:
        return []
    stated, X = _stated(result, "metres_per_unit"), result.shapes
    i, j = size.edges.T
    with np.errstate(all="ignore"):
        if size.by == EDGES:
            limbs = X[:, :, i] - X[:, :, j]
            extent = np.sqrt(np.einsum("nae,nae->ne", limbs, limbs)).sum(axis=1)
        else:
            extent = spread(X)
        found = np.where(extent > 0, size.metres / extent, np.nan)
        far = 1 + largest(np.abs(X)) / extent
        allowed = rounding_factor(X.shape[2], np.full(len(X), len(size.edges))) * far * found
        off = np.abs(stated - found) if size.by else np.full(len(X), np.inf)
    both = np.isnan(stated) & np.isnan(found)
    claim = "metres_per_unit follow from the shapes"
    return [check(claim, np.where(both, 0.0, off), np.where(both, 0.0, allowed))]


def check_position(result: ResultSet, size: Size) -> list[Check]:
    """Check the camera's translation in the dictionary's unit.

    As large as the atoms are on average, a normalised unit is
    (sum_i c_i s_i ||B_i||^2) / (sum_i c_i ||B_i|| ||sum_i c_i B_i||).
    """
    if "position" not in result.columns:
        return []
    stated, t = _stated(result, "position", 3), _stated(result, "camera_translation", 3)
    n, claim = len(stated), "position follows from the camera_translation"
    if size.atom_scale is None or result.coefficients is None:
        return [check(claim, np.full(n, np.inf), 0.0)]
    c, norms = result.coefficients, np.linalg.norm(size.atoms, axis=(1, 2))
    mixed = c @ size.atoms.reshape(len(size.atoms), -1)
    length = np.sqrt((mixed**2).sum(axis=1))
    with np.errstate(all="ignore"):
        total = (c @ norms) * length
        unit = np.where(total > 0, (c @ (size.atom_scale * norms**2)) / total, np.nan)
        far = 1 + (np.abs(c) @ norms) / length
        factor = rounding_factor(size.atoms.shape[2], np.full(n, len(norms)))
        found = unit[:, None] * t
        off = np.where(np.isnan(stated) & np.isnan(found), 0.0, np.abs(stated - found))
        allowed = np.nan_to_num((factor * far)[:, None] * np.abs(found))
    return [check(claim, off, allowed)]
