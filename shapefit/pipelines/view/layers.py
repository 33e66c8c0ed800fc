"""The layers of a page: results in one space with their meshes, shapes and truth laid onto them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.convex.solver import Status
from shapefit.dictionary.model import Dictionary
from shapefit.evaluation import metrics
from shapefit.geometry.cameras import IMAGE_UP, TO_Y_UP
from shapefit.geometry.joint_angles import known_angles, measure_angles
from shapefit.geometry.normalisation import metres_in
from shapefit.geometry.procrustes import similarity_transform
from shapefit.io.layout import METRES_PER_UNIT, UNKNOWN_UNIT
from shapefit.io.skeletons import joint_columns
from shapefit.lifting.methods import METHODS
from shapefit.lifting.verdict import REASONS
from shapefit.pipelines.view.reading import CAMERA, POSE, Gathered, Truth
from shapefit.viewer.scene import Blend, Layer, Measure, MeshSet, Words

MOST_MESHES = 200
"""Meshes of shapes that a page holds, at most."""
SAME = 1e-3
"""Fitted landmarks within this share of the extent of x and y of the shape are those."""
EXPECTED, AGAINST_TRUTH = "expected error", "error against the truth"
"""Names of measures that the header of the page states."""
SMALL = 0.01
"""Metres below which lengths are given in millimetres."""


@dataclass(frozen=True)
class Placement:
    """X = factor (S - start) + end: from the shapes S of a result to the space of the page.

    factor (n,), start and end (n, 3). Under a camera, X is where the camera has it.
    """

    factor: Floats
    start: Floats
    end: Floats
    perspective: bool

    def of(self, points: Floats) -> Floats:
        """Return points (n, 3, p) in space."""
        moved = points - self.start[:, :, None]
        return self.factor[:, None, None] * moved + self.end[:, :, None]


def place_results(results: Sequence[Gathered]) -> tuple[list[Placement], str | None]:
    """Return where each result is in one space, and the unit of it; None for that of the files.

    The unit is the metre where the first result knows it. Of a result through a camera, shapes are
    where the camera has them, and those of the others beside it. Without one, depths are unknown,
    and all frames have one scale.
    """
    guide = next((each for each in results if has_camera(each)), results[0] if results else None)
    if guide is None:
        return [], None
    n = len(guide.points)
    metres = guide.of_frames.get(METRES_PER_UNIT)
    known = metres is not None and np.isfinite(metres).any()
    if not has_camera(guide):
        factor = np.nanmedian(metres) if metres is not None and known else 1.0
        still = np.zeros((n, 3))
        whole = Placement(np.full(n, factor), still, still, perspective=False)
        return [whole] * len(results), "m" if known else None

    def of(own: Gathered) -> Placement:
        found = own.of_frames
        scale = found["scale"]
        factor = found.get(METRES_PER_UNIT, scale * np.nan) if known else 1 / scale
        start = np.pad(found["translation"], ((0, 0), (0, 1)))
        end = (factor * scale)[:, None] * found["camera_translation"]
        return Placement(factor, start, end, perspective=True)

    return [of(each if has_camera(each) else guide) for each in results], "m" if known else ""


def make_layers(
    found: Sequence[Gathered],
    dictionary: Dictionary | None,
    seen: Floats | None,
    truth: Truth | None,
    notes: list[str],
) -> tuple[list[Layer], list[MeshSet], str | None]:
    """Return results first, then what is laid onto the first of them, the truth last.

    Also the meshes that they have, those of the dictionary first, and the unit of the space, None
    for that of the files. `seen` (n, 2, p) are the observed landmarks of the page.
    """
    results = [each for each in found if each.kind == "result"]
    placements, unit = place_results(results)
    layers: list[Layer] = []
    others: list[Layer] = []
    meshes: list[MeshSet] = []
    for each, placement in zip(results, placements, strict=True):
        layer = _result_layer(each, placement, seen, truth)
        if dictionary is not None and dictionary.mesh_vertices is not None:
            if obstacle := _mesh_obstacle(each, dictionary):
                notes.append(f"{each.name} has no mesh: {obstacle}.")
            else:
                if not meshes:
                    assert dictionary.mesh_faces is not None
                    meshes.append(MeshSet(dictionary.mesh_vertices, dictionary.mesh_faces))
                layer = _with_mesh(layer, each, placement, 0)
        layers.append(layer)
    for each in joined([each for each in found if each.kind == "shapes"]):
        rows = np.array([f if f in each.mesh_vertices else -1 for f in range(len(each.points))])
        layer = Layer(each.name, "shapes", each.points, measures=tuple(angle_measures(each)))
        others.append(
            _with_own_meshes(layer, each.mesh_vertices, each.mesh_faces, rows, meshes, notes)
        )
    if truth is not None:
        shapes = truth.shapes
        layer = Layer("truth", "truth", truth.points)
        own = dict(enumerate(() if shapes.mesh_vertices is None else shapes.mesh_vertices))
        others.append(_with_own_meshes(layer, own, shapes.mesh_faces, truth.rows, meshes, notes))
    target = first_known(layer.points for layer in layers)
    if target is not None and others:
        others = [_laid_onto(layer, target) for layer in others]
        strange = [layer.name for layer in others if not np.isfinite(layer.points).any()]
        others = [layer for layer in others if layer.name not in strange]
        if strange:
            fewest = f"fewer than {metrics.FEWEST_LANDMARKS} landmarks of the same names"
            notes.append(f"Not shown, for {results[0].name} has {fewest}: {', '.join(strange)}.")
        if others:
            laid = ", ".join(layer.name for layer in others)
            notes.append(f"Note: {laid} aligned to {results[0].name} for display.")
    return layers + others, meshes, unit


def joined(shapes: Sequence[Gathered]) -> Sequence[Gathered]:
    """Return files of shapes of different frames, such as one for each individual, as one."""
    held = [np.isfinite(each.points).any(axis=(1, 2)) for each in shapes]
    if len(shapes) < 2 or np.sum(held, axis=0).max() > 1:
        return shapes
    whole = replace(shapes[0], name=", ".join(each.name for each in shapes))
    whole.points = first_known(each.points for each in shapes)  # type: ignore[assignment]
    whole.mesh_vertices = {f: v for each in shapes for f, v in each.mesh_vertices.items()}
    whole.mesh_faces = next((s.mesh_faces for s in shapes if s.mesh_faces is not None), None)
    return [whole]


def first_known(arrays: Iterable[Floats]) -> Floats | None:
    """Points (n, d, p): those of the first array that has any of a frame."""
    known: Floats | None = None
    for points in arrays:
        empty = True if known is None else ~np.isfinite(known).any(axis=(1, 2), keepdims=True)
        known = np.where(empty, points, points if known is None else known)
    return known


def _result_layer(
    gathered: Gathered, placement: Placement, seen: Floats | None, truth: Truth | None
) -> Layer:
    """Return the layer of a result."""
    found, n = gathered.of_frames, len(gathered.points)
    camera = None
    if placement.perspective and has_camera(gathered):
        camera = np.concatenate([found["focal"], found["principal_point"]], axis=1)
    elif not placement.perspective and (placement.factor != 1).any():
        one = 1 / placement.factor[:, None]
        camera = np.concatenate([one, one, np.zeros((n, 2))], axis=1)
    points = placement.of(gathered.points)
    fitted = found.get("landmarks_fitted")
    if fitted is None and placement.perspective and camera is None:
        fitted = gathered.points[:, :2]
    status = gathered.texts.get("status", np.full(n, "", object))
    good = np.isin(status.astype(str), [Status.OPTIMAL.value, Status.CONVERGED.value])
    sd = found.get("shape_sd")
    return Layer(
        name=gathered.name,
        role="result",
        points=points,
        fitted=None if _are_there(fitted, points, camera, placement.perspective) else fitted,
        sd=None if sd is None else placement.factor[:, None, None] * sd,
        camera=camera,
        perspective=placement.perspective and camera is not None,
        status=None if good.all() else Words.of(np.where(good, "", status)),
        doubts=Words.of(gathered.texts.get(REASONS)),
        measures=tuple(_measures(gathered, seen, truth)),
    )


def _measures(gathered: Gathered, seen: Floats | None, truth: Truth | None) -> Iterator[Measure]:
    """Yield what is known of each frame: joint angles first, then errors."""
    found = gathered.of_frames
    unit = gathered.listings[0].unit
    yield from angle_measures(gathered)
    if truth is not None:
        error = metrics.similarity(gathered.points, truth.points)
        if np.isfinite(error).any():
            yield in_length(AGAINST_TRUTH, error, 1.0, truth.shapes.unit)
    if "expected_error" in found:
        metres = found.get(METRES_PER_UNIT)
        if metres is not None and np.isfinite(metres).any():
            yield in_length(EXPECTED, found["expected_error"], metres, "m")
        else:
            yield in_length(EXPECTED, found["expected_error"], 1.0, unit)
    if "p_value" in found and np.isfinite(found["p_value"]).any():
        yield Measure("p-value", found["p_value"])
    if seen is not None and ("landmarks_fitted" in found or not has_camera(gathered)):
        flat = found.get("landmarks_fitted", gathered.points[:, :2])
        yield in_length("distance in the image", metrics.reprojection(flat, seen), 1.0, unit)


def angle_measures(gathered: Gathered) -> Iterator[Measure]:
    """Yield the joint angles of a body with their standard deviations, in degrees.

    Up is up in the image, or the axis y of shapes.
    """
    joints = joint_columns(gathered.landmark_names)
    angles = known_angles(joints)
    if not angles:
        return
    sd = gathered.of_frames.get("shape_sd")
    covariance = None if sd is None else np.eye(3) * sd.swapaxes(1, 2)[..., None] ** 2
    up = TO_Y_UP[IMAGE_UP][1] if gathered.y_down else np.array([0.0, 1.0, 0.0])
    values, deviations = measure_angles(gathered.points, up, joints, covariance)
    for number, angle in enumerate(angles):
        if np.isfinite(values[:, number]).any():
            band = deviations[:, number] if covariance is not None else None
            yield Measure(angle.name.replace("_", " "), values[:, number], "°", band)


def in_length(name: str, values: Floats, factor: Floats | float, unit: str) -> Measure:
    """Return lengths as people say them: in centimetres or millimetres where the unit is known."""
    metres = metres_in(unit)
    if metres is None:
        return Measure(name, values * factor, unit="" if unit == UNKNOWN_UNIT else unit)
    values = values * factor * metres
    finite = values[np.isfinite(values)]
    if len(finite) and np.median(finite) < SMALL:
        return Measure(name, 1000 * values, unit="mm")
    return Measure(name, 100 * values, unit="cm")


def _are_there(
    fitted: Floats | None, points: Floats, camera: Floats | None, perspective: bool
) -> bool:
    """Whether the camera of the layer has the points where they were fitted, or nothing was."""
    if fitted is None:
        return True
    there = points[:, :2]
    if camera is not None:
        with np.errstate(divide="ignore"):
            share = 1 / np.abs(points[:, 2:]) if perspective else 1.0
        there = camera[:, :2, None] * there * share + camera[:, 2:, None]
    known = metrics.visible_in_both(fitted, there)
    if not known.any():
        return True
    values = fitted.swapaxes(1, 2)[known]
    away = np.abs(values - there.swapaxes(1, 2)[known]).max()
    return bool(away <= SAME * np.ptp(values, axis=0).max())


def has_camera(gathered: Gathered) -> bool:
    """Whether a result says how a camera sees its shapes in perspective."""
    found = gathered.of_frames
    shapes = [found[name].shape[1:] for name in CAMERA if name in found]
    placed = {"rotation", "translation", "scale"} <= found.keys()
    return placed and shapes == [(3,), (2,), (2,)]


def _mesh_obstacle(gathered: Gathered, dictionary: Dictionary) -> str | None:
    """Say why the meshes of a dictionary cannot follow this result; None where they can."""
    found = gathered.of_frames
    if lacking := sorted({*POSE} - found.keys()):
        return f"it has no {' and no '.join(lacking)}"
    if (count := found["coefficients"].shape[1]) != dictionary.k:
        return f"its {count} coefficients are not those of {dictionary.k} atoms"
    name = str(gathered.attributes.get("method"))
    method = METHODS.get(name)
    if method is not None and not method.mixes_atoms and not has_camera(gathered):
        return f"method {name} gives no coefficients to combine the atoms' meshes"
    return None


def _with_mesh(layer: Layer, gathered: Gathered, placement: Placement, mesh_set: int) -> Layer:
    """Return a result's layer with the meshes of the atoms, mixed and placed as the shape is."""
    found, n = gathered.of_frames, len(gathered.points)
    c, t = found["coefficients"], np.pad(found["translation"], ((0, 0), (0, 1)))
    scale, at = placement.factor * found["scale"], placement.of(t[:, :, None])[..., 0]
    pose = np.concatenate([found["rotation"].reshape(n, 9), scale[:, None], at], axis=1)
    whole: NDArray[np.bool_] = np.isfinite(c.sum(axis=1) + pose.sum(axis=1))
    used = np.where(whole[:, None], c, 0.0) != 0
    frames, atoms = np.nonzero(used)
    start = np.searchsorted(frames, np.arange(len(c) + 1))
    return replace(layer, pose=pose, blend=Blend(mesh_set, start, atoms, c[used]))


