"""The parts of a glTF scene, and the binary file (GLB) that holds them with their numbers."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from shapefit import __version__
from shapefit.arrays import Floats, Integers
from shapefit.geometry.procrustes import similarity_transform
from shapefit.io.options import AtomMeshes
from shapefit.io.records import ResultSet, ShapeSet

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


@dataclass(frozen=True)
class Morph:
    """The meshes V of the k atoms in use, and frames (m,) that have a mesh, counted from the first.

    weights (m, k); scale a (m,), rotation G (m, 3, 3) and translation t (m, 3), in metres.
    """

    meshes: AtomMeshes
    frames: Integers
    weights: Floats
    scale: Floats
    rotation: Floats
    translation: Floats


def find_morph(
    records: ShapeSet | ResultSet, points: Floats, frames: Integers, meshes: AtomMeshes | None
) -> Morph | None:
    """Return the meshes of a result whose shapes (n, 3, p) are at these points, in metres.

    None for shapes, and without the coefficients of the atoms.
    """
    if meshes is None or isinstance(records, ShapeSet) or records.coefficients is None:
        return None
    c, R, s, T = records.coefficients, records.rotation, records.scale, records.translation
    if R is None or s is None or T is None:
        return None
    whole = np.isfinite(points.sum(axis=(1, 2)) + c.sum(axis=1)) & (c.sum(axis=1) > 0)
    rows = np.flatnonzero(whole)
    if not len(rows):
        return None
    c, total = c[rows], c[rows].sum(axis=1)
    move = similarity_transform(records.shapes[rows], points[rows])
    start = np.pad(T[rows], ((0, 0), (0, 1)))[..., None]
    used = np.flatnonzero(c.any(axis=0))
    return Morph(
        meshes=AtomMeshes(meshes.vertices[used], meshes.faces),
        frames=frames[rows],
        weights=c[:, used] / total[:, None],
        scale=move.scale * s[rows] * total,
        rotation=move.rotation @ R[rows],
        translation=move.apply(start)[..., 0],
    )


def add_morph(scene: Scene, morph: Morph, times: Floats, name: str, material: int) -> int:
    """Add the mesh of an object, which moves at times (m,) in seconds; returns its node."""
    V, faces = morph.meshes
    mean = V.mean(axis=0)
    primitive = {
        "attributes": {"POSITION": scene.store(mean.T)},
        "indices": scene.store(faces.ravel(), "uint32"),
        "material": material,
        "targets": [{"POSITION": scene.store((each - mean).T)} for each in V],
    }
    first = morph.weights[0].tolist()
    mesh = scene.add("meshes", name=name, primitives=[primitive], weights=first)
    moves = {
        "scale": np.repeat(morph.scale[:, None], 3, axis=1),
        "rotation": quaternions(morph.rotation),
        "translation": morph.translation,
    }
    still = {path: values[0].tolist() for path, values in moves.items()}
    node, at = scene.add("nodes", name=name, mesh=mesh, **still), scene.store(times)
    for path, values in {**moves, "weights": morph.weights.ravel()}.items():
        scene.animate(node, path, at, values)
    return node


def quaternions(rotations: Floats) -> Floats:
    """Unit quaternions (f, 4), x y z w, of rotations (f, 3, 3): of q and -q the nearer one."""
    q = Rotation.from_matrix(rotations).as_quat()
    turned = (q[1:] * q[:-1]).sum(axis=1) < 0
    q[1:] *= np.cumprod(np.where(turned, -1.0, 1.0))[:, None]
    return q
