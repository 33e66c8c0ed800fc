"""`view RESULT -o SHEET.png`: landmarks over the fitted model, and the model from another side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from shapefit.config import ViewConfig
from shapefit.errors import input_error
from shapefit.io.atomic import atomic_path
from shapefit.meshes.pictures import FittedImage, Model, check_can_draw, contact_sheet, save
from shapefit.pipelines.items import subsample
from shapefit.pipelines.outcome import Outcome
from shapefit.pipelines.view.reading import read_inputs
from shapefit.pipelines.view.scene import assemble
from shapefit.viewer.scene import Scene

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
    with atomic_path(output) as temporary:
        save(contact_sheet(images, model), temporary, output.suffix.lower()[1:])
    n = len(images)
    return Outcome(done=n, total=n, warnings=scene.notes, written=(output,))


def fitted_image(scene: Scene, row: int) -> FittedImage:
    """Return one frame of the first layer of a scene; the shape is all nan where the fit failed.

    Its mesh is s R sum_j w_j V_j + t, which the camera sees at x f / |z| + c.
    """
    layer, blend, observed = scene.layers[0], scene.layers[0].blend, scene.observed
    shape, pose = layer.points[row], None if layer.pose is None else layer.pose[row]
    R = None if pose is None else pose[:9].reshape(3, 3)
    mesh = flat_mesh = None
    if blend is not None and R is not None and blend.start[row] < blend.start[row + 1]:
        chosen = slice(blend.start[row], blend.start[row + 1])
        atoms = scene.meshes[blend.mesh_set].vertices[blend.atom[chosen]]
        mixed = np.tensordot(blend.weight[chosen], atoms, axes=1)
        mesh = pose[9] * R @ mixed + pose[10:, None]  # type: ignore[index]
        f, c = np.split(layer.camera[row][:, None], 2)  # type: ignore[index]
        depth: Any = np.abs(mesh[2]) if layer.perspective else 1.0
        flat_mesh = np.asarray(f * mesh[:2] / depth + c)
    return FittedImage(
        title=scene.items[row],
        landmarks=np.full_like(shape[:2], np.nan) if observed is None else observed[row],
        shape=shape,
        projected=shape[:2] if layer.fitted is None else layer.fitted[row],
        mesh=mesh,
        projected_mesh=flat_mesh,
        outliers=None if scene.outliers is None else scene.outliers[row],
        sd=None if layer.sd is None else layer.sd[row],
        rotation=R,
    )
