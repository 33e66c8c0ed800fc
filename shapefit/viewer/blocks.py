"""Arrays as the page holds them: base64 of small integers or floats, read by scripts/blocks.js."""

from __future__ import annotations

from base64 import b64encode
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats

Block = dict[str, Any]
"""type, shape and data of an array, as JSON."""

MISSING = -32768
LARGEST = 32767

FINE_ENOUGH = 1000
"""Steps of the 16-bit scale that the typical extent of a row must span."""


def block_of_points(points: Floats) -> Block:
    """Return points (n, p, d) as 16-bit integers on one scale.

    A value that is not finite in 32 bits is missing. Where a few rows lie so far off that the steps
    would be too coarse for the others, the block holds 32-bit floats instead.
    """
    with np.errstate(over="ignore"):
        known: NDArray[np.bool_] = np.all(np.isfinite(points.astype("<f4")), axis=-1)
    values = points[known]
    if not len(values):
        return _scaled(points, known, np.zeros(points.shape[-1]), 1.0)
    low, high = values.min(axis=0), values.max(axis=0)
    step = float((high - low).max()) / (2 * LARGEST) or 1.0
    if _typical_extent(points, known) < FINE_ENOUGH * step and high.max() - low.min() > 0:
        whole = np.where(known[..., None], points, np.nan)
        return _block("f4", whole.shape, whole.astype("<f4"))
    return _scaled(points, known, (low + high) / 2, step)


def block_of_integers(values: NDArray[Any], kind: str) -> Block:
    """Return non-negative integers in the type u1, u2 or u4."""
    return _block(kind, values.shape, values.astype(f"<{kind}"))


def block_of_floats(values: NDArray[Any]) -> Block:
    """Return numbers as 32-bit floats."""
    return _block("f4", values.shape, values.astype("<f4"))


def block_of_coarse_floats(values: NDArray[Any]) -> Block:
    """Return numbers with three significant digits: the upper half of a 32-bit float, rounded."""
    with np.errstate(over="ignore"):
        bits = values.astype("<f4").view("<u4").astype(np.uint64)
    rounded = np.where(np.isfinite(values), (bits + 0x8000) >> 16, bits >> 16)
    return _block("bf", values.shape, rounded.astype("<u2"))


def block_of_bits(flags: NDArray[np.bool_]) -> Block:
    """Return flags (n, p) as packed bits, each row in whole bytes, the first flag lowest."""
    packed = np.packbits(flags, axis=1, bitorder="little")
    return _block("u1", packed.shape, packed)


def smallest_kind(largest: int) -> str:
    """Return the integer type that holds numbers up to `largest`."""
    return "u1" if largest < 2**8 else "u2" if largest < 2**16 else "u4"


def _typical_extent(points: Floats, known: NDArray[np.bool_]) -> float:
    """Median, over the rows that have one, of the largest side of a row's upright box."""
    whole = np.where(known[..., None], points, np.nan)
    rows = whole[known.any(axis=1)]
    sides = np.nanmax(rows, axis=1) - np.nanmin(rows, axis=1)
    extents = sides.max(axis=-1)
    return float(np.median(extents[extents > 0])) if (extents > 0).any() else 0.0


def _scaled(points: Floats, known: NDArray[np.bool_], offset: Floats, step: float) -> Block:
    codes = np.full(points.shape, MISSING, dtype="<i2")
    codes[known] = np.clip(np.rint((points[known] - offset) / step), -LARGEST, LARGEST)
    return _block("i2", points.shape, codes) | {"offset": offset.tolist(), "scale": step}


def _block(kind: str, shape: tuple[int, ...], values: NDArray[Any]) -> Block:
    data = b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
    return {"type": kind, "shape": list(shape), "data": data}
