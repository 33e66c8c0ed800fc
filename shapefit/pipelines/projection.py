"""`project`: 3D shapes in, synthetic 2D landmarks with the true rotation out."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from shapefit import __version__
from shapefit.arrays import Floats
from shapefit.config import ProjectConfig
from shapefit.geometry import cameras
from shapefit.geometry.rotations import random_rotations
from shapefit.io import (
    LandmarkSet,
    ShapeSet,
    ShapeSource,
    check_output,
    digests,
    landmark_writer,
    open_shapes,
)
from shapefit.io.layout import CORRUPTED, free_names
from shapefit.io.options import input_options
from shapefit.pipelines.imperfections import (
    BATCH,
    Purpose,
    add_noise,
    hide,
    stream,
)
from shapefit.pipelines.outcome import Outcome, nothing_in


def sequence_lengths(source: ShapeSource) -> Counter[str]:
    """Count the frames of each sequence."""
    lengths: Counter[str] = Counter()
    for names in source.sequences():
        lengths.update(names)
    return lengths


class Turntable:
    """Counts the frames of each sequence: frame t of n has made t / n of a turn."""

    def __init__(self, lengths: Mapping[str, int]) -> None:
        self._length = lengths
        self._seen: Counter[str] = Counter()

    def turns(self, sequences: Sequence[str]) -> Floats:
        """Return the turns (n,) of the next n frames, which belong to these sequences."""
        turns = np.empty(len(sequences))
        for frame, name in enumerate(sequences):
            turns[frame] = self._seen[name] / self._length[name]
            self._seen[name] += 1
        return turns


TRUE_ROTATION = "true_rotation"
OF_THE_VIEW = (TRUE_ROTATION, CORRUPTED)
"""Datasets that belong to the images: what came with the shapes gets another name."""

PIXELS = "px"

TURN = np.diag([1.0, -1.0, -1.0])
"""From a camera frame whose y points up to one whose y points down."""


def run(config: ProjectConfig) -> Iterator[Outcome]:
    """Look at every shape with the camera of the config; yields an Outcome per batch of images.

    The images have the items, sequences and further datasets of the shapes and `true_rotation`
    (n, 3, 3), object to camera frame; y points as the config says. An orthographic camera keeps the
    unit of the shapes, a weak-perspective one gives px. Raises InputError for files that cannot be
    read or written.
    """
    check_output(config.output)
    with (
        open_shapes(config.shapes, input_options(config.input)) as source,
        landmark_writer(config.output) as writer,
    ):
        turntable = Turntable(sequence_lengths(source))
        for batch, part in enumerate(source.batches(BATCH)):
            rotations = _rotations(config, turntable.turns(_sequences(part)), batch)
            writer.append(_images(part, rotations, config, batch))
            yield Outcome(done=len(part), total=source.count)
        writer.attributes.update(
            version=__version__,
            config=config.as_json(),
            inputs=json.dumps(digests(config.shapes)),
        )
    warnings = nothing_in(source.count, "shapes") + writer.summary.warnings
    yield Outcome(total=source.count, warnings=warnings, written=(config.output,))


def _sequences(shapes: ShapeSet) -> Sequence[str]:
    """Name the sequence of each shape; shapes without sequences are one sequence."""
    return ("",) * len(shapes) if shapes.sequences is None else shapes.sequences


def _rotations(config: ProjectConfig, turns: Floats, batch: int) -> Floats:
    """Rotations from object to camera frame (n, 3, 3) for the n images of a batch."""
    camera = config.camera
    if camera.view == "turntable":
        rotations = cameras.turntable(turns, camera.up)
        return rotations if config.y_axis == "up" else TURN @ rotations
    if camera.view == "random":
        return random_rotations(BATCH, stream(config.seed, Purpose.VIEW, batch))[: len(turns)]
    return np.broadcast_to(np.array(camera.view, dtype=np.float64), (len(turns), 3, 3))


def _images(shapes: ShapeSet, rotations: Floats, config: ProjectConfig, batch: int) -> LandmarkSet:
    scale = config.camera.scale
    landmarks = cameras.project(shapes.shapes, rotations, 1.0 if scale is None else scale)
    if config.noise > 0:
        landmarks = add_noise(landmarks, config.noise, stream(config.seed, Purpose.NOISE, batch))
    if config.hidden > 0:
        landmarks = hide(landmarks, config.hidden, stream(config.seed, Purpose.HIDDEN, batch))
    names = free_names(shapes.further, OF_THE_VIEW)
    further = {names[name]: values for name, values in shapes.further.items()}
    return LandmarkSet(
        landmarks=landmarks,
        landmark_names=shapes.landmark_names,
        items=shapes.items,
        sequences=shapes.sequences,
        unit=shapes.unit if scale is None else PIXELS,
        y_axis=config.y_axis,
        frame_rate=shapes.frame_rate,
        columns={**further, TRUE_ROTATION: rotations},
        of_file=[names[name] for name in shapes.of_file],
    )