def _with_own_meshes(
    layer: Layer,
    vertices: Mapping[int, Floats],
    faces: NDArray[np.int64] | None,
    rows: NDArray[np.intp],
    meshes: list[MeshSet],
    notes: list[str],
) -> Layer:
    """Return a layer of shapes whose frame j shows vertices[rows[j]] (3, q), nothing where -1."""
    used = np.unique(rows[rows >= 0])
    if not vertices or faces is None or not len(used):
        return layer
    if len(used) > MOST_MESHES:
        notes.append(f"{layer.name} has no meshes here: {len(used)} are too many for a page.")
        return layer
    meshes.append(MeshSet(np.stack([vertices[row] for row in used]), faces))
    frames = np.flatnonzero(rows >= 0)
    start = np.searchsorted(frames, np.arange(len(rows) + 1))
    which = np.searchsorted(used, rows[frames])
    pose = np.tile(np.r_[np.eye(3).ravel(), 1.0, 0.0, 0.0, 0.0], (len(rows), 1))
    blend = Blend(len(meshes) - 1, start, which, np.ones(len(frames)))
    return replace(layer, pose=pose, blend=blend)


def _laid_onto(layer: Layer, target: Floats) -> Layer:
    """Move a layer, frame by frame, onto the points (n, 3, p) by the best similarity.

    Over the landmarks that both have; frames with fewer than three such are nan afterwards, and
    those that have no target stay where they are.
    """
    both: NDArray[np.bool_] = metrics.visible_in_both(layer.points, target)
    has_target = np.any(metrics.visible_in_both(target, target), axis=1)
    frames = np.flatnonzero(has_target)
    points = np.where(has_target[:, None, None], np.nan, layer.points)
    pose = None if layer.pose is None else layer.pose.copy()
    masks, which = np.unique(both[frames], axis=0, return_inverse=True)
    for number, mask in enumerate(masks):
        rows = frames[which.ravel() == number]
        if mask.sum() < metrics.FEWEST_LANDMARKS:
            continue
        move = similarity_transform(layer.points[rows][:, :, mask], target[rows][:, :, mask])
        points[rows] = move.apply(layer.points[rows])
        if pose is not None:
            R = move.rotation @ pose[rows, :9].reshape(-1, 3, 3)
            pose[rows, 10:] = move.apply(pose[rows, 10:, None])[..., 0]
            pose[rows, :9] = R.reshape(-1, 9)
            pose[rows, 9] *= move.scale
    return replace(layer, points=points, pose=pose)
