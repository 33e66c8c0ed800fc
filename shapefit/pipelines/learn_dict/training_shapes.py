"""The shapes that a dictionary is made from: read, thinned out, normalised, aligned."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.dictionary.model import Dictionary
from shapefit.dictionary.motion import (
    find_acceleration,
    find_edge_covariance,
    find_give,
    find_lengths,
)
from shapefit.dictionary.size import find_edge_length
from shapefit.errors import counted, input_error
from shapefit.geometry.normalisation import SMALLEST, normalise
from shapefit.geometry.procrustes import Alignment, coincide, generalised_procrustes
from shapefit.geometry.symmetry import double, lateral_axis, symmetrise
from shapefit.io import ShapeSet, match_landmarks
from shapefit.meshes.dense import carry_mesh
from shapefit.pipelines.outcome import Failure, Note


def apply_symmetry(shapes: ShapeSet, options: TrainingOptions) -> ShapeSet:
    """Return the shapes, or their symmetric ones, or the shapes and then their mirror images.

    A mirror image has the item and sequence of its shape. The shapes come without meshes unless
    `symmetry` is none: `mirror_index` pairs landmarks, and a mesh whose vertices have no partners
    can be mirrored as a surface only, not vertex by vertex as mixing meshes needs. Raises
    InputError where the shapes have no `mirror_index`, or one that does not pair the landmarks.
    """
    if options.symmetry == "none":
        return shapes
    index = find_partners(shapes, options)
    lateral = lateral_axis(shapes.shapes, index)
    bare = shapes.replaced(mesh_vertices=None, mesh_faces=None)
    if options.symmetry == "symmetrise":
        return bare.replaced(shapes=symmetrise(shapes.shapes, index, lateral))
    twice = bare.take(np.tile(np.arange(len(shapes)), 2))
    return twice.replaced(shapes=double(shapes.shapes, index, lateral))


def find_partners(shapes: ShapeSet, options: TrainingOptions) -> NDArray[Any]:
    """Return the partner of each landmark. Raises InputError as `apply_symmetry` does."""
    if options.mirror is not None:
        return read_mirror(shapes.landmark_names, options.mirror)
    place = options.place
    fix = "give `mirror`, store the index of each landmark's mirror image, or set `symmetry: none`"
    index = shapes.columns.get("mirror_index")
    if index is None:
        raise input_error(place, "has no dataset `mirror_index`", fix)
    points = np.arange(len(shapes.landmark_names))
    pairs = index.shape == points.shape and index.dtype.kind in "iu"
    pairs = pairs and bool(((index >= 0) & (index < len(points))).all())
    if not pairs or (index[index] != points).any() or (index == points).all():
        raise input_error(f"{place}:/mirror_index", "does not pair the landmarks", fix)
    return index


def read_mirror(names: tuple[str, ...], mirror: Mapping[str, str]) -> NDArray[Any]:
    """Return the partner of each landmark. Raises InputError for names that are no pairs."""
    index = np.arange(len(names))
    fix = "name each landmark of a pair once"
    for pair in mirror.items():
        match_landmarks(names, pair, place="mirror")
        first, second = (names.index(name) for name in pair)
        if first == second or index[first] != first or index[second] != second:
            raise input_error("mirror", f"pairs {pair[0]} and {pair[1]}", fix)
        index[first], index[second] = second, first
    return index


@dataclass(frozen=True, kw_only=True)
class TrainingOptions:
    """How shapes become training shapes; the keys of `learn-dict` that say so.

    place    of the files, for messages
    atoms    to learn, for which as many shapes are needed
    fewer    with fewer shapes, as many atoms will do
    batch    shapes in memory at a time; those of a batch lie in unnamed files in `folder`
    """

    place: str
    every: int | Mapping[str, int] = 1
    align: Literal["all", "none"] | tuple[str, ...] = "all"
    symmetry: Literal["none", "symmetrise", "double"] = "none"
    mirror: Mapping[str, str] | None = None
    atoms: int = 1
    fewer: bool = False
    batch: int = 0
    folder: Path = Path()


@dataclass(frozen=True)
class TrainingShapes:
    """n training shapes: `original` in their unit, and `alignment` of the normalised ones.

    scale (n,): shape j measures scale[j] * alignment.shapes[j]; mesh_vertices (n, 3, q) in the
    frame and on the scale of alignment.shapes, None where there are no meshes. `dictionary` has no
    atoms yet; its acceleration and edge_give are those of all shapes given, and its mirror_index
    is None where no symmetry is asked for.
    failures: the shapes that should have been among them; warnings about the rest.
    """

    original: ShapeSet
    alignment: Alignment
    scale: Floats
    mesh_vertices: Floats | None
    dictionary: Dictionary
    failures: tuple[Failure, ...]
    warnings: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.original)


def find_training_shapes(given: ShapeSet, options: TrainingOptions) -> TrainingShapes:
    """Take every n-th shape of each sequence, made symmetric or doubled, normalised and aligned.

    Shapes that cannot be normalised are failures. Raises InputError for shapes without the pairs
    of landmarks that `symmetry` needs, unknown landmarks in `align`, 0 shapes, and k above their
    number.
    """
    fine = separate(given)[0]
    acceleration = find_acceleration(fine.shapes, fine.sequences) if fine.sequences else None
    give = bodies = None
    if fine.edges is not None and len(fine):
        give = find_give(fine.shapes, fine.edges, fine.sequences or ("",) * len(fine))
        if fine.sequences:
            bodies = find_lengths(fine.shapes, fine.edges, fine.sequences)[1]
    sequences = given.sequences or ("",) * len(given)
    kept = given.take(every_nth(sequences, options.every))
    usable, failures = separate(kept)
    shapes = apply_symmetry(usable, options) if len(usable) else usable
    check_number(len(shapes), failures, options)
    normalised = normalise(shapes.shapes)
    alignment = align(normalised.points, shapes.landmark_names, options)
    mesh, edges = shapes.mesh_vertices, shapes.edges
    return TrainingShapes(
        original=shapes,
        alignment=alignment,
        scale=normalised.scale,
        mesh_vertices=None if mesh is None else carry_mesh(mesh, normalised, alignment.rotations),
        dictionary=dictionary_of(
            shapes,
            alignment.mean,
            None if options.symmetry == "none" else find_partners(usable, options),
            acceleration=acceleration,
            give=give,
            edge_length=None if edges is None else find_edge_length(shapes.shapes, edges),
            bodies=bodies,
        ),
        failures=failures,
        warnings=tuple(find_warnings(usable, shapes, alignment, options)),
    )


def check_number(number: int, failures: Sequence[Failure], options: TrainingOptions) -> None:
    """Raise InputError where there are no shapes, or not as many as atoms."""
    if not number:
        found = "there are 0 shapes to learn from"
        if failures:
            found += f"; {failures[0].item}, for one: {failures[0].reason}"
        raise input_error("shapes", found, "give more shapes")
    if find_k(number, options) > number:
        found = f"{options.atoms} atoms are more than the {counted(number, 'shape')} to learn from"
        raise input_error("k", found, "lower k or `every`, or give more shapes")


def find_k(number: int, options: TrainingOptions) -> int:
    """Return the number of atoms for a number of shapes."""
    return min(options.atoms, number) if options.fewer else options.atoms


def dictionary_of(
    shapes: ShapeSet,
    mean: Floats,
    partners: NDArray[np.int64] | None,
    *,
    acceleration: Floats | None,
    give: Floats | None,
    edge_length: Floats | None,
    bodies: Floats | None,
) -> Dictionary:
    """Return a dictionary without atoms: what is the same for all methods.

    mean (3, p); bodies (s, e), mean lengths of the edges in each sequence, if there are any.
    """
    return Dictionary(
        atoms=np.empty((0, *mean.shape)),
        landmark_names=shapes.landmark_names,
        mean_shape=normalise(mean).points,
        edges=shapes.edges,
        mirror_index=partners,
        unit=shapes.unit,
        acceleration=acceleration,
        edge_give=give,
        edge_length=edge_length,
        edge_covariance=None if bodies is None or not bodies.size else find_edge_covariance(bodies),
        frame_rate=None if acceleration is None else shapes.frame_rate,
    )


def every_nth(
    sequences: tuple[str, ...], n: int | Mapping[str, int], seen: Counter[str] | None = None
) -> list[int]:
    """Return the indices of every n-th item of each sequence, its first one included.

    In a mapping the first glob that fits the name of a sequence gives its n; 1 where none does.
    `seen` counts the items of each sequence over several calls.
    """
    globs = {"*": n} if isinstance(n, int) else n
    steps = {
        name: next((step for glob, step in globs.items() if fnmatchcase(name, glob)), 1)
        for name in set(sequences)
    }
    seen = Counter() if seen is None else seen
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


def align(points: Floats, names: tuple[str, ...], options: TrainingOptions) -> Alignment:
    """Turn normalised shapes (n, 3, p) onto each other, or leave them in their common frame."""
    if options.align == "none":
        unturned = np.tile(np.eye(3), (len(points), 1, 1))
        return Alignment(points, points.mean(axis=0), unturned, rounds=0, still=True)
    return generalised_procrustes(points, chosen_landmarks(names, options))


def chosen_landmarks(names: tuple[str, ...], options: TrainingOptions) -> list[int] | None:
    """Return the indices of the landmarks that shapes are aligned by; None for all."""
    if options.align in ("all", "none"):
        return None
    indices: list[int] = match_landmarks(names, options.align, place="align").tolist()
    return indices


def still_moving(rounds: int) -> str:
    """Say that the mean did not come to rest."""
    return f"the mean of the aligned shapes was still moving after {rounds} rounds"


def find_warnings(
    given: ShapeSet, shapes: ShapeSet, alignment: Alignment, options: TrainingOptions
) -> Iterator[str]:
    """Say what became worse on the way from the shapes given to those to learn from."""
    if find_k(len(shapes), options) < options.atoms:
        shapes_there = counted(len(shapes), "shape")
        yield Note(f"{len(shapes)} atoms in place of {options.atoms}: there are {shapes_there}")
    if not alignment.still:
        yield still_moving(alignment.rounds)
    if given.mesh_vertices is not None and shapes.mesh_vertices is None:
        yield (
            "the meshes are left out: `symmetry` mirrors landmarks, whose partners are known; "
            "vertices have no partners; `symmetry: none` keeps the meshes"
        )
