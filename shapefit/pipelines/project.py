"""`project`: 3D shapes in, synthetic 2D landmarks with the true rotation out."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from shapefit import __version__
from shapefit.config import ProjectConfig
from shapefit.geometry import cameras
from shapefit.geometry.rotations import random_rotations
from shapefit.io import LandmarkSet, ShapeSet, check_output, digest, landmark_writer, read_shapes
from shapefit.io.extras import Extras
from shapefit.pipelines.imperfections import (
    BLOCK,
    Purpose,
    add_noise,
    displace,
    hide,
    stream,
)
from shapefit.pipelines.outcome import Outcome

Floats = NDArray[np.float64]

TRUE_ROTATION = "true_rotation"
PIXELS = "px"


def run(config: ProjectConfig) -> Iterator[Outcome]:
    """Look at every shape with the camera of the config; yields an Outcome a block of images.

    The images have the items, sequences and further datasets of the shapes and `true_rotation`
    (n, 3, 3), object to camera frame; y points up. An orthographic camera keeps the unit of the
    shapes, a weak-perspective one gives px. Raises InputError for files that cannot be read or
    written.
    """
    check_output(config.output)
    shapes = read_shapes(config.shapes)
    turntable = Turntable(_sequences(shapes))
    with landmark_writer(config.output) as writer:
        for block, start in enumerate(range(0, max(len(shapes), 1), BLOCK)):
            part = shapes.take(slice(start, start + BLOCK))
            rotations = _rotations(config, turntable.turns(_sequences(part)), block)
            writer.append(_images(part, rotations, config, block))
            yield Outcome(done=len(part), total=len(shapes))
        writer.attributes.update(
            version=__version__,
            config=config.as_json(),
            inputs=json.dumps({str(path): digest(path) for path in config.shapes}),
        )
    yield Outcome(total=len(shapes), written=(config.output,))


class Turntable:
    """Counts the frames of each sequence: frame t of n frames has made t / n of a turn."""

    def __init__(self, sequences: Sequence[str]) -> None:
        self._length = Counter(sequences)
        self._seen: Counter[str] = Counter()

    def turns(self, sequences: Sequence[str]) -> Floats:
        """Return the turns (n,) of the next n frames, which belong to these sequences."""
        turns = np.empty(len(sequences))
        for frame, name in enumerate(sequences):
            turns[frame] = self._seen[name] / self._length[name]
            self._seen[name] += 1
        return turns


def _sequences(shapes: ShapeSet) -> Sequence[str]:
    """Name the sequence of each shape; shapes without sequences are one sequence."""
    return ("",) * len(shapes) if shapes.sequences is None else shapes.sequences


def _rotations(config: ProjectConfig, turns: Floats, block: int) -> Floats:
    """Rotations from object to camera frame (n, 3, 3) for the n images of a block."""
    camera = config.camera
    if camera.view == "turntable":
        return cameras.turntable(turns, camera.up)
    if camera.view == "random":
        return random_rotations(BLOCK, stream(config.seed, Purpose.VIEW, block))[: len(turns)]
    return np.broadcast_to(np.array(camera.rotation), (len(turns), 3, 3))


def _images(shapes: ShapeSet, rotations: Floats, config: ProjectConfig, block: int) -> LandmarkSet:
    scale = config.camera.scale
    landmarks = cameras.project(shapes.shapes, rotations, scale)
    if config.noise > 0:
        rng = stream(config.seed, Purpose.NOISE, block)
        landmarks = add_noise(landmarks, config.noise * scale, rng)
    if config.hidden > 0:
        landmarks = hide(landmarks, config.hidden, stream(config.seed, Purpose.HIDDEN, block))
    if config.outliers.share > 0:
        rng = stream(config.seed, Purpose.OUTLIERS, block)
        landmarks = displace(landmarks, config.outliers.share, config.outliers.size, rng)
    extras = Extras.of(shapes.extras, len(shapes))
    return LandmarkSet(
        landmarks=landmarks,
        landmark_names=shapes.landmark_names,
        items=shapes.items,
        sequences=shapes.sequences,
        unit=shapes.unit if config.camera.model == "orthographic" else PIXELS,
        y_axis="up",
        extras=Extras(extras.per_item | {TRUE_ROTATION: rotations}, extras.whole),
    )
