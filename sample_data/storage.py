"""Write the sample files: small, and the same bytes whenever they are made again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray


def write_shapes(
    path: Path,
    attributes: Mapping[str, str | int | float],
    texts: Mapping[str, Sequence[str]],
    arrays: Mapping[str, NDArray[np.generic]],
) -> None:
    """Write shapes in metres, y up: attributes, texts, and arrays as float32 or int32."""
    own = {"format": "shapefit-shapes", "version": 1, "unit": "m", "up_axis": "y"}
    with h5py.File(path, "w") as file:
        file.attrs.update({**own, **attributes})
        for name, values in texts.items():
            encoded = [value.encode() for value in values]
            kind = h5py.string_dtype("utf-8", length=max(map(len, encoded)))
            _compressed(file, name, np.array(encoded, dtype=kind))
        for name, array in arrays.items():
            whole = np.issubdtype(array.dtype, np.integer)
            _compressed(file, name, array.astype(np.int32 if whole else np.float32))


def write_csv(
    path: Path,
    landmark_names: Sequence[str],
    items: Sequence[str],
    points: NDArray[np.float64],
    decimals: int,
) -> None:
    """Write `item,landmark,x,y[,z]` for points (n, p, d); unseen (NaN) ones have empty cells."""
    lines = [",".join(("item", "landmark", *"xyz"[: points.shape[-1]]))]
    for item, rows in zip(items, points, strict=True):
        for name, row in zip(landmark_names, rows, strict=True):
            cells = ("" if np.isnan(value) else f"{value:.{decimals}f}" for value in row)
            lines.append(",".join((item, name, *cells)))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _compressed(file: h5py.File, name: str, values: NDArray[np.generic]) -> None:
    file.create_dataset(name, data=values, compression="gzip", compression_opts=9, shuffle=True)
