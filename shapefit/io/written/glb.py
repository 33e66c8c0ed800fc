"""Write GLB, the file of scenes: for each individual a skeleton in motion, in a skin of its own."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from shapefit import __version__
from shapefit.arrays import Floats
from shapefit.geometry.joint_rotations import Rig, find_bones, rest_places
from shapefit.io.written.bones import node_names, rigged
from shapefit.io.written.motion import Motion, by_video, motion_output
from shapefit.meshes.export import tubes

THICKNESS = 0.03
"""Diameter of a bone, as a share of the largest extent of the body at rest."""

COLOURS = ((0.3, 0.47, 0.66), (0.9, 0.5, 0.2), (0.35, 0.63, 0.35), (0.75, 0.35, 0.55))
"""Of one individual after the other, and again."""


def write_glb(path: Path, motions: Sequence[Motion]) -> None:
    """Write the individuals of a video, as far from each other as in the image.

    Times count from the first frame of any of them.
    """
    scene, roots = Scene(), []
    first = min(motion.first for motion in motions)
    for number, motion in enumerate(motions):
        beside = motion.start - motions[0].start
        times = (motion.frames - first) / motion.rate
        name = motion.name or "motion"
        look = {"baseColorFactor": [*COLOURS[number % len(COLOURS)], 1.0], "metallicFactor": 0.0}
        material = scene.add("materials", name=name, pbrMetallicRoughness=look)
        assert motion.rig is not None
        rig = replace(motion.rig, root=motion.rig.root + beside)
        here = _add_nodes(scene, rig, node_names(motion), times)
        mesh, skin = _skin(scene, rig, here, name, material)
        roots += [here, scene.add("nodes", name=name, mesh=mesh, skin=skin)]
    scene.write(path, roots)


glb_output = motion_output(write_glb, by_video, prepare=rigged)


def _add_nodes(scene: Scene, rig: Rig, names: Sequence[str], times: Floats) -> int:
    """Add the nodes of a rig, and how they turn; returns the number of the first."""
    here, at = len(scene.parts.get("nodes", ())), scene.store(times)
    for node, name in enumerate(names):
        offset = rig.offsets[node] if node else rig.root[rig.rest]
        children = [here + below for below, each in enumerate(rig.tree) if each.above == node]
        scene.add("nodes", name=name, translation=offset.tolist(), children=children or None)
        if rig.tree[node].aims:
            scene.animate(here + node, "rotation", at, quaternions(rig.rotations[node]))
    scene.animate(here, "translation", at, rig.root)
    return here


def _skin(scene: Scene, rig: Rig, here: int, name: str, material: int) -> tuple[int, int]:
    """Add a solid per bone, which turns with the node that aims along it, and what joins them."""
    rest = rest_places(rig)
    node_of = {node.joint: number for number, node in reversed([*enumerate(rig.tree)])}
    order = {joint: place for place, joint in enumerate(node_of)}
    bones = {
        tuple(sorted((order[end], order[start]))): rig.tree[node_of[end]].above
        for end, start in find_bones(rig.tree).items()
    }
    pairs = sorted(bones)  # as `tubes` takes them
    vertices, faces = tubes(rest[[*node_of.values()]].T, np.array(pairs), THICKNESS)
    carriers = np.repeat([bones[pair] for pair in pairs], vertices.shape[1] // len(pairs))
    influence = np.eye(1, 4) * np.ones((len(carriers), 1))
    inverse = np.tile(np.eye(4), (len(rest), 1, 1))
    inverse[:, 3, :3] = -rest  # column after column
    attributes = {
        "POSITION": scene.store(vertices.T),
        "JOINTS_0": scene.store(influence * carriers[:, None], "uint16"),
        "WEIGHTS_0": scene.store(influence),
    }
    faces_of = scene.store(faces.ravel(), "uint32")
    solid = {"attributes": attributes, "indices": faces_of, "material": material}
    skin = scene.add(
        "skins",
        name=name,
        joints=[here + number for number in range(len(rest))],
        inverseBindMatrices=scene.store(inverse.reshape(-1, 16)),
        skeleton=here,
    )
    return scene.add("meshes", name=name, primitives=[solid]), skin


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


def quaternions(rotations: Floats) -> Floats:
    """Unit quaternions (f, 4), x y z w, of rotations (f, 3, 3): of q and -q the nearer one."""
    q = Rotation.from_matrix(rotations).as_quat()
    turned = (q[1:] * q[:-1]).sum(axis=1) < 0
    q[1:] *= np.cumprod(np.where(turned, -1.0, 1.0))[:, None]
    return q
