"""The shapes that a dictionary is made from: read, thinned out, normalised, aligned."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from shapefit.config import LearnDictConfig
from shapefit.dictionary.motion import find_acceleration, find_give
from shapefit.errors import counted, input_error
from shapefit.geometry.normalisation import SMALLEST, normalise
from shapefit.geometry.procrustes import Alignment, coincide, generalised_procrustes
from shapefit.io import ShapeSet, match_landmarks
from shapefit.meshes.dense import carry_mesh
from shapefit.pipelines.learn_dict.symmetry import apply_symmetry, find_partners
from shapefit.pipelines.outcome import Failure

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TrainingShapes:
    """n training shapes: `original` in their unit, and `alignment` of the normalised ones.

    scale (n,): shape j measures scale[j] * alignment.shapes[j]; mesh_vertices (n, 3, q) in the
    frame and on the scale of alignment.shapes, None where there are no meshes. Of all shapes given:
    acceleration (p,), None where they are no sequences; give (e,), None without edges.
    partners (p,): the other side of each landmark, None where the config asks for no symmetry.
    failures: the shapes that should have been among them; warnings about the rest.
    """

    original: ShapeSet
    alignment: Alignment
    scale: Floats
    mesh_vertices: Floats | None
    acceleration: Floats | None
    give: Floats | None
    partners: NDArray[np.int64] | None
    failures: tuple[Failure, ...]
    warnings: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.original)


def find_training_shapes(given: ShapeSet, config: LearnDictConfig) -> TrainingShapes:
    """Take every n-th shape of each sequence, made symmetric or doubled, normalised and aligned.

    Shapes that cannot be normalised are failures. Raises InputError for shapes without the pairs
    of landmarks that `symmetry` needs, unknown landmarks in `align`, 0 shapes, and k above their
    number.
    """
    fine = separate(given)[0]
    acceleration = find_acceleration(fine.shapes, fine.sequences) if fine.sequences else None
    give = None
    if fine.edges is not None and len(fine):
        give = find_give(fine.shapes, fine.edges, fine.sequences or ("",) * len(fine))
    sequences = given.sequences or ("",) * len(given)
    kept = given.take(every_nth(sequences, config.every))
    usable, failures = separate(kept)
    if not len(usable):
        found = "there are 0 shapes to learn from"
        if failures:
            found += f"; {failures[0].item}, for one: {failures[0].reason}"
        raise input_error("shapes", found, "give more shapes")
    shapes = apply_symmetry(usable, config)
    if config.method == "sparse-coding" and config.k > len(shapes):
        found = f"{config.k} atoms are more than the {counted(len(shapes), 'shape')} to learn from"
        raise input_error("k", found, "lower k or `every`, or give more shapes")
    normalised = normalise(shapes.shapes)
    alignment = align(normalised.points, shapes.landmark_names, config)
    mesh = shapes.mesh_vertices
    return TrainingShapes(
        original=shapes,
        alignment=alignment,
        scale=normalised.scale,
        mesh_vertices=None if mesh is None else carry_mesh(mesh, normalised, alignment.rotations),
        acceleration=acceleration,
        give=give,
        partners=None if config.symmetry == "none" else find_partners(usable, config),
        failures=failures,
        warnings=tuple(find_warnings(usable, shapes, alignment)),
    )


def every_nth(sequences: tuple[str, ...], n: int | Mapping[str, int]) -> list[int]:
    """Return the indices of every n-th item of each sequence, its first one included.

    In a mapping the first glob that fits the name of a sequence gives its n; 1 where none does.
    """
    globs = {"*": n} if isinstance(n, int) else n
    steps = {
        name: next((step for glob, step in globs.items() if fnmatchcase(name, glob)), 1)
        for name in set(sequences)
    }
    seen: Counter[str] = Counter()
    kept = []
    for index, sequence in enumerate(sequences):
        if seen[sequence] % steps[sequence] == 0:
            kept.append(index)
        seen[sequence] += 1
    return kept


def separate(shapes: ShapeSet) -> tuple[ShapeSet, tuple[Failure, ...]]:
    """Return the shapes that can be normalised, and the others as failures."""
    apart = ~coincide(shapes.shapes)
    extent = np.ptp(shapes.shapes, axis=-1).max(axis=-1, initial=0.0)
    usable = apart & np.isfinite(extent) & (extent >= SMALLEST)

    def reason(i: int) -> str:
        if not np.isfinite(extent[i]):
            return "a coordinate is not finite"
        if not apart[i]:
            return "all its landmarks are at one point"
        return f"its landmarks are too close together, within {extent[i]:.2g}: use a smaller unit"

    failures = tuple(Failure(shapes.items[i], reason(i)) for i in np.flatnonzero(~usable).tolist())
    return shapes.take(usable), failures


def align(points: Floats, names: tuple[str, ...], config: LearnDictConfig) -> Alignment:
    """Turn normalised shapes (n, 3, p) onto each other, or leave them in their common frame."""
    if config.align == "none":
        unturned = np.tile(np.eye(3), (len(points), 1, 1))
        return Alignment(points, points.mean(axis=0), unturned, rounds=0, still=True)
    landmarks = None
    if config.align != "all":
        landmarks = match_landmarks(names, config.align, place="align").tolist()
    return generalised_procrustes(points, landmarks)


def find_warnings(given: ShapeSet, shapes: ShapeSet, alignment: Alignment) -> Iterator[str]:
    """Say what became worse on the way from the shapes given to those to learn from."""
    if not alignment.still:
        yield f"the mean of the aligned shapes was still moving after {alignment.rounds} rounds"
    if given.mesh_vertices is not None and shapes.mesh_vertices is None:
        yield (
            "the meshes are left out: `symmetry` mirrors landmarks, whose partners are known; "
            "vertices have no partners; `symmetry: none` keeps the meshes"
        )
