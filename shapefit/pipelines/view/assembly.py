"""The scene of a page, put together from its files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.config import ViewConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import counted
from shapefit.io import read_dictionary
from shapefit.io.formats import detect_format
from shapefit.io.joined import agreed
from shapefit.io.listing import Listing, list_file
from shapefit.io.options import input_options
from shapefit.io.skeletons import edges_of
from shapefit.pipelines.export.origin import fit_dictionary
from shapefit.pipelines.view.frames import Frames
from shapefit.pipelines.view.gathering import (
    Gathered,
    Truth,
    as_judged,
    gather,
    read_truth,
    renamed_edges,
)
from shapefit.pipelines.view.layers import (
    laid_onto,
    mesh_obstacle,
    result_layer,
    shape_layer,
    with_error,
    with_mesh,
)
from shapefit.pipelines.view.moments import find_moments
from shapefit.pipelines.view.pictures import embed, find_images
from shapefit.pipelines.view.sides import find_sides, halves
from shapefit.viewer.scene import Layer, MeshSet, Picture, Scene

MEGABYTES = 20
"""Largest page; of more frames than fit, every n-th is shown."""
MOST_MESHES = 200
"""Meshes of shapes that a page holds, at most."""
SHARE_OF_PICTURES = 0.7
"""Most of a page that pictures take."""


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
    found = [gather(n, own, frames.index, landmarks, config.match) for n, own in listings.items()]
    results = [each for each in found if each.kind == "result"]
    truth = read_truth(config, results, frames, landmarks) if config.truth else None
    observed = (each.of_frames.get("landmarks") for each in found)
    seen = _first_known(own.swapaxes(1, 2) for own in observed if own is not None)
    known = _dictionaries(config, found, notes)
    layers, meshes, edges = _layers(found, known, seen, truth, landmarks, notes)
    _note_what_lacks(layers, seen, edges, notes)
    sides = find_sides(landmarks)
    named = any(sides)
    pairs = (halves(dictionary, landmarks) for _, dictionary in known if dictionary is not None)
    images = any(one.kind != "shapes" for one in every)
    unsaid = (config.input.y_axis or "down") if images else "up"
    y_axis = agreed("y_axis", [(str(one.path), one.y_axis) for one in every], unsaid)
    return Scene(
        title=", ".join(listings) + (" and the truth" if truth else ""),
        items=frames.items,
        sequences=frames.sequences,
        landmarks=landmarks,
        edges=np.empty((0, 2), np.int64) if edges is None else edges,
        layers=layers,
        unit=every[0].unit,
        y_down=y_axis == "down",
        frame_rate=_frame_rate(config, found, frames),
        seen=seen,
        outliers=_outliers(results),
        sides=sides if named else next(filter(any, pairs), ()),
        sides_named=named,
        moments=find_moments(found, frames),
        meshes=meshes,
        pictures=_pictures(config, frames, notes),
        notes=tuple(notes),
    )


def _layers(
    found: Sequence[Gathered],
    known: Sequence[tuple[Path | None, Dictionary | None]],
    seen: Floats | None,
    truth: Truth | None,
    landmarks: Sequence[str],
    notes: list[str],
) -> tuple[list[Layer], list[MeshSet], NDArray[np.int64] | None]:
    """Results first, then what is laid onto the first of them, the truth last."""
    layers: list[Layer] = []
    meshes: list[MeshSet] = []
    edges = [
        renamed_edges(dictionary.edges, dictionary.landmark_names, landmarks)
        for _, dictionary in known
        if dictionary is not None
    ]
    dictionaries: dict[Path, int] = {}
    results = [each for each in found if each.kind == "result"]
    for each, (path, dictionary) in zip(results, known, strict=False):
        layer = result_layer(each, seen)
        if (
            path is not None
            and dictionary is not None
            and dictionary.mesh_vertices is not None
            and dictionary.mesh_faces is not None
        ):
            if obstacle := mesh_obstacle(each, dictionary):
                notes.append(f"{each.name} has no mesh: {obstacle}.")
            else:
                if path not in dictionaries:
                    dictionaries[path] = len(meshes)
                    meshes.append(MeshSet(dictionary.mesh_vertices, dictionary.mesh_faces))
                layer = with_mesh(layer, each, dictionaries[path])
        layers.append(
            layer if truth is None else with_error(layer, truth.points, truth.shapes.unit)
        )
    others: list[Layer] = []
    for each in (each for each in found if each.kind == "shapes"):
        rows = np.array([f if f in each.mesh_vertices else -1 for f in range(len(each.points))])
        mesh = _add_meshes(each.name, each.mesh_vertices, each.mesh_faces, rows, meshes, notes)
        others.append(shape_layer(each.name, "shapes", each.points, mesh))
        edges.append(each.edges)
    if truth is not None:
        shapes = truth.shapes
        vertices, faces = shapes.mesh_vertices, shapes.mesh_faces
        mesh = _add_meshes("The truth", vertices, faces, truth.rows, meshes, notes)
        others.append(shape_layer("truth", "truth", truth.points, mesh))
        edges.append(renamed_edges(shapes.edges, shapes.landmark_names, landmarks))
    target = _first_known(layer.points for layer in layers)
    if target is not None and others:
        laid = ", ".join(layer.name for layer in others)
        notes.append(f"Aligned with {results[0].name} by the best similarity: {laid}.")
        others = [laid_onto(layer, target) for layer in others]
    edges += [each.edges for each in found]
    edges += [np.array(usual) for usual in [edges_of(landmarks)] if usual]
    return layers + others, meshes, next((each for each in edges if each is not None), None)


def _first_known(arrays: Iterable[Floats]) -> Floats | None:
    """Points (n, d, p): those of the first array that has any of a frame."""
    known: Floats | None = None
    for points in arrays:
        if known is None:
            known = points
        else:
            empty = ~np.isfinite(known).any(axis=(1, 2), keepdims=True)
            known = np.where(empty, points, known)
    return known


def _dictionaries(
    config: ViewConfig, found: Sequence[Gathered], notes: list[str]
) -> list[tuple[Path | None, Dictionary | None]]:
    """Return the dictionary of each result: that of the config, else that of the fit.

    The one of the config is there where there is no result, too.
    """
    results = [each for each in found if each.kind == "result"]
    if config.dictionary is not None:
        return [(config.dictionary, read_dictionary(config.dictionary))] * max(1, len(results))
    known: list[tuple[Path | None, Dictionary | None]] = []
    for result in results:
        path, dictionary = fit_dictionary(result.attributes)
        if isinstance(dictionary, Dictionary):
            known.append((path, dictionary))
            continue
        if path is not None:
            notes.append(
                f"{result.name}: its dictionary {path.name} {dictionary}; -d DICT.h5 names another."
            )
        known.append((None, None))
    return known


def _add_meshes(
    name: str,
    vertices: Mapping[int, Floats] | Floats | None,
    faces: NDArray[np.int64] | None,
    rows: NDArray[np.intp],
    meshes: list[MeshSet],
    notes: list[str],
) -> tuple[int, NDArray[np.intp]] | None:
    """Add a set of meshes: that of frame j has vertices[rows[j]] (3, q), none where it is -1.

    Returns its place in `meshes`, and which of its meshes each frame shows.
    """
    used = np.unique(rows[rows >= 0])
    if vertices is None or faces is None or not len(used):
        return None
    if len(used) > MOST_MESHES:
        notes.append(f"{name} has no meshes here: {len(used)} are too many for a page.")
        return None
    meshes.append(MeshSet(np.stack([vertices[row] for row in used]), faces))
    return len(meshes) - 1, np.where(rows >= 0, np.searchsorted(used, rows), -1)


def _outliers(results: Sequence[Gathered]) -> NDArray[np.bool_] | None:
    """Landmarks (n, p) that any result judged to be wrong."""
    labels = [each.of_frames["outliers"] == 1 for each in results if "outliers" in each.of_frames]
    joined = np.logical_or.reduce(labels) if labels else None
    return joined if joined is not None and joined.any() else None


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


def _frame_rate(config: ViewConfig, found: Sequence[Gathered], frames: Frames) -> float | None:
    """Frames a second of the page: those of the config or the files, by the step."""
    files = [listing for each in found for listing in each.listings]
    options = input_options(config.input)
    files += [
        list_file(path, options)
        for path in config.truth
        if not detect_format(path, options.format).points_only
    ]
    stated = [config.frame_rate, *(file.frame_rate for file in files)]
    rate = next((r for r in stated if r is not None and r < 1e6), None)
    return None if rate is None else rate / frames.step


def _pictures(config: ViewConfig, frames: Frames, notes: list[str]) -> dict[int, Picture]:
    if config.images is None:
        return {}
    files = find_images(config.images, frames.items)
    room = SHARE_OF_PICTURES * MEGABYTES * 1e6
    first = embed(next(iter(files.values())))
    step = max(1, -int(-len(files) * len(first.data) // room))
    pictures: dict[int, Picture] = {}
    for frame in list(files)[::step]:
        pictures[frame] = embed(files[frame])
        room -= len(pictures[frame].data)
        if room < 0:
            break
    if len(pictures) < len(frames.items):
        notes.append(f"{len(pictures)} of {counted(len(frames.items), 'frame')} have a picture.")
    return pictures


def _ordinal(number: int) -> str:
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{'th' if number % 100 in (11, 12, 13) else ending}"
