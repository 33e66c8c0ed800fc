"""The parts of a glTF scene, and the binary file (GLB) that holds them with their numbers."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit import __version__
from shapefit.arrays import Floats

COMPONENTS = {"float32": 5126, "uint32": 5125, "uint16": 5123}
TYPES = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (16,): "MAT4"}
"""What glTF calls numbers, and arrays of them."""

JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942


class Scene:
    """The parts of a file by kind; they refer to each other by their numbers among their kind."""

    def __init__(self) -> None:
        self.parts: dict[str, list[dict[str, Any]]] = {}
        self._numbers = bytearray()
        self._samplers: list[dict[str, Any]] = []
        self._channels: list[dict[str, Any]] = []

    def add(self, kind: str, **part: Any) -> int:
        """Add a part, of what is not None; returns its number."""
        known = {name: value for name, value in part.items() if value is not None}
        self.parts.setdefault(kind, []).append(known)
        return len(self.parts[kind]) - 1

    def store(self, values: NDArray[Any], dtype: str = "float32") -> int:
        """Add an array (n, ...), n > 0; returns the number of its accessor."""
        values = np.ascontiguousarray(values, dtype)
        view = self.add(
            "bufferViews", buffer=0, byteOffset=len(self._numbers), byteLength=values.nbytes
        )
        self._numbers += values.tobytes() + bytes(-values.nbytes % 4)
        return self.add(
            "accessors",
            bufferView=view,
            componentType=COMPONENTS[dtype],
            count=len(values),
            type=TYPES[values.shape[1:]],
            min=np.atleast_1d(values.min(axis=0)).tolist(),
            max=np.atleast_1d(values.max(axis=0)).tolist(),
        )

    def animate(self, node: int, path: str, times: int, values: Floats) -> None:
        """Have the values, at times that are stored, replace what a node says of `path`."""
        self._channels.append(
            {"sampler": len(self._samplers), "target": {"node": node, "path": path}}
        )
        self._samplers.append({"input": times, "output": self.store(values)})

    def write(self, path: Path, roots: Sequence[int]) -> None:
        """Write the file; roots are the nodes that hang from no other."""
        self.add("animations", name="motion", samplers=self._samplers, channels=self._channels)
        about = {
            "asset": {"version": "2.0", "generator": f"shapefit {__version__}"},
            "scene": 0,
            "scenes": [{"nodes": list(roots)}],
            "buffers": [{"byteLength": len(self._numbers)}],
        }
        text = orjson.dumps(about | self.parts)
        text += b" " * (-len(text) % 4)
        with path.open("wb") as file:
            size = 12 + 8 + len(text) + 8 + len(self._numbers)
            file.write(struct.pack("<4sII", b"glTF", 2, size))
            file.write(struct.pack("<II", len(text), JSON_CHUNK) + text)
            file.write(struct.pack("<II", len(self._numbers), BINARY_CHUNK) + self._numbers)
