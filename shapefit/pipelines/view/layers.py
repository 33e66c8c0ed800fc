"""The layers of a page: results in one space with their meshes, others moved there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.convex.solver import Status
from shapefit.dictionary.model import Dictionary
from shapefit.evaluation import metrics
from shapefit.geometry.normalisation import as_metres
from shapefit.geometry.procrustes import similarity_transform
from shapefit.io.writers.motion import ANGLE_SD, ANGLES, angle_names
from shapefit.lifting.methods import METHODS
from shapefit.lifting.trust import REASONS
from shapefit.pipelines.view.reading import POSE_DATASETS, Content
from shapefit.records.columns import in_columns
from shapefit.records.items import Items
from shapefit.records.shapes import Shapes
from shapefit.viewer.page import (
    EncodedTexts,
    Layer,
    Measure,
    MeshSet,
    blend_meshes,
    encode_texts,
)

SHOWN_CAMERA = ("camera_translation", "focal", "principal_point")
"""Of a result that says how a camera sees its shapes in perspective."""

EXPECTED = "expected error"
"""Name of a measure that the header of the page states."""

AGAINST_TRUTH = "error against the truth"
"""Name of a measure that the header of the page states."""

MAX_MESHES = 200
"""Meshes of a file of shapes that a page holds; a file with more is shown without."""

SOLVED = (Status.OPTIMAL.value, Status.CONVERGED.value)


class Layers(NamedTuple):
    """The layers of a page, the meshes that they mix, and the unit of their points."""

    layers: list[Layer]
    meshes: list[MeshSet]
    unit: str


def make_layers(
    contents: Sequence[Content],
    truth: Content | None,
    dictionary: Dictionary | None,
    observed: Floats | None,
    notes: list[str],
) -> Layers:
    """Return the layers of a page, those of results first and the truth last.

    All are in the space of the first result, of one with a camera if there is one: in
    metres where it knows them. What is in another space, such as shapes and the truth,
    is aligned to it. observed (n, 2, p) are the landmarks of the page. What cannot be
    shown is told in the notes.
    """
    results = [content for content in contents if content.role == "result"]
    others = [content for content in contents if content.role == "shapes"]
    if results and truth:
        others.append(truth)
    layers: list[Layer] = []
    meshes: list[MeshSet] = []
    for content in results:
        layer = _result_layer(content, observed, truth)
        if dictionary is not None and dictionary.mesh_vertices is not None:
            weights = _mesh_weights(layer, content, dictionary)
            if weights is None:
                notes.append(
                    f"{content.name} has no mesh: it mixes no atoms of this dictionary."
                )
            else:
                layer["blend"] = blend_meshes(0, weights)
                vertices, faces = dictionary.mesh_vertices, dictionary.mesh_faces
                meshes = [{"vertices": vertices, "faces": faces}]
        layers.append(layer)
    layers += [_shapes_layer(content, meshes) for content in others]
    if not results:
        return Layers(layers, meshes, contents[0].records.unit)
    guide = next(filter(has_camera, results), results[0])
    space = _space_of(guide)
    stays = [_space_of(content) == space for content in results]
    stays += [False] * len(others)
    shown = _move_to_one_space(layers, stays, guide.name, notes)
    if space.in_metres:
        unit = "m"
    elif space.in_camera:
        unit = ""
    else:
        unit = guide.records.unit
    return Layers(shown, meshes, unit)


def _move_to_one_space(
    layers: Sequence[Layer], stays: Sequence[bool], guide: str, notes: list[str]
) -> list[Layer]:
    """Bring layers into one space: those whose `stays` is false move onto the others.

    One that cannot be moved is left out, with a note.
    """
    both = list(zip(layers, stays, strict=True))
    target = first_finite([layer["points"] for layer, stay in both if stay])
    shown = []
    for layer, stay in both:
        placed = layer if stay else _align_layer(layer, target)
        if stay or np.isfinite(placed["points"]).any():
            shown.append(placed)
        else:
            few = f"{guide} has fewer than 3 landmarks of the same names"
            notes.append(f"Not shown, as {few}: {layer['name']}.")
    return shown


def _shapes_layer(content: Content, meshes: list[MeshSet]) -> Layer:
    """Return the layer of a file of shapes; append its meshes, if any, to `meshes`.

    More than MAX_MESHES are left out.
    """
    layer: Layer = {
        "name": content.name,
        "role": content.role,
        "points": content.points,
        "measures": [] if content.role == "truth" else [*_angle_measures(content)],
        "pose": None,
        "perspective": False,
    }
    vertices = mesh_vertices(content.records)
    if vertices is not None and len(vertices) <= MAX_MESHES:
        rows = content.rows
        is_there = rows >= 0
        weights = np.eye(len(vertices))[rows] * is_there[:, None]
        in_place = [*np.eye(3).ravel(), 1.0, 0.0, 0.0, 0.0]
        layer["pose"] = np.tile(in_place, (len(rows), 1))
        layer["blend"] = blend_meshes(len(meshes), weights)
        records = content.records
        faces = records.mesh_faces if isinstance(records, Shapes) else None
        meshes.append({"vertices": vertices, "faces": faces})
    return layer


def join_individuals(layers: Sequence[Layer], contents: Sequence[Content]) -> Layer:
    """Join layers of files of shapes, each of one individual, to one layer.

    No frame is in two of the files.
    """
    points = np.full_like(layers[0]["points"], np.nan)
    measures: dict[str, Measure] = {}
    for layer, content in zip(layers, contents, strict=True):
        is_here = content.rows >= 0
        points[is_here] = layer["points"][is_here]
        for measure in layer["measures"]:
            empty = np.full(len(points), np.nan)
            joined = _make_measure(measure["name"], empty, measure["unit"])
            joined = measures.setdefault(measure["name"], joined)
            joined["values"][is_here] = measure["values"][is_here]
    return {
        "name": ", ".join(content.name for content in contents),
        "role": "shapes",
        "points": points,
        "measures": [*measures.values()],
        "pose": None,
        "perspective": False,
    }


def mesh_vertices(records: Items) -> Floats | None:
    """Return the vertices (n, 3, q) of the meshes of shapes, None without any."""
    if not isinstance(records, Shapes) or records.mesh_vertices is None:
        return None
    return in_columns(records.mesh_vertices)


def first_finite(arrays: Sequence[Floats]) -> Floats:
    """Return points (n, d, p), of each frame those of the first array that has any."""
    points = arrays[0]
    for further in arrays[1:]:
        empty = ~np.isfinite(points).any(axis=(1, 2), keepdims=True)
        points = np.where(empty, further, points)
    return points


def has_camera(content: Content) -> bool:
    """Whether a result says how a camera sees its shapes in perspective."""
    return {*SHOWN_CAMERA, "translation", "scale"} <= content.values.keys()


class _Space(NamedTuple):
    """Whether shapes are where a camera has them, and whether they are in metres."""

    in_camera: bool
    in_metres: bool


def _space_of(content: Content) -> _Space:
    """Return whether a result is in front of a camera, and whether it knows metres."""
    metres = content.values.get("metres_per_unit")
    in_metres = metres is not None and bool(np.isfinite(metres).any())
    return _Space(has_camera(content), in_metres)


def _result_layer(
    content: Content, observed: Floats | None, truth: Content | None
) -> Layer:
    """Return the layer of a result, its shapes S moved to factor (S - start) + end."""
    values = content.values
    shapes = content.points
    n = len(shapes)
    space = _space_of(content)
    start = np.zeros((n, 3))
    end = start
    if space.in_camera:
        factor = values["metres_per_unit"] if space.in_metres else 1 / values["scale"]
        start = np.pad(values["translation"], ((0, 0), (0, 1)))
        end = (factor * values["scale"])[:, None] * values["camera_translation"]
        camera = np.hstack([values["focal"], values["principal_point"]])
    else:  # depths are unknown, and all frames have one scale
        one = np.nanmedian(values["metres_per_unit"]) if space.in_metres else 1.0
        factor = np.full(n, one)
        camera = np.pad(np.repeat(1 / factor[:, None], 2, axis=1), ((0, 0), (0, 2)))
    points = factor[:, None, None] * (shapes - start[:, :, None]) + end[:, :, None]
    sd = values.get("shape_sd")
    if sd is not None:
        sd = factor[:, None, None] * sd
    pose = None
    if set(POSE_DATASETS) <= values.keys():
        t = np.pad(values["translation"], ((0, 0), (0, 1)))
        size = (factor * values["scale"])[:, None]
        R = values["rotation"].reshape(n, 9)
        pose = np.hstack([R, size, factor[:, None] * (t - start) + end])
    return {
        "name": content.name,
        "role": "result",
        "points": points,
        "fitted": values.get("landmarks_fitted", shapes[:, :2]),
        "sd": sd,
        "pose": pose,
        "camera": camera,
        "perspective": space.in_camera,
        "status": _encode_unsolved(values.get("status")),
        "reasons": encode_texts(values.get(REASONS)),
        "measures": [
            *_angle_measures(content),
            *_error_measures(content, observed, truth),
        ],
    }


def _encode_unsolved(status: NDArray[np.object_] | None) -> EncodedTexts | None:
    """Encode the status (n,) of frames, "" for solved ones; None where all are."""
    if status is None:
        return None
    is_solved = np.isin(status.astype(str), SOLVED)
    unsolved = np.where(is_solved, "", status)
    return encode_texts(unsolved) if unsolved.any() else None


def _angle_measures(content: Content) -> Iterator[Measure]:
    """Yield the joint angles of a body with their standard deviations, in degrees."""
    if ANGLES not in content.values:
        return
    for number, name in enumerate(angle_names(content.records.landmark_names)):
        angle = content.values[ANGLES][:, number]
        sd = content.values[ANGLE_SD][:, number]
        band = sd if np.isfinite(sd).any() else None
        if np.isfinite(angle).any():
            yield _make_measure(name.replace("_", " "), angle, "°", band)


def _error_measures(
    content: Content, observed: Floats | None, truth: Content | None
) -> Iterator[Measure]:
    """Yield errors of each frame in metres, or else in the unit of the truth."""
    values = content.values
    unit = content.records.unit
    expected = values.get("expected_error")
    to_metres, length = as_metres(unit if truth is None else truth.records.unit)
    factor: Floats | float = to_metres
    if truth is not None:
        error = metrics.similarity_error(content.points, truth.points)
        yield _make_measure(AGAINST_TRUTH, factor * error, length)
    if _space_of(content).in_metres and (truth is None or length == "m"):
        factor, length = values["metres_per_unit"], "m"
    elif truth is not None and expected is not None:
        expected = metrics.convert_expected_error(
            content.points, truth.points, expected
        )
    if expected is not None:
        yield _make_measure(EXPECTED, factor * expected, length)
    if "p_value" in values:
        yield _make_measure("p-value", values["p_value"])
    fitted = values.get("landmarks_fitted")
    if fitted is None and not has_camera(content):
        fitted = content.points[:, :2]
    if observed is not None and fitted is not None:
        distance = metrics.reprojection(fitted, observed)
        yield _make_measure("reprojection", distance, unit)


def _make_measure(
    name: str, values: Floats, unit: str = "", sd: Floats | None = None
) -> Measure:
    """Return a curve for the chart: numbers (n,) of frames with their deviations."""
    return {"name": name, "values": values, "unit": unit, "sd": sd}


def change_metres_to_cm_or_mm(layers: Sequence[Layer]) -> tuple[str, float]:
    """Change measures in m to cm or mm, in place; return the unit and its number per m.

    They are mm where the median of a measure is below 1 cm.
    """
    measures = [measure for layer in layers for measure in layer["measures"]]
    lengths = [measure["values"] for measure in measures if measure["unit"] == "m"]
    medians = [np.nanmedian(values) for values in lengths if np.isfinite(values).any()]
    # Below a centimetre in millimetres.
    is_small = any(median < 0.01 for median in medians)
    unit, per_metre = ("mm", 1000.0) if is_small else ("cm", 100.0)
    for measure in measures:
        if measure["unit"] == "m":
            measure["unit"] = unit
            measure["values"] = per_metre * measure["values"]
    return unit, per_metre


def _mesh_weights(
    layer: Layer, content: Content, dictionary: Dictionary
) -> Floats | None:
    """Return the weights (n, k) by which a result mixes the meshes of the atoms.

    None where the result does not mix the atoms of this dictionary by one rotation.
    """
    c = content.values.get("coefficients")
    pose = layer["pose"]
    method = METHODS.get(str(content.records.attributes.get("method")))
    mixes = method is None or method.mixes_atoms or has_camera(content)
    if not mixes or c is None or c.shape[1] != dictionary.k or pose is None:
        return None
    is_known = np.isfinite(c.sum(axis=1) + pose.sum(axis=1))
    return np.where(is_known[:, None], c, 0.0)


def _align_layer(layer: Layer, target: Floats) -> Layer:
    """Return a layer, moved frame by frame onto points (n, 3, p) by a similarity.

    It is the best one over the landmarks that both have; frames with fewer than three
    such are nan afterwards, and those that have no target stay where they are.
    """
    both = metrics.visible_in_both(layer["points"], target)
    has_target = np.any(metrics.visible_in_both(target, target), axis=1)
    points = np.where(has_target[:, None, None], np.nan, layer["points"])
    pose = None if layer["pose"] is None else layer["pose"].copy()
    masks, mask_of = np.unique(both, axis=0, return_inverse=True)
    for number, mask in enumerate(masks):
        rows = np.flatnonzero((mask_of.ravel() == number) & has_target)
        if mask.sum() < metrics.MIN_COMMON_LANDMARKS:
            continue
        source = layer["points"][rows]
        move = similarity_transform(source[:, :, mask], target[rows][:, :, mask])
        points[rows] = move.apply(source)
        if pose is not None:
            R = move.rotation @ pose[rows, :9].reshape(-1, 3, 3)
            pose[rows, 10:] = move.apply(pose[rows, 10:, None])[..., 0]
            pose[rows, :9] = R.reshape(-1, 9)
            pose[rows, 9] *= move.scale
    return {
        **layer,
        "points": points,
        "pose": pose,
        "sd": None,
        "camera": None,
        "perspective": False,
    }
