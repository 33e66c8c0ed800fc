"""Where the page should draw a frame, computed apart from its script."""

from __future__ import annotations

import numpy as np

from shapefit.arrays import Floats
from shapefit.viewer.scene import Layer, Scene


def in_image(layer: Layer, frame: int, points: Floats) -> Floats:
    """Return where (2, q) the image shows points (3, q) of a layer: x and y, or in perspective."""
    if layer.camera is None or layer.pose is None:
        return points[:2]
    position, focal, centre = np.split(layer.camera[frame], [3, 5])
    scale, T = layer.pose[frame, 9], layer.pose[frame, 10:]
    X = (points - T[:, None]) / scale + position[:, None]
    seen: Floats = focal[:, None] * X[:2] / np.abs(X[2]) + centre[:, None]
    return seen


def mesh_vertices(scene: Scene, frame: int, layer: Layer) -> Floats | None:
    """Return the blended mesh (3, q) of a frame, as the page does; None where there is none."""
    if layer.blend is None or layer.pose is None:
        return None
    start, end = layer.blend.start[frame : frame + 2]
    if start == end:
        return None
    atoms = scene.meshes[layer.blend.mesh_set].vertices[layer.blend.atom[start:end]]
    mixed = np.tensordot(layer.blend.weight[start:end], atoms, axes=1)
    R, scale, t = layer.pose[frame, :9].reshape(3, 3), layer.pose[frame, 9], layer.pose[frame, 10:]
    placed: Floats = scale * (R @ mixed) + t[:, None]
    return placed
