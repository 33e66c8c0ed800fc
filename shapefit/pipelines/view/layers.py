"""The layers of a page: results in one space with their meshes, others aligned to the
first.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from shapefit.arrays import Floats
from shapefit.convex.solver import Status
from shapefit.dictionary.model import Dictionary
from shapefit.evaluation import metrics
from shapefit.geometry.normalisation import as_metres
from shapefit.geometry.procrustes import similarity_transform
from shapefit.io.writers.motion import ANGLE_SD, ANGLES, angle_names
from shapefit.lifting.methods import METHODS
from shapefit.lifting.trust import REASONS
from shapefit.pipelines.view.reading import POSE, Content
from shapefit.records.columns import in_columns
from shapefit.records.items import Items
from shapefit.records.shapes import Shapes
from shapefit.viewer.page import blend, encode_texts

CAMERA = ("camera_translation", "focal", "principal_point")
"""Datasets of a result that say how a camera sees its shapes in perspective."""
EXPECTED, AGAINST_TRUTH = "expected error", "error against the truth"
"""Names of measures that the header of the page states."""
MOST_MESHES = 200
"""Meshes of a file of shapes that a page holds; a file with more is shown without."""
SOLVED = (Status.OPTIMAL.value, Status.CONVERGED.value)

Layer = dict[str, Any]
"""A layer of a scene, by the keys of shapefit.viewer.page."""


def make_layers(
    contents: Sequence[Content],
    truth: Content | None,
    dictionary: Dictionary | None,
    observed: Floats | None,
    notes: list[str],
) -> tuple[list[Layer], list[dict[str, Any]], str]:
    """Return the layers, those of results first and the truth last, their meshes and
    the unit.

    All are in the space of the first result, of one with a camera if there is one: in
    metres where it knows them. What is in another space, such as shapes and the truth,
    is aligned to it. observed (n, 2, p) are the landmarks of the page.
    """
    results = [content for content in contents if content.role == "result"]
    others = [content for content in contents if content.role == "shapes"]
    layers, meshes = list[Layer](), list[dict[str, Any]]()
    for content in results:
        layer = _result_layer(content, observed, truth)
        if dictionary is not None and dictionary.mesh_vertices is not None:
            if (weights := _mixture(layer, content, dictionary)) is None:
                notes.append(
                    f"{content.name} has no mesh: it mixes no atoms of this dictionary."
                )
            else:
                layer["blend"] = blend(0, weights)
                vertices, faces = dictionary.mesh_vertices, dictionary.mesh_faces
                meshes = [{"vertices": vertices, "faces": faces}]
        layers.append(layer)
    others += [truth] if results and truth else []
    for content in others:
        layer = {"name": content.name, "role": content.role, "points": content.points}
        angles = [] if content.role == "truth" else [*_angles(content)]
        layer |= {"measures": angles, "pose": None, "perspective": False}
        records, rows = content.records, content.rows
        own = mesh_vertices(records)
        if own is not None and len(own) <= MOST_MESHES:
            weights = np.eye(len(own))[rows] * (rows >= 0)[:, None]
            in_place = np.tile([*np.eye(3).ravel(), 1.0, 0.0, 0.0, 0.0], (len(rows), 1))
            layer |= {"pose": in_place, "blend": blend(len(meshes), weights)}
            of_shapes = records.mesh_faces if isinstance(records, Shapes) else None
            meshes.append({"vertices": own, "faces": of_shapes})
        layers.append(layer)
    if not results:
        return layers, meshes, contents[0].records.unit
    guide = next(filter(has_camera, results), results[0])
    in_camera, in_metres = space = _space(guide)
    stay = [_space(content) == space for content in results] + [False] * len(others)
    target = first_finite(
        [one["points"] for one, stays in zip(layers, stay, strict=True) if stays]
    )
    shown = []
    for layer, stays in zip(layers, stay, strict=True):
        placed = layer if stays else _aligned(layer, target)
        if stays or np.isfinite(placed["points"]).any():
            shown.append(placed)
        else:
            few = f"{guide.name} has fewer than 3 landmarks of the same names"
            notes.append(f"Not shown, as {few}: {layer['name']}.")
    return shown, meshes, "m" if in_metres else "" if in_camera else guide.records.unit


def mesh_vertices(records: Items) -> Floats | None:
    """Return the vertices (n, 3, q) of the meshes of shapes, None without any."""
    if not isinstance(records, Shapes) or records.mesh_vertices is None:
        return None
    return in_columns(records.mesh_vertices)


def first_finite(arrays: Sequence[Floats]) -> Floats:
    """Return points (n, d, p): of each frame those of the first array that has any."""
    points = arrays[0]
    for further in arrays[1:]:
        empty = ~np.isfinite(points).any(axis=(1, 2), keepdims=True)
        points = np.where(empty, further, points)
    return points


def has_camera(content: Content) -> bool:
    """Whether a result says how a camera sees its shapes in perspective."""
    return {*CAMERA, "translation", "scale"} <= content.values.keys()


def _space(content: Content) -> tuple[bool, bool]:
    """Whether shapes are where a camera has them, and whether they are in metres."""
    metres = content.values.get("metres_per_unit")
    return has_camera(content), metres is not None and bool(np.isfinite(metres).any())


def _result_layer(
    content: Content, observed: Floats | None, truth: Content | None
) -> Layer:
    """Return a result in space: X = factor (S - start) + end for its shapes S."""
    values, shapes = content.values, content.points
    n = len(shapes)
    in_camera, in_metres = _space(content)
    start = end = np.zeros((n, 3))
    if in_camera:
        factor = values["metres_per_unit"] if in_metres else 1 / values["scale"]
        start = np.pad(values["translation"], ((0, 0), (0, 1)))
        end = (factor * values["scale"])[:, None] * values["camera_translation"]
        camera = np.hstack([values[name] for name in CAMERA[1:]])
    else:  # depths are unknown, and all frames have one scale
        factor = np.full(
            n, np.nanmedian(values["metres_per_unit"]) if in_metres else 1.0
        )
        camera = np.pad(np.repeat(1 / factor[:, None], 2, axis=1), ((0, 0), (0, 2)))
    sd, status, pose = values.get("shape_sd"), values.get("status"), None
    if status is not None:
        status = np.where(np.isin(status.astype(str), SOLVED), "", status)
    if set(POSE) <= values.keys():
        t = np.pad(values["translation"], ((0, 0), (0, 1)))
        size, R = (factor * values["scale"])[:, None], values["rotation"].reshape(n, 9)
        pose = np.hstack([R, size, factor[:, None] * (t - start) + end])
    return {
        "name": content.name,
        "role": "result",
        "points": (
            factor[:, None, None] * (shapes - start[:, :, None]) + end[:, :, None]
        ),
        "fitted": values.get("landmarks_fitted", shapes[:, :2]),
        "sd": None if sd is None else factor[:, None, None] * sd,
        "pose": pose,
        "camera": camera,
        "perspective": in_camera,
        "status": None if status is None or not status.any() else encode_texts(status),
        "reasons": encode_texts(values.get(REASONS)),
        "measures": [*_angles(content), *_errors(content, observed, truth)],
    }


def _angles(content: Content) -> Iterator[dict[str, Any]]:
    """Yield the joint angles of a body with their standard deviations, in degrees."""
    for number, name in enumerate(angle_names(content.records.landmark_names)):
        if ANGLES in content.values:
            angle, sd = (
                content.values[dataset][:, number] for dataset in (ANGLES, ANGLE_SD)
            )
            band = sd if np.isfinite(sd).any() else None
            if np.isfinite(angle).any():
                yield _measure(name.replace("_", " "), angle, "°", band)


def _errors(
    content: Content, observed: Floats | None, truth: Content | None
) -> Iterator[dict[str, Any]]:
    """Yield errors of each frame: those in space in metres, or else in the unit of the
    truth.
    """
    values, unit = content.values, content.records.unit
    expected, fitted = values.get("expected_error"), values.get("landmarks_fitted")
    factor: Any
    factor, length = as_metres(unit if truth is None else truth.records.unit)
    if truth is not None:
        error = metrics.similarity(content.points, truth.points)
        yield _measure(AGAINST_TRUTH, factor * error, length)
    if _space(content)[1] and (truth is None or length == "m"):
        factor, length = values["metres_per_unit"], "m"
    elif truth is not None and expected is not None:
        expected = metrics.expected(content.points, truth.points, expected)
    if expected is not None:
        yield _measure(EXPECTED, factor * expected, length)
    if "p_value" in values:
        yield _measure("p-value", values["p_value"])
    if observed is not None and (fitted is not None or not has_camera(content)):
        flat = content.points[:, :2] if fitted is None else fitted
        yield _measure(
            "distance in the image", metrics.reprojection(flat, observed), unit
        )


def _measure(
    name: str, values: Floats, unit: str = "", sd: Floats | None = None
) -> dict[str, Any]:
    return {"name": name, "values": values, "unit": unit, "sd": sd}


def in_usual_units(layers: Sequence[Layer]) -> tuple[str, float]:
    """Make the lengths in metres of layers all cm or all mm; return that unit and its
    number.
    """
    measures = [measure for layer in layers for measure in layer["measures"]]
    lengths = [measure["values"] for measure in measures if measure["unit"] == "m"]
    # Below a centimetre in millimetres.
    small = any(
        np.nanmedian(values) < 0.01 for values in lengths if np.isfinite(values).any()
    )
    unit, many = ("mm", 1000.0) if small else ("cm", 100.0)
    for measure in measures:
        if measure["unit"] == "m":
            measure |= {"unit": unit, "values": many * measure["values"]}
    return unit, many


def _mixture(layer: Layer, content: Content, dictionary: Dictionary) -> Floats | None:
    """Return how the coefficients of a result mix the meshes of the atoms, (n, k).

    None where the result does not mix the atoms of this dictionary by one rotation.
    """
    c, pose = content.values.get("coefficients"), layer["pose"]
    method = METHODS.get(str(content.records.attributes.get("method")))
    mixes = method is None or method.mixes_atoms or has_camera(content)
    if not mixes or c is None or c.shape[1] != dictionary.k or pose is None:
        return None
    return np.where(np.isfinite(c.sum(axis=1) + pose.sum(axis=1))[:, None], c, 0.0)


def _aligned(layer: Layer, target: Floats) -> Layer:
    """Move a layer, frame by frame, onto the points (n, 3, p) by the best similarity.

    Over the landmarks that both have; frames with fewer than three such are nan
    afterwards, and those that have no target stay where they are.
    """
    both = metrics.visible_in_both(layer["points"], target)
    has_target = np.any(metrics.visible_in_both(target, target), axis=1)
    points = np.where(has_target[:, None, None], np.nan, layer["points"])
    pose = None if layer["pose"] is None else layer["pose"].copy()
    masks, which = np.unique(both, axis=0, return_inverse=True)
    for number, mask in enumerate(masks):
        rows = np.flatnonzero((which.ravel() == number) & has_target)
        if mask.sum() < metrics.FEWEST_LANDMARKS:
            continue
        source = layer["points"][rows]
        move = similarity_transform(source[:, :, mask], target[rows][:, :, mask])
        points[rows] = move.apply(source)
        if pose is not None:
            R = move.rotation @ pose[rows, :9].reshape(-1, 3, 3)
            pose[rows, 10:] = move.apply(pose[rows, 10:, None])[..., 0]
            pose[rows, :9] = R.reshape(-1, 9)
            pose[rows, 9] *= move.scale
    moved = {
        "points": points,
        "pose": pose,
        "sd": None,
        "camera": None,
        "perspective": False,
    }
    return layer | moved
