"""The scene of a page, put together from its files: layers, meshes, measures, sides, moments."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.config import ViewConfig
from shapefit.convex.solver import Status
from shapefit.dictionary.model import Dictionary
from shapefit.errors import counted
from shapefit.evaluation import metrics
from shapefit.geometry.procrustes import lateral_axis, similarity_transform
from shapefit.io import read_dictionary
from shapefit.io.foreign.items import FRAME
from shapefit.io.joined import agreed
from shapefit.io.layout import UNKNOWN_UNIT
from shapefit.io.listing import Listing
from shapefit.io.skeletons import edges_of
from shapefit.lifting.methods import METHODS
from shapefit.lifting.verdict import DOUBT
from shapefit.pipelines.view.images import MEGABYTES, embed_images
from shapefit.pipelines.view.reading import (
    CAMERA,
    JUDGEMENTS,
    POSE,
    Frames,
    Gathered,
    Truth,
    as_judged,
    fit_config,
    fit_dictionary,
    gather,
    read_truth,
    renamed_edges,
)
from shapefit.viewer.scene import (
    RATE_OF_IMAGES,
    USUAL_RATE,
    Blend,
    Layer,
    Measure,
    MeshSet,
    Scene,
    Words,
)

MOST_MESHES = 200
"""Meshes of shapes that a page holds, at most."""
SEVERITY = {
    Status.OPTIMAL.value: 0.1,
    Status.CONVERGED.value: 0.1,
    Status.ITERATION_LIMIT.value: 0.6,
}
"""How bad a status is, from 0 to 1; others are failures, which have no number."""
SAME = 1e-3
"""Fitted landmarks within this share of the extent of x and y of the shape are those."""
MIDDLE, LEFT, RIGHT = 0, 1, 2
OTHER_SIDE = {"left": "right", "Left": "Right", "LEFT": "RIGHT", "l": "r", "L": "R"}
WORD_LEFT = re.compile(r"left|Left|LEFT|(?<![A-Za-z])[lL](?![a-z])|^[lL](?=[A-Za-z])")
"""`left` anywhere, `l` alone, and `l` before a name: left_hip, HipLeft, L_Hip, LHip, lhip."""
FILES = "*"
"""In the place of a video: files of one individual each, which are shown together."""


def assemble(
    config: ViewConfig, listings: Mapping[str, Sequence[Listing]], frames: Frames
) -> Scene:
    """Return the scene of these frames, with notes on what it lacks."""
    notes: list[str] = []
    if frames.step > 1:
        notes.append(
            f"Every {_ordinal(frames.step)} of {frames.count:,} frames is shown: with all of "
            f"them the page would be larger than {MEGABYTES} MB. `items` chooses others."
        )
    listings = {name: [as_judged(config, one) for one in own] for name, own in listings.items()}
    every = [listing for own in listings.values() for listing in own]
    landmarks = tuple(dict.fromkeys(name for one in every for name in one.landmark_names))
    found = [gather(n, own, frames, landmarks, config.match) for n, own in listings.items()]
    results = [each for each in found if each.kind == "result"]
    truth = read_truth(config, results, frames, landmarks) if config.truth else None
    seen = _first_known(e.of_frames["landmarks"] for e in found if "landmarks" in e.of_frames)
    known = _dictionaries(config, results, notes)
    layers, meshes, edges = _layers(found, known, seen, truth, landmarks, notes)
    _note_what_lacks(layers, seen, edges, notes)
    named = find_sides(landmarks)
    halves = (_halves(dictionary, landmarks) for _, dictionary in known if dictionary is not None)
    outliers = [each.of_frames["outliers"] == 1 for each in results if "outliers" in each.of_frames]
    images = any(one.kind != "shapes" for one in every)
    unsaid = (config.input.y_axis or "down") if images else "up"
    y_axis = agreed("y_axis", [(str(one.path), one.y_axis) for one in every]) or unsaid
    rates = [config.frame_rate, *(one.frame_rate for one in every)]
    rates += [] if truth is None else [truth.frame_rate]
    rate = next((rate for rate in rates if rate is not None and rate < 1e6), None)
    in_motion = any(name for name, _ in frames.sequences)
    pictures = {} if config.images is None else embed_images(config.images, frames.items)
    if config.images is not None and len(pictures) < len(frames.items):
        notes.append(f"{len(pictures)} of {counted(len(frames.items), 'frame')} have a picture.")
    return Scene(
        title=", ".join(listings) + (" and the truth" if truth else ""),
        items=frames.items,
        sequences=frames.sequences,
        landmarks=landmarks,
        edges=[] if edges is None else edges.tolist(),
        layers=layers,
        unit=_shown(every[0].unit),
        y_down=y_axis == "down",
        frame_rate=rate / frames.step if rate else USUAL_RATE if in_motion else RATE_OF_IMAGES,
        rate_known=rate is not None,
        flat=seen is not None or bool(results),
        seen=seen,
        outliers=np.logical_or.reduce(outliers) if np.any(outliers) else None,
        sides=named if any(named) else next(filter(any, halves), None),
        sides_named=any(named),
        moments=find_moments(found, frames),
        meshes=meshes,
        pictures=pictures,
        notes=tuple(notes),
    )


def find_sides(names: Sequence[str]) -> list[int]:
    """Return MIDDLE, LEFT or RIGHT for each name; what has no counterpart is in the middle."""
    place = {name: number for number, name in enumerate(names)}
    sides = [MIDDLE] * len(names)
    for name, number in place.items():
        for found in WORD_LEFT.finditer(name):
            other = name[: found.start()] + OTHER_SIDE[found[0]] + name[found.end() :]
            if other in place:
                sides[number], sides[place[other]] = LEFT, RIGHT
    return sides


def _halves(dictionary: Dictionary, names: Sequence[str]) -> list[int]:
    """Return one side and the other for the landmarks that `mirror_index` pairs.

    They are those of the mean shape. Which of them is the left one is not known.
    """
    partner = dictionary.mirror_index
    if partner is None:
        return [MIDDLE] * len(names)
    mean = dictionary.mean_shape[lateral_axis(dictionary.mean_shape, partner)]
    sides = np.where(mean > mean[partner], LEFT, RIGHT)
    sides[partner == np.arange(len(partner))] = MIDDLE
    side_of = dict(zip(dictionary.landmark_names, sides.tolist(), strict=True))
    return [side_of.get(name, MIDDLE) for name in names]


def find_moments(found: Sequence[Gathered], frames: Frames) -> Integers | None:
    """Return a number (n,) that frames of one moment share, 0 for others; None where all are 0.

    The individuals of a video are its sequences, `video/individual`; or each is a file. Frames of
    one moment have the same number in the dataset `frame`.
    """
    owner = {item: each.name for each in found for one in each.listings for item in one.items}
    numbers = np.full(len(frames.items), np.nan)
    for each in found:
        numbers = np.where(np.isfinite(numbers), numbers, each.of_frames.get(FRAME, np.nan))
    starts = [*(start for _, start in frames.sequences), len(frames.items)]
    owners = [owner.get(frames.items[start]) for start in starts[:-1]]
    each_a_file = len(set(owners)) == len(owners)
    members: dict[tuple[str, int], list[int]] = {}
    for (name, _), (start, end) in zip(frames.sequences, pairwise(starts), strict=True):
        video = name.rpartition("/")[0] or (FILES if name and each_a_file else "")
        for frame in range(start, end) if video else ():
            if np.isfinite(numbers[frame]):
                members.setdefault((video, int(numbers[frame])), []).append(frame)
    moments = np.zeros(len(frames.items), dtype=np.int64)
    for moment, several in enumerate((m for m in members.values() if len(m) > 1), 1):
        moments[several] = moment
    return moments if moments.any() else None


def _dictionaries(
    config: ViewConfig, results: Sequence[Gathered], notes: list[str]
) -> list[tuple[Path | None, Dictionary | None]]:
    """Return the dictionary of each result: that of the config, else that of the fit.

    The one of the config is there where there is no result, too.
    """
    if config.dictionary is not None:
        return [(config.dictionary, read_dictionary(config.dictionary))] * max(1, len(results))
    known: list[tuple[Path | None, Dictionary | None]] = []
    for result in results:
        path, dictionary = fit_dictionary(result.attributes)
        if isinstance(dictionary, Dictionary):
            known.append((path, dictionary))
            continue
        if path is not None:
            why = f"its dictionary {path.name} {dictionary}"
            notes.append(f"{result.name}: {why}; -d DICT.h5 names another.")
        known.append((None, None))
    return known


def _layers(
    found: Sequence[Gathered],
    known: Sequence[tuple[Path | None, Dictionary | None]],
    seen: Floats | None,
    truth: Truth | None,
    landmarks: Sequence[str],
    notes: list[str],
) -> tuple[list[Layer], list[MeshSet], NDArray[np.int64] | None]:
    """Results first, then what is laid onto the first of them, the truth last."""
    results = [each for each in found if each.kind == "result"]
    layers: list[Layer] = []
    others: list[Layer] = []
    meshes: list[MeshSet] = []
    set_of: dict[Path, int] = {}
    dictionaries = [dictionary for _, dictionary in known if dictionary is not None]
    edges = [renamed_edges(one.edges, one.landmark_names, landmarks) for one in dictionaries]
    for each, (path, dictionary) in zip(results, known, strict=False):
        layer = _result_layer(each, seen, truth)
        if path is not None and dictionary is not None and dictionary.mesh_vertices is not None:
            if obstacle := _mesh_obstacle(each, dictionary):
                notes.append(f"{each.name} has no mesh: {obstacle}.")
            else:
                if path not in set_of:
                    set_of[path] = len(meshes)
                    assert dictionary.mesh_faces is not None
                    meshes.append(MeshSet(dictionary.mesh_vertices, dictionary.mesh_faces))
                layer = _with_mesh(layer, each, set_of[path])
        layers.append(layer)
    for each in (each for each in found if each.kind == "shapes"):
        rows = np.array([f if f in each.mesh_vertices else -1 for f in range(len(each.points))])
        layer = Layer(each.name, "shapes", each.points)
        others.append(
            _with_own_meshes(layer, each.mesh_vertices, each.mesh_faces, rows, meshes, notes)
        )
        edges.append(each.edges)
    if truth is not None:
        shapes = truth.shapes
        layer = Layer("truth", "truth", truth.points)
        own = dict(enumerate(() if shapes.mesh_vertices is None else shapes.mesh_vertices))
        others.append(_with_own_meshes(layer, own, shapes.mesh_faces, truth.rows, meshes, notes))
        edges.append(renamed_edges(shapes.edges, shapes.landmark_names, landmarks))
    target = _first_known(layer.points for layer in layers)
    if target is not None and others:
        laid = ", ".join(layer.name for layer in others)
        notes.append(f"Aligned with {results[0].name} by the best similarity: {laid}.")
        others = [_laid_onto(layer, target) for layer in others]
    edges += [each.edges for each in found]
    edges += [np.array(usual) for usual in [edges_of(landmarks)] if usual]
    return layers + others, meshes, next((each for each in edges if each is not None), None)


def _first_known(arrays: Iterable[Floats]) -> Floats | None:
    """Points (n, d, p): those of the first array that has any of a frame."""
    known: Floats | None = None
    for points in arrays:
        empty = True if known is None else ~np.isfinite(known).any(axis=(1, 2), keepdims=True)
        known = np.where(empty, points, points if known is None else known)
    return known


def _result_layer(gathered: Gathered, seen: Floats | None, truth: Truth | None) -> Layer:
    """Return the layer of a result; `seen` (n, 2, p) are the observed landmarks of the page."""
    found, points = gathered.of_frames, gathered.points
    fitted = found.get("landmarks_fitted")
    camera = _camera(gathered)
    return Layer(
        name=gathered.name,
        role="result",
        points=points,
        fitted=None if camera is not None or _are_x_and_y(fitted, points) else fitted,
        sd=found.get("shape_sd"),
        pose=None if camera is None else _pose(gathered),
        camera=camera,
        status=Words.of(gathered.texts.get("status")),
        doubts=Words.of(gathered.texts.get(DOUBT)),
        measures=tuple(_measures(gathered, seen, truth)),
    )


def _measures(gathered: Gathered, seen: Floats | None, truth: Truth | None) -> Iterator[Measure]:
    """Yield what is known of each frame, what says most about it first."""
    found = gathered.of_frames
    if truth is not None:
        error = metrics.similarity(gathered.points, truth.points)
        if np.isfinite(error).any():
            yield Measure("error", error, unit=_shown(truth.shapes.unit))
    posterior = fit_config(gathered.attributes).get("posterior")
    limit = posterior.get("implausible") if isinstance(posterior, dict) else None
    limits = {"plausibility": limit if isinstance(limit, float) else None}
    for name in JUDGEMENTS:
        if name in found and found[name].ndim == 1:
            label = name.replace("_", " ")
            yield Measure(label, found[name], bad="low", limit=limits.get(name))
    if seen is not None:
        flat = found.get("landmarks_fitted", gathered.points[:, :2])
        error = metrics.reprojection(flat, seen)
        yield Measure("reprojection", error, unit=_shown(gathered.listings[0].unit))
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


def _mesh_obstacle(gathered: Gathered, dictionary: Dictionary) -> str | None:
    """Say why the meshes of a dictionary cannot follow this result; None where they can."""
    found = gathered.of_frames
    if lacking := sorted({*POSE} - found.keys()):
        return f"it has no {' and no '.join(lacking)}"
    if (count := found["coefficients"].shape[1]) != dictionary.k:
        return f"its {count} coefficients are not those of {dictionary.k} atoms"
    name = str(gathered.attributes.get("method"))
    method = METHODS.get(name)
    if method is not None and not method.mixes_atoms and _camera(gathered) is None:
        return f"method {name} gives no coefficients to combine the atoms' meshes"
    return None


def _with_mesh(layer: Layer, gathered: Gathered, mesh_set: int) -> Layer:
    """Return a result's layer with the meshes of the atoms, mixed and placed as the shape is."""
    c = gathered.of_frames["coefficients"]
    pose = _pose(gathered)
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


def _note_what_lacks(
    layers: Sequence[Layer],
    seen: Floats | None,
    edges: NDArray[np.int64] | None,
    notes: list[str],
) -> None:
    if not layers:
        notes.append("There are only landmarks here, and nothing in 3D.")
    results = [layer for layer in layers if layer.role == "result"]
    if results and seen is None:
        notes.append("The results hold no observed landmarks; add the landmark file to see them.")
    if edges is None and not any(layer.blend for layer in layers):
        notes.append(
            "No edges are known, so landmarks are points; -d DICT.h5 or --truth may have them."
        )
    for layer in results:
        failed = int((~np.isfinite(layer.points).any(axis=(1, 2))).sum())
        if failed:
            notes.append(f"{layer.name} has no shape of {counted(failed, 'frame')}.")


def _shown(unit: str) -> str:
    """Return a unit as the page has it: nothing for one that is not known."""
    return "" if unit == UNKNOWN_UNIT else unit


def _ordinal(number: int) -> str:
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{'th' if number % 100 in (11, 12, 13) else ending}"
