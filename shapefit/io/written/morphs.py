"""The meshes of a dictionary in a scene: targets that weights mix, frame by frame.

    X = a G (V_0 + sum_i w_i (V_i - V_0)) + t,    sum_i w_i = 1

for the meshes V_i of the atoms and their mean V_0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from shapefit.arrays import Floats, Integers
from shapefit.geometry.procrustes import similarity_transform
from shapefit.io.options import AtomMeshes
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.io.written.gltf import Scene


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
