"""Training shapes that do not fit in memory: normalised and aligned in passes, kept on the disk."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.dictionary.learning import evenly
from shapefit.dictionary.model import Dictionary
from shapefit.dictionary.motion import MotionSums
from shapefit.dictionary.size import find_edge_length
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.procrustes import choose, rotation_onto, settle_mean
from shapefit.geometry.symmetry import lateral_squares, mirror, symmetrise
from shapefit.io import ShapeSet, ShapeSource
from shapefit.io.columns import Batched, Column, nearest_folder
from shapefit.pipelines.learn_dict.training_shapes import (
    TrainingOptions,
    align,
    check_number,
    chosen_landmarks,
    dictionary_of,
    every_nth,
    find_partners,
    separate,
    still_moving,
)
from shapefit.pipelines.outcome import Failure

Partners = NDArray[np.int64]


@dataclass(frozen=True)
class TrainingBatches:
    """n training shapes on the disk, normalised and aligned, and what is known about all of them.

    shapes (n, 3, p) and scale (n,), as the alignment and the scale of `TrainingShapes`;
    `dictionary` has no atoms yet. failures and warnings as there.
    """

    shapes: Batched
    scale: Batched
    dictionary: Dictionary
    failures: tuple[Failure, ...]
    warnings: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.shapes)


def find_training_batches(source: ShapeSource, options: TrainingOptions) -> TrainingBatches:
    """Find what `find_training_shapes` does, `options.batch` shapes at a time, without the meshes.

    The files are read once, and once more where `symmetry` has to find left and right. What is
    learned from lies in unnamed temporary files in the folder of the output. The mean is settled
    to 1e-4 of its norm, first on a sample of `options.batch` shapes. Raises InputError as
    `find_training_shapes` does, and where the disk is full.
    """
    head = source.head
    partners = None if options.symmetry == "none" else find_partners(head, options)
    doubled = options.symmetry == "double"
    lateral = 0 if partners is None else find_lateral(source, options, partners)
    folder = nearest_folder(options.folder)
    points = Column(folder, np.float64, (3, len(head.landmark_names)))
    scale, sizes = Column(folder, np.float64), Column(folder, np.float64)
    failures: list[Failure] = []
    edges = np.empty((0, 2), np.int64) if head.edges is None else head.edges
    motion, length = MotionSums(edges), np.zeros(len(edges))
    for fine, usable, failed in read_batches(source, options):
        failures += failed
        motion.add(fine.shapes, fine.sequences or ("",) * len(fine))
        sizes.append(normalise(fine.shapes).scale)
        if not len(usable):
            continue
        shapes = usable.shapes
        if partners is not None and not doubled:
            shapes = symmetrise(shapes, partners, lateral)
        normalised = normalise(shapes)
        points.append(normalised.points)
        scale.append(normalised.scale)
        length += len(shapes) * find_edge_length(shapes, edges)
        if partners is not None and doubled:
            length += len(shapes) * find_edge_length(mirror(shapes, partners, lateral), edges)
    if partners is not None and doubled:
        for batch in Batched(points, options.batch):
            points.append(mirror(batch, partners, lateral))
        for batch in Batched(scale, options.batch):
            scale.append(batch)
    check_number(len(points), failures, options)
    mean, warnings = align_batches(Batched(points, options.batch), head.landmark_names, options)
    if head.mesh_vertices is not None:
        warnings.append("the meshes are left out: leave out `batch` to keep them")
    unit = float(np.median(sizes[:]))
    return TrainingBatches(
        Batched(points, options.batch),
        Batched(scale, options.batch),
        dictionary_of(
            head,
            mean,
            partners,
            acceleration=None if head.sequences is None else motion.acceleration(unit),
            give=None if head.edges is None else motion.give(unit),
            edge_length=None if head.edges is None else length / len(points),
            bodies=None if head.sequences is None else motion.mean_lengths(),
        ),
        tuple(failures),
        tuple(warnings),
    )


def read_batches(
    source: ShapeSource, options: TrainingOptions
) -> Iterator[tuple[ShapeSet, ShapeSet, Sequence[Failure]]]:
    """Read the shapes that can be normalised, those of them that are kept, and the failures."""
    seen: Counter[str] = Counter()
    for given in source.batches(options.batch):
        sequences = given.sequences or ("",) * len(given)
        kept = given.take(every_nth(sequences, options.every, seen))
        yield separate(given)[0], *separate(kept)


def find_lateral(source: ShapeSource, options: TrainingOptions, partners: Partners) -> int:
    """Return `lateral_axis` of all shapes that are kept."""
    total = np.zeros(3)
    for _, usable, _ in read_batches(source, options):
        total += lateral_squares(usable.shapes, partners)
    return int(total.argmax())


def align_batches(
    points: Batched, names: tuple[str, ...], options: TrainingOptions
) -> tuple[Floats, list[str]]:
    """Turn normalised shapes onto each other in their place; return their mean, and warnings."""
    landmarks = chosen_landmarks(names, options)
    warnings = []
    if options.align != "none":
        sample = align(
            points.column.take(evenly(len(points), min(options.batch, len(points)))), names, options
        )
        target, rounds, still = settle_mean(points, sample.mean, landmarks)
        if not still:
            warnings.append(still_moving(rounds))
        for rows in points.slices():
            batch = points.column[rows]
            points.column[rows] = rotation_onto(choose(batch, landmarks), target) @ batch
    total: Floats = sum((batch.sum(axis=0) for batch in points), np.zeros((3, len(names))))
    return total / len(points), warnings
