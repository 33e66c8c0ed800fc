"""From the numbers of the files to the layers of a page: shapes, meshes, measures of each frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.convex.solution import Status
from shapefit.dictionary.model import Dictionary
from shapefit.evaluation import metrics
from shapefit.geometry.procrustes import similarity_transform
from shapefit.lifting.methods import METHODS
from shapefit.lifting.verdict import DOUBT
from shapefit.pipelines.export.origin import fit_config
from shapefit.pipelines.view.gathering import CAMERA, JUDGEMENTS, Gathered
from shapefit.viewer.scene import Blend, Layer, Measure

SEVERITY = {
    Status.OPTIMAL.value: 0.1,
    Status.CONVERGED.value: 0.1,
    Status.ITERATION_LIMIT.value: 0.6,
}
"""How bad a status is, from 0 to 1; others are failures, which have no number."""

SAME = 1e-3
"""Fitted landmarks within this share of the extent of x and y of the shape are those."""


def result_layer(gathered: Gathered, seen: Floats | None) -> Layer:
    """Return the layer of a result; `seen` (n, 2, p) are the observed landmarks of the page."""
    points = gathered.points
    fitted = gathered.of_frames.get("landmarks_fitted")
    fitted = None if fitted is None else fitted.swapaxes(1, 2)
    sd = gathered.of_frames.get("shape_sd")
    status, doubts = gathered.texts.get("status"), gathered.texts.get(DOUBT)
    camera = _camera(gathered)
    return Layer(
        name=gathered.name,
        role="result",
        points=points,
        fitted=None if camera is not None or _are_x_and_y(fitted, points) else fitted,
        sd=None if sd is None else sd.swapaxes(1, 2),
        pose=None if camera is None else _pose(gathered),
        camera=camera,
        status=None if status is None else tuple(status),
        doubts=None if doubts is None else tuple(doubts),
        measures=tuple(_measures(gathered, seen)),
    )


def with_mesh(layer: Layer, gathered: Gathered, mesh_set: int) -> Layer:
    """Return a result's layer with the meshes of the atoms, mixed and placed as the shape is."""
    c = gathered.of_frames["coefficients"]
    pose = _pose(gathered)
    whole: NDArray[np.bool_] = np.isfinite(c.sum(axis=1) + pose.sum(axis=1))
    used = np.where(whole[:, None], c, 0.0) != 0
    frames, atoms = np.nonzero(used)
    return replace(layer, pose=pose, blend=_blend(mesh_set, frames, atoms, c[used], len(c)))


def mesh_obstacle(gathered: Gathered, dictionary: Dictionary) -> str | None:
    """Say why the meshes of a dictionary cannot follow this result; None where they can."""
    found = gathered.of_frames
    needed = ("coefficients", "rotation", "scale", "translation")
    if lacking := [name for name in needed if name not in found]:
        return f"it has no {' and no '.join(lacking)}"
    if found["coefficients"].shape[1] != dictionary.k:
        count = found["coefficients"].shape[1]
        return f"its {count} coefficients are not those of {dictionary.k} atoms"
    name = str(gathered.attributes.get("method"))
    method = METHODS.get(name)
    if method is not None and not method.mixes_atoms and _camera(gathered) is None:
        return f"method {name} gives no coefficients to combine the atoms' meshes"
    return None


def shape_layer(
    name: str, role: str, points: Floats, mesh: tuple[int, NDArray[np.intp]] | None = None
) -> Layer:
    """Return the layer of shapes that no image was fitted with.

    mesh: number of the mesh set, and the mesh (n,) of each frame, -1 for none.
    """
    layer = Layer(name=name, role="truth" if role == "truth" else "shapes", points=points)
    if mesh is None:
        return layer
    mesh_set, which = mesh
    frames = np.flatnonzero(which >= 0)
    pose = np.tile(np.r_[np.eye(3).ravel(), 1.0, 0.0, 0.0, 0.0], (len(points), 1))
    one = np.ones(len(frames))
    return replace(
        layer, pose=pose, blend=_blend(mesh_set, frames, which[frames], one, len(points))
    )


def laid_onto(layer: Layer, target: Floats) -> Layer:
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
            shifted = (move.rotation @ pose[rows, 10:, None])[..., 0]
            pose[rows, :9] = R.reshape(-1, 9)
            pose[rows, 10:] = move.scale[:, None] * shifted + move.translation
            pose[rows, 9] *= move.scale
    return replace(layer, points=points, pose=pose)


def with_error(layer: Layer, truth: Floats, unit: str) -> Layer:
    """Return a result's layer with its similarity error against the truth (n, 3, p), first."""
    error = metrics.similarity(layer.points, truth)
    if not np.isfinite(error).any():
        return layer
    return replace(layer, measures=(Measure("error", error, unit=unit), *layer.measures))


def _measures(gathered: Gathered, seen: Floats | None) -> Iterator[Measure]:
    """Yield what is known of each frame, what says most about it first."""
    found = gathered.of_frames
    posterior = fit_config(gathered.attributes).get("posterior")
    limit = posterior.get("implausible") if isinstance(posterior, dict) else None
    limits = {"plausibility": limit if isinstance(limit, float) else None}
    for name in JUDGEMENTS:
        if name in found and found[name].ndim == 1:
            limit = limits.get(name)
            yield Measure(name.replace("_", " "), found[name], bad="low", limit=limit)
    if seen is not None:
        fitted = found.get("landmarks_fitted")
        flat = gathered.points[:, :2] if fitted is None else fitted.swapaxes(1, 2)
        error = metrics.reprojection(flat, seen)
        yield Measure("reprojection", error, unit=gathered.listings[0].unit)
    if "relative_gap" in found and np.isfinite(found["relative_gap"]).any():
        yield Measure("relative gap", found["relative_gap"], scale="log")
    if "status" in gathered.texts:
        levels = np.array([SEVERITY.get(word, np.nan) for word in gathered.texts["status"]])
        yield Measure("status", levels, scale="share")


def _are_x_and_y(fitted: Floats | None, points: Floats) -> bool:
    if fitted is None:
        return True
    known = metrics.visible_in_both(fitted, points[:, :2])
    if not known.any():
        return True
    values = fitted.swapaxes(1, 2)[known]
    away = np.abs(values - points[:, :2].swapaxes(1, 2)[known]).max()
    return bool(away <= SAME * np.ptp(values, axis=0).max())


def _pose(gathered: Gathered) -> Floats:
    """Rotation, scale and translation (n, 13) that carry the atoms into the frame of the shapes."""
    found = gathered.of_frames
    n = len(gathered.points)
    R, t = found["rotation"].reshape(n, 9), found["translation"]
    return np.concatenate([R, found["scale"][:, None], t, np.zeros((n, 1))], axis=1)


def _camera(gathered: Gathered) -> Floats | None:
    found = gathered.of_frames
    shapes = [found[name].shape[1:] for name in CAMERA if name in found]
    if shapes != [(3,), (2,), (2,)] or not {"rotation", "translation", "scale"} <= found.keys():
        return None
    return np.concatenate([found[name] for name in CAMERA], axis=1)


def _blend(
    mesh_set: int, frames: NDArray[np.intp], atoms: NDArray[np.intp], weight: Floats, n: int
) -> Blend:
    """Lay out weights by frame; `frames` ascend."""
    start = np.searchsorted(frames, np.arange(n + 1))
    return Blend(mesh_set, start, atoms, weight)
