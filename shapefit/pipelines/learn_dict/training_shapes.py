"""The shapes that a dictionary is learned from: thinned out, mirrored, normalised, aligned."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from shapefit.arrays import Floats, Integers
from shapefit.config import LearnDictConfig
from shapefit.dictionary.bodies import (
    find_acceleration,
    find_bone_tolerance,
    find_edge_covariance,
    find_lengths,
)
from shapefit.dictionary.model import Dictionary
from shapefit.errors import counted, input_error
from shapefit.geometry.normalisation import SMALLEST, normalise
from shapefit.geometry.procrustes import (
    Alignment,
    coincide,
    generalised_procrustes,
    lateral_axis,
    mirror,
)
from shapefit.io import ShapeSet, match_landmarks
from shapefit.meshes.dense import carry_mesh
from shapefit.pipelines.result import Failure


@dataclass(frozen=True)
class TrainingShapes:
    """n training shapes, normalised and aligned.

    original: as in the files, after `every` and `mirror`; alignment: of the normalised shapes
    (n, 3, p); scale (n,) that normalised them; mesh_vertices (n, 3, q), moved as their landmarks,
    or None; dictionary: all but its atoms and prior; failures: shapes that cannot be used.
    """

    original: ShapeSet
    alignment: Alignment
    scale: Floats
    mesh_vertices: Floats | None
    dictionary: Dictionary
    failures: tuple[Failure, ...]

    def __len__(self) -> int:
        return len(self.original)


def find_training_shapes(given: ShapeSet, config: LearnDictConfig) -> TrainingShapes:
    """Take every n-th shape of each sequence, double them by mirroring, normalise, and align.

    The motion and the rigidity of edges are those of all the shapes given. Shapes that cannot be
    normalised are failures. Raises InputError for shapes without the pairs of landmarks that
    `mirror` needs, unknown landmarks in `align`, no shapes, and fewer shapes than atoms.
    """
    usable, failures = separate(given)
    shapes = usable.take(every_nth(usable.sequences or ("",) * len(usable), config.every))
    partners = find_partners(shapes, config) if config.mirror else None
    if partners is not None and len(shapes):
        mirrored = mirror(shapes.shapes, partners, lateral_axis(shapes.shapes, partners))
        both = np.concatenate([shapes.shapes, mirrored])
        twice = shapes.take(np.tile(np.arange(len(shapes)), 2))
        shapes = twice.replaced(shapes=both, mesh_vertices=None, mesh_faces=None)
    if not len(shapes):
        example = f"; {failures[0].item}, for one: {failures[0].reason}" if failures else ""
        raise input_error(
            "shapes", f"there are 0 shapes to learn from{example}", "give more shapes"
        )
    if number_of_atoms(len(shapes), config) > len(shapes):
        problem = (
            f"{config.k} atoms are more than the {counted(len(shapes), 'shape')} to learn from"
        )
        raise input_error("k", problem, "lower k or `every`, or give more shapes")
    normalised = normalise(shapes.shapes)
    alignment = align(normalised.points, shapes.landmark_names, config)
    mesh = shapes.mesh_vertices
    return TrainingShapes(
        original=shapes,
        alignment=alignment,
        scale=normalised.scale,
        mesh_vertices=None if mesh is None else carry_mesh(mesh, normalised, alignment.rotations),
        dictionary=Dictionary(
            atoms=np.empty((0, *alignment.mean.shape)),
            landmark_names=shapes.landmark_names,
            mean_shape=normalise(alignment.mean).points,
            edges=shapes.edges,
            mirror_index=partners,
            unit=shapes.unit,
            **find_motion(usable, shapes),
        ),
        failures=failures,
    )


def separate(shapes: ShapeSet) -> tuple[ShapeSet, tuple[Failure, ...]]:
    """Return the shapes that can be normalised, and the others as failures."""
    distinct = ~coincide(shapes.shapes)
    extent = np.ptp(shapes.shapes, axis=-1).max(axis=-1, initial=0.0)
    usable = distinct & np.isfinite(extent) & (extent >= SMALLEST)
    failures = tuple(
        Failure(
            shapes.items[i],
            "all its landmarks are at one point"
            if np.isfinite(extent[i])
            else "a coordinate is not finite",
        )
        for i in np.flatnonzero(~usable).tolist()
    )
    return shapes.take(usable), failures


def every_nth(sequences: tuple[str, ...], n: int | Mapping[str, int]) -> list[int]:
    """Return the indices of every n-th item of each sequence, starting with its first.

    In a mapping the first glob that fits the name of a sequence gives its n; 1 where none does.
    """
    globs = {"*": n} if isinstance(n, int) else n
    steps = {
        name: next((step for glob, step in globs.items() if fnmatchcase(name, glob)), 1)
        for name in set(sequences)
    }
    counts: Counter[str] = Counter()
    retained = []
    for index, sequence in enumerate(sequences):
        if counts[sequence] % steps[sequence] == 0:
            retained.append(index)
        counts[sequence] += 1
    return retained


def find_partners(shapes: ShapeSet, config: LearnDictConfig) -> Integers:
    """Return the partner (p,) of each landmark on the other side, by `mirror` or the file.

    Raises InputError where neither pairs the landmarks.
    """
    names, points = shapes.landmark_names, np.arange(len(shapes.landmark_names))
    if isinstance(config.mirror, dict):
        partners = points.copy()
        for pair in config.mirror.items():
            first, second = match_landmarks(names, pair, place="mirror")
            partners[[first, second]] = second, first
    else:
        partners = shapes.columns.get("mirror_index", np.empty(0))
    if not (
        partners.shape == points.shape
        and partners.dtype.kind in "iu"
        and np.isin(partners, points).all()
        and (partners != points).any()
        and (partners[partners] == points).all()
    ):
        problem = "`mirror`, or the dataset `mirror_index` of the shapes, does not pair landmarks"
        fix = "name each landmark of a pair once, `mirror: {rhip: lhip}`"
        raise input_error(place_of(config), problem, fix)
    return partners


def number_of_atoms(number: int, config: LearnDictConfig) -> int:
    """Return the atoms to learn from so many shapes: fewer than the default where these are few."""
    if config.method != "sparse-coding":
        return 1
    return config.k if "k" in config.model_fields_set else min(config.k, number)


def align(points: Floats, names: tuple[str, ...], config: LearnDictConfig) -> Alignment:
    """Turn normalised shapes (n, 3, p) onto their mean, or leave them in their common frame."""
    if config.align == "none":
        unturned = np.tile(np.eye(3), (len(points), 1, 1))
        return Alignment(points, points.mean(axis=0), unturned, rounds=0, converged=True)
    return generalised_procrustes(points, aligned_landmarks(names, config))


def aligned_landmarks(names: tuple[str, ...], config: LearnDictConfig) -> list[int] | None:
    """Return the indices of the landmarks that shapes are aligned by; None for all."""
    if isinstance(config.align, str):
        return None
    indices: list[int] = match_landmarks(names, config.align, place="align").tolist()
    return indices


def find_motion(given: ShapeSet, shapes: ShapeSet) -> dict[str, Any]:
    """Return what a dictionary knows of motion and bones, by the names of its fields.

    Motion and differences between bodies are those of all shapes given, lengths those of `shapes`.
    """
    motion: dict[str, Any] = {}
    edges, sequences = given.edges, given.sequences
    if sequences:
        motion["acceleration"] = find_acceleration(given.shapes, sequences)
        motion["frame_rate"] = None if motion["acceleration"] is None else given.frame_rate
    if edges is None:
        return motion
    motion["edge_length"] = find_lengths(shapes.shapes, edges, ("",) * len(shapes))[0].mean(axis=0)
    of = sequences or ("",) * len(given)
    motion["bone_tolerance"] = find_bone_tolerance(given.shapes, edges, of)
    if len(edges):
        lengths, bodies, _ = find_lengths(given.shapes, edges, of)
        motion["edge_covariance"] = find_edge_covariance(bodies, None if sequences else lengths)
    return motion


def place_of(config: LearnDictConfig) -> str:
    """Return the files of shapes or landmarks, as messages name them."""
    return ", ".join(map(str, config.shapes))
