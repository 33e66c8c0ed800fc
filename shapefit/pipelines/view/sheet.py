"""`view RESULT -o SHEET.png`: landmarks over the fitted model, and the model from another side."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.config import ViewConfig
from shapefit.errors import input_error
from shapefit.io.atomic import atomic_path
from shapefit.meshes.pictures import FittedImage, Model, check_can_draw, contact_sheet, save
from shapefit.pipelines.items import subsample
from shapefit.pipelines.outcome import Outcome
from shapefit.pipelines.view.reading import read_inputs
from shapefit.pipelines.view.scene import assemble
from shapefit.viewer.scene import Layer, Scene

MOST_IMAGES = 24
"""Images of a sheet, spread evenly over those that are chosen."""


def write_sheet(config: ViewConfig, output: Path) -> Outcome:
    """Draw images of one result, with the meshes or edges of the dictionary, as PNG or SVG."""
    check_can_draw("output")
    scene = assemble(config, read_inputs(config))
    if [layer.role for layer in scene.layers] != ["result"]:
        fix = "give one result of `fit`, or end the name in .html"
        raise input_error(output, "a sheet shows one result", fix)
    (layer,) = scene.layers
    faces = None if layer.blend is None else scene.meshes[layer.blend.mesh_set].faces
    edges = np.asarray(scene.edges, np.int64).reshape(-1, 2)
    model = Model("down" if scene.y_down else "up", faces, edges)
    images = [fitted_image(scene, row) for row in subsample(MOST_IMAGES, len(scene.items))]
    figure = contact_sheet(images, model)
    with atomic_path(output) as temporary:
        partial(save, figure, file_format=output.suffix.lower()[1:])(temporary)
    n = len(images)
    return Outcome(done=n, total=n, warnings=scene.notes, written=(output,))


def fitted_image(scene: Scene, row: int) -> FittedImage:
    """Return one frame of the first layer of a scene; the shape is all nan where the fit failed."""
    layer, observed = scene.layers[0], scene.observed
    shape = layer.points[row]
    mesh = _mesh(scene, row)
    return FittedImage(
        title=scene.items[row],
        landmarks=np.full_like(shape[:2], np.nan) if observed is None else observed[row],
        shape=shape,
        projected=shape[:2] if layer.fitted is None else layer.fitted[row],
        mesh=mesh,
        projected_mesh=None if mesh is None else _in_image(layer, row, mesh),
        outliers=None if scene.outliers is None else scene.outliers[row],
        sd=None if layer.sd is None else layer.sd[row],
        rotation=None if layer.pose is None else layer.pose[row, :9].reshape(3, 3),
    )


def _mesh(scene: Scene, row: int) -> Floats | None:
    """s R sum_j w_j V_j + t: the vertices (3, q) of a frame in space; None where it has none."""
    blend, pose = scene.layers[0].blend, scene.layers[0].pose
    if blend is None or pose is None or blend.start[row] == blend.start[row + 1]:
        return None
    chosen = slice(blend.start[row], blend.start[row + 1])
    atoms = scene.meshes[blend.mesh_set].vertices[blend.atom[chosen]]
    mixed = np.tensordot(blend.weight[chosen], atoms, axes=1)
    return pose[row, 9] * pose[row, :9].reshape(3, 3) @ mixed + pose[row, 10:, None]


def _in_image(layer: Layer, row: int, points: Floats) -> Floats:
    """Return where the camera of a layer sees points (3, q): x f / |z| + c, (2, q)."""
    assert layer.camera is not None
    f, c = np.split(layer.camera[row][:, None], 2)
    depth: Any = np.abs(points[2]) if layer.perspective else 1.0
    return np.asarray(f * points[:2] / depth + c)
