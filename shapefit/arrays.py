"""The arrays that signatures name; docstrings give their axes. Their median;
indices.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


def median(values: NDArray[Any]) -> float:
    """Median of numbers (n,), one at least; NumPy's first takes 0.06 s to import masked
    arrays.
    """
    ordered = np.sort(values)
    return float((ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2)


def finite_median(values: NDArray[Any], default: float = float("nan")) -> float:
    """Median of the finite ones among numbers (n,), the default where there is none."""
    finite = values[np.isfinite(values)]
    return median(finite) if len(finite) else default


def evenly(n: int, most: int) -> NDArray[np.intp]:
    """Return at most so many indices out of n that lie evenly."""
    rows = np.linspace(0, n - 1, min(n, most)).astype(np.intp)
    return rows[np.diff(rows, prepend=-1) > 0]  # np.unique imports numpy.ma
