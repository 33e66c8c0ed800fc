"""`project`: 3D shapes in, synthetic 2D landmarks with the true rotation out.

Random numbers depend on the seed, the purpose, and the position of the image: each
batch has one stream per purpose. So an image does not depend on how many follow, nor
what is hidden on the noise.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from shapefit import __version__
from shapefit.arrays import Floats
from shapefit.config import ProjectConfig
from shapefit.geometry import cameras
from shapefit.geometry.rotations import random_rotations
from shapefit.io import (
    check_output,
    digests,
    landmark_writer,
    open_shapes,
)
from shapefit.io.layout import CORRUPTED
from shapefit.io.options import InputOptions
from shapefit.pipelines.result import Result, nothing_in
from shapefit.records import Landmarks, Shapes

BATCH = 1024
"""Images whose random numbers are drawn together."""

LEAST_VISIBLE = 3
"""Landmarks of an image that are never hidden."""

VIEW, NOISE, HIDDEN = 0, 1, 2
"""Purposes of random numbers; the values are part of what a seed means."""

TRUE_ROTATION = "true_rotation"

TURN = np.diag([1.0, -1.0, -1.0])
"""From a camera frame whose y points up to one whose y points down."""


def run(config: ProjectConfig) -> Iterator[Result]:
    """Project every shape with the camera of the config; yields a Result per batch of
    images.

    The images have the items, sequences and further datasets of the shapes and
    `true_rotation` (n, 3, 3), object to camera frame. An orthographic camera keeps the
    unit of the shapes, a weak-perspective one gives px. Raises InputError for files
    that cannot be read or written.
    """
    check_output(config.output)
    with (
        open_shapes(config.shapes, InputOptions()) as source,
        landmark_writer(config.output) as writer,
    ):
        sequences = list(chain.from_iterable(source.sequences())) or [""] * source.count
        turns = turns_of(np.array(sequences, dtype=str))
        for batch, shapes in enumerate(source.batches(BATCH)):
            first = batch * BATCH
            writer.append(
                project(shapes, turns[first : first + len(shapes)], config, batch)
            )
            yield Result(done=len(shapes), total=source.count)
        inputs = json.dumps(digests(config.shapes))
        writer.attributes |= {
            "version": __version__,
            "config": config.as_json(),
            "inputs": inputs,
        }
    warnings = source.notes + nothing_in(source.count, "shapes")
    warnings += writer.summary.warnings
    yield Result(total=source.count, warnings=warnings, written=(config.output,))


def turns_of(sequences: NDArray[np.str_]) -> Floats:
    """Return the turns (n,) of n images: frame t of a sequence of m frames has made t /
    m.
    """
    _, which, counts = np.unique(sequences, return_inverse=True, return_counts=True)
    order = np.argsort(which, kind="stable")
    frame = np.empty(len(sequences))
    frame[order] = (
        np.arange(len(sequences)) - (np.cumsum(counts) - counts)[which[order]]
    )
    turns: Floats = frame / counts[which]
    return turns


def project(
    shapes: Shapes, turns: Floats, config: ProjectConfig, batch: int
) -> Landmarks:
    """Return the images of a batch of n shapes that have made these turns (n,)."""
    n, camera = len(shapes), config.camera
    if camera.view == "turntable":
        rotations = cameras.turntable(turns, "y")
        rotations = rotations if config.y_axis == "up" else TURN @ rotations
    elif camera.view == "random":
        rotations = random_rotations(BATCH, stream(config.seed, VIEW, batch))[:n]
    else:
        rotations = np.broadcast_to(np.array(camera.view, dtype=np.float64), (n, 3, 3))
    scale = 1.0 if camera.scale is None else camera.scale
    landmarks = cameras.project_from_afar(shapes.as_columns(), rotations, scale)
    if config.noise > 0:
        landmarks = add_noise(
            landmarks, config.noise, stream(config.seed, NOISE, batch)
        )
    if config.hidden > 0:
        landmarks = hide(landmarks, config.hidden, stream(config.seed, HIDDEN, batch))
    extras = {name: v for name, v in shapes.extras.items() if name != CORRUPTED}
    file_extras = dict(shapes.file_extras)
    if shapes.mirror_index is not None:
        file_extras["mirror_index"] = shapes.mirror_index
    return Landmarks(
        landmarks.swapaxes(1, 2),
        landmark_names=shapes.landmark_names,
        items=shapes.items,
        sequences=shapes.sequences,
        frames=shapes.frames,
        times=shapes.times,
        unit=shapes.unit if camera.scale is None else "px",
        y_axis=config.y_axis,
        frame_rate=shapes.frame_rate,
        extras={**extras, TRUE_ROTATION: rotations},
        file_extras=file_extras,
    )


def stream(seed: int, purpose: int, batch: int) -> np.random.Generator:
    """Return the random numbers of one purpose for a batch of images."""
    return np.random.default_rng(
        np.random.SeedSequence(seed, spawn_key=(purpose, batch))
    )


def add_noise(landmarks: Floats, deviation: float, rng: np.random.Generator) -> Floats:
    """W + deviation * N(0, 1), landmarks (n, 2, p), n <= BATCH."""
    n, *rest = landmarks.shape
    return landmarks + deviation * rng.standard_normal((BATCH, *rest))[:n]


def hide(landmarks: Floats, share: float, rng: np.random.Generator) -> Floats:
    """Set a random `share` of the landmarks (n, 2, p) of each image to NaN, n <= BATCH.

    The number hidden in an image is share * p, rounded up or down at random so that the
    share holds on average; at least LEAST_VISIBLE landmarks stay.
    """
    n, _, p = landmarks.shape
    rounding, keys = rng.random(BATCH)[:n], rng.random((BATCH, p))[:n]
    number = np.floor(share * p + rounding).clip(0, max(p - LEAST_VISIBLE, 0))
    hidden = keys.argsort(axis=1).argsort(axis=1) < number[:, None]
    return np.where(hidden[:, None], np.nan, landmarks)
