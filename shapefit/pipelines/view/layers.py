"""The layers of a page: results in one space with their meshes, others aligned to the first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from shapefit.arrays import Flags, Floats
from shapefit.convex.solver import Status
from shapefit.dictionary.model import Dictionary
from shapefit.evaluation import metrics
from shapefit.geometry.normalisation import as_metres
from shapefit.geometry.procrustes import similarity_transform
from shapefit.io.layout import METRES_PER_UNIT, UNKNOWN_UNIT
from shapefit.io.records import concatenate
from shapefit.io.writers.metres import EXTRINSIC_ROTATION
from shapefit.io.writers.motion import ANGLE_SD, ANGLES, angle_columns, angle_names
from shapefit.lifting.methods import METHODS
from shapefit.lifting.trust import REASONS
from shapefit.pipelines.view.reading import POSE, Content, Inputs
from shapefit.viewer.scene import Blend, Layer, Measure, MeshSet, Words

CAMERA = ("camera_translation", "focal", "principal_point")
"""Datasets of a result that say how a camera sees its shapes in perspective."""
MOST_MESHES = 200
"""Meshes of shapes that a page holds, at most."""
EXPECTED, AGAINST_TRUTH = "expected error", "error against the truth"
"""Names of measures that the header of the page states."""
SMALL = 0.01
"""Metres below which lengths are given in millimetres."""
SOLVED = (Status.OPTIMAL.value, Status.CONVERGED.value)
IDENTITY_POSE = np.r_[np.eye(3).ravel(), 1.0, 0.0, 0.0, 0.0]
"""The pose of a mesh that stays where it is."""


def make_layers(
    inputs: Inputs, observed: Floats | None, notes: list[str]
) -> tuple[list[Layer], list[MeshSet], str]:
    """Return the layers, those of results first and the truth last, their meshes and the unit.

    All are in the space of the first result, of one with a camera if there is one: in metres where
    it knows them. What is in another space, such as shapes and the truth, is aligned to it. `seen`
    (n, 2, p) are the observed landmarks of the page.
    """
    contents, dictionary, truth = inputs.contents, inputs.dictionary, inputs.truth
    results = [content for content in contents if content.kind == "result"]
    others = joined([content for content in contents if content.kind == "shapes"])
    others += [] if truth is None else [truth]
    layers: list[Layer] = []
    meshes: list[MeshSet] = []
    for content in results:
        layer = _result_layer(content, observed, truth)
        meshed: Layer | None = layer
        if dictionary is not None and dictionary.mesh_vertices is not None:
            meshed = _with_mesh_of_atoms(layer, content, dictionary, meshes)
        if meshed is None:
            notes.append(f"{content.name} has no mesh: it mixes no atoms of this dictionary.")
        layers.append(meshed or layer)
    for content in others:
        role: Literal["truth", "shapes"] = "truth" if content is truth else "shapes"
        angles = () if content is truth else tuple(_angles(content))
        layer = Layer(content.name, role, content.points, measures=angles)
        layers.append(_with_mesh_of_shapes(layer, content, meshes, notes))
    if not results:
        return layers, meshes, contents[0].records.unit
    guide = next(filter(has_camera, results), results[0])
    in_camera, in_metres = _space(guide)
    there = [_space(content) == _space(guide) for content in results] + [False] * len(others)
    target = first_known([each.points for each, stays in zip(layers, there, strict=True) if stays])
    shown, moved, unmatched = [], [], []
    for layer, stays in zip(layers, there, strict=True):
        placed = layer if stays else _aligned(layer, target)
        fits = stays or np.isfinite(placed.points).any()
        shown += [placed] if fits else []
        moved += [layer.name] if fits and not stays else []
        unmatched += [] if fits else [layer.name]
    if unmatched:
        few = "has fewer than 3 landmarks of the same names"
        notes.append(f"Not shown, as {guide.name} {few}: {', '.join(unmatched)}.")
    if moved:
        notes.append(f"Note: {', '.join(moved)} aligned to {guide.name} for display.")
    return shown, meshes, "m" if in_metres else "" if in_camera else guide.records.unit


def joined(shapes: Sequence[Content]) -> list[Content]:
    """Return shapes of different frames, such as a file for each individual, as one."""
    shown = [content.rows >= 0 for content in shapes]
    names = {content.records.landmark_names for content in shapes}
    if len(shapes) < 2 or len(names) > 1 or np.sum(shown, axis=0).max() > 1:
        return list(shapes)
    starts = np.cumsum([0, *(len(content.records) for content in shapes)])
    rows = np.full(len(shown[0]), -1)
    for content, start, there in zip(shapes, starts[:-1], shown, strict=True):
        rows[there] = content.rows[there] + start
    name = ", ".join(content.name for content in shapes)
    records = concatenate([content.records for content in shapes])
    return [replace(shapes[0], name=name, records=records, rows=rows)]


def first_known(arrays: Sequence[Floats]) -> Floats:
    """Return points (n, d, p): of each frame those of the first array that has any."""
    known = arrays[0]
    for points in arrays[1:]:
        empty = ~np.isfinite(known).any(axis=(1, 2), keepdims=True)
        known = np.where(empty, points, known)
    return known


def has_camera(content: Content) -> bool:
    """Whether a result says how a camera sees its shapes in perspective."""
    return {*CAMERA, "translation", "scale"} <= content.records.per_item.keys()


def _space(content: Content) -> tuple[bool, bool]:
    """Whether shapes are where a camera has them, and whether they are in metres."""
    metres = content.per_frame(METRES_PER_UNIT)
    return has_camera(content), metres is not None and bool(np.isfinite(metres).any())


def _result_layer(content: Content, observed: Floats | None, truth: Content | None) -> Layer:
    """Return a result in space: X = factor (S - start) + end for its shapes S."""
    n = len(content.rows)
    in_camera, in_metres = _space(content)
    start = end = np.zeros((n, 3))
    metres = content.per_frame(METRES_PER_UNIT)
    if in_camera:
        scale = content.per_frame("scale")
        factor = metres if in_metres else 1 / scale
        start = np.pad(content.per_frame("translation"), ((0, 0), (0, 1)))
        end = (factor * scale)[:, None] * content.per_frame("camera_translation")
        camera = np.hstack([content.per_frame(name) for name in CAMERA[1:]])
    else:  # depths are unknown, and all frames have one scale
        factor = np.full(n, np.nanmedian(metres) if in_metres else 1.0)
        camera = np.pad(np.repeat(1 / factor[:, None], 2, axis=1), ((0, 0), (0, 2)))
    shapes = content.points
    fitted, sd = content.per_landmark("landmarks_fitted"), content.per_landmark("shape_sd")
    status = content.per_frame("status")
    if status is not None:
        status = np.where(np.isin(status.astype(str), SOLVED), "", status)
        status = status if status.any() else None
    layer = Layer(
        name=content.name,
        role="result",
        points=factor[:, None, None] * (shapes - start[:, :, None]) + end[:, :, None],
        fitted=shapes[:, :2] if fitted is None else fitted,
        sd=None if sd is None else factor[:, None, None] * sd,
        camera=camera,
        perspective=in_camera,
        status=Words.of(status),
        reasons=Words.of(content.per_frame(REASONS)),
        measures=(*_angles(content), *_errors(content, observed, truth)),
    )
    if set(POSE) <= content.records.per_item.keys():
        R = content.per_frame("rotation").reshape(n, 9)
        t = np.pad(content.per_frame("translation"), ((0, 0), (0, 1)))
        at = factor[:, None] * (t - start) + end
        size = factor * content.per_frame("scale")
        layer = replace(layer, pose=np.hstack([R, size[:, None], at]))
    return layer


def _angles(content: Content) -> Iterator[Measure]:
    """Yield the joint angles of a body with their standard deviations, in degrees."""
    records = content.records
    if content.kind == "result":  # no file states which axis of the world of its extrinsics is up
        records = records.without([EXTRINSIC_ROTATION])
    columns = angle_columns(records, None)
    if not columns:
        return
    with_angles = replace(content, records=records.with_columns(columns))
    values, sd = with_angles.per_frame(ANGLES), with_angles.per_frame(ANGLE_SD)
    for number, name in enumerate(angle_names(records.landmark_names)):
        if np.isfinite(values[:, number]).any():
            band = sd[:, number] if np.isfinite(sd[:, number]).any() else None
            yield Measure(name.replace("_", " "), values[:, number], "°", band)


def _errors(content: Content, observed: Floats | None, truth: Content | None) -> Iterator[Measure]:
    """Yield errors of each frame: those in space in metres, or else in the unit of the truth."""
    unit, expected = content.records.unit, content.per_frame("expected_error")
    factor: Any
    factor, length = as_metres(unit if truth is None else truth.records.unit)
    if truth is not None:
        error = metrics.similarity(content.points, truth.points)
        yield Measure(AGAINST_TRUTH, factor * error, length)
    if _space(content)[1] and (truth is None or length == "m"):
        factor, length = content.per_frame(METRES_PER_UNIT), "m"
    elif truth is not None and expected is not None:
        expected = metrics.expected(content.points, truth.points, expected)
    if expected is not None:
        yield Measure(EXPECTED, factor * expected, length)
    p_value = content.per_frame("p_value")
    if p_value is not None:
        yield Measure("p-value", p_value)
    fitted = content.per_landmark("landmarks_fitted")
    if observed is not None and (fitted is not None or not has_camera(content)):
        flat = content.points[:, :2] if fitted is None else fitted
        yield Measure("distance in the image", metrics.reprojection(flat, observed), unit)


def in_usual_units(layers: Sequence[Layer]) -> tuple[list[Layer], tuple[str, float]]:
    """Return layers whose lengths in metres are all in cm or all in mm, that unit and its number.

    Units that are not known are not named.
    """
    lengths = [m.values for layer in layers for m in layer.measures if m.unit == "m"]
    small = any(np.nanmedian(values) < SMALL for values in lengths if np.isfinite(values).any())
    unit, many = ("mm", 1000.0) if small else ("cm", 100.0)
    shown = {"m": (unit, many), UNKNOWN_UNIT: ("", 1.0)}

    def changed(measure: Measure) -> Measure:
        name, factor = shown.get(measure.unit, (measure.unit, 1.0))
        return replace(measure, values=factor * measure.values, unit=name)

    usual = [replace(each, measures=tuple(map(changed, each.measures))) for each in layers]
    return usual, (unit, many)


def _with_mesh_of_atoms(
    layer: Layer, content: Content, dictionary: Dictionary, meshes: list[MeshSet]
) -> Layer | None:
    """Return a result's layer with the meshes of the atoms, mixed by its coefficients.

    None where the result does not mix the atoms of this dictionary by one rotation.
    """
    c = content.per_frame("coefficients")
    method = METHODS.get(str(content.records.attributes.get("method")))
    mixes = method is None or method.mixes_atoms or has_camera(content)
    if not mixes or c is None or c.shape[1] != dictionary.k or layer.pose is None:
        return None
    if not meshes:
        assert dictionary.mesh_vertices is not None
        assert dictionary.mesh_faces is not None
        meshes.append(MeshSet(dictionary.mesh_vertices, dictionary.mesh_faces))
    whole = np.isfinite(c.sum(axis=1) + layer.pose.sum(axis=1))
    return replace(layer, blend=Blend.of(0, np.where(whole[:, None], c, 0.0)))


def _with_mesh_of_shapes(
    layer: Layer, content: Content, meshes: list[MeshSet], notes: list[str]
) -> Layer:
    """Return a layer of shapes with the meshes that they have."""
    vertices, faces = content.records.mesh_vertices, content.records.mesh_faces
    if vertices is None or faces is None:
        return layer
    if len(vertices) > MOST_MESHES:
        notes.append(f"{layer.name} has no meshes here: {len(vertices)} are too many for a page.")
        return layer
    meshes.append(MeshSet(vertices, faces))
    weights = np.eye(len(vertices))[content.rows] * (content.rows >= 0)[:, None]
    pose = np.tile(IDENTITY_POSE, (len(content.rows), 1))
    return replace(layer, pose=pose, blend=Blend.of(len(meshes) - 1, weights))


def _aligned(layer: Layer, target: Floats) -> Layer:
    """Move a layer, frame by frame, onto the points (n, 3, p) by the best similarity.

    Over the landmarks that both have; frames with fewer than three such are nan afterwards, and
    those that have no target stay where they are.
    """
    both: Flags = metrics.visible_in_both(layer.points, target)
    has_target: Flags = np.any(metrics.visible_in_both(target, target), axis=1)
    points = np.where(has_target[:, None, None], np.nan, layer.points)
    pose = None if layer.pose is None else layer.pose.copy()
    masks, which = np.unique(both, axis=0, return_inverse=True)
    for number, mask in enumerate(masks):
        rows = np.flatnonzero((which.ravel() == number) & has_target)
        if mask.sum() < metrics.FEWEST_LANDMARKS:
            continue
        move = similarity_transform(layer.points[rows][:, :, mask], target[rows][:, :, mask])
        points[rows] = move.apply(layer.points[rows])
        if pose is not None:
            R = move.rotation @ pose[rows, :9].reshape(-1, 3, 3)
            pose[rows, 10:] = move.apply(pose[rows, 10:, None])[..., 0]
            pose[rows, :9] = R.reshape(-1, 9)
            pose[rows, 9] *= move.scale
    return replace(layer, points=points, pose=pose, sd=None, camera=None, perspective=False)
