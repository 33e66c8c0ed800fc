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
from shapefit.pipelines.result import Result, warn_of_empty
from shapefit.records import Landmarks, Shapes

IMAGES_DRAWN_AT_ONCE = 1024
"""Images whose random numbers are drawn together."""

MIN_NOT_HIDDEN = 3
"""Landmarks of an image that are never hidden."""

# Purposes of random numbers; the values are part of what a seed means.
VIEW_STREAM = 0
NOISE_STREAM = 1
HIDDEN_STREAM = 2

TRUE_ROTATION = "true_rotation"

Y_DOWN = np.diag([1.0, -1.0, -1.0])
"""From a camera frame whose y points up to one whose y points down."""


def project_shapes(config: ProjectConfig) -> Iterator[Result]:
    """Project every shape with the camera of the config; yields a Result per batch.

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
        turns = share_of_turn(np.array(sequences, dtype=str))
        for batch, shapes in enumerate(source.batches(IMAGES_DRAWN_AT_ONCE)):
            first = batch * IMAGES_DRAWN_AT_ONCE
            turns_of_batch = turns[first : first + len(shapes)]
            writer.append(project_batch(shapes, turns_of_batch, config, batch))
            yield Result(done=len(shapes), total=source.count)
        writer.attributes |= {
            "version": __version__,
            "config": config.as_json(),
            "inputs": json.dumps(digests(config.shapes)),
        }
    warnings = source.notes + warn_of_empty(source.count, "shapes")
    warnings += writer.summary.warnings
    yield Result(total=source.count, warnings=warnings, written=(config.output,))


def share_of_turn(sequences: NDArray[np.str_]) -> Floats:
    """Return the share (n,) of a full turn: t / m for image t of a sequence of m."""
    _, sequence, counts = np.unique(sequences, return_inverse=True, return_counts=True)
    order = np.argsort(sequence, kind="stable")
    first = np.cumsum(counts) - counts
    frame = np.empty(len(sequences))
    frame[order] = np.arange(len(sequences)) - first[sequence[order]]
    turns: Floats = frame / counts[sequence]
    return turns


def project_batch(
    shapes: Shapes, turns: Floats, config: ProjectConfig, batch: int
) -> Landmarks:
    """Project a batch of n shapes, turned by `turns` (n,) if on a turntable, to 2D."""
    n = len(shapes)
    camera = config.camera
    if camera.view == "turntable":
        rotations = cameras.turntable(turns, "y")
        if config.y_axis == "down":
            rotations = Y_DOWN @ rotations
    elif camera.view == "random":
        rng = random_stream(config.seed, VIEW_STREAM, batch)
        rotations = random_rotations(IMAGES_DRAWN_AT_ONCE, rng)[:n]
    else:
        rotations = np.broadcast_to(np.array(camera.view, dtype=np.float64), (n, 3, 3))
    scale = 1.0 if camera.scale is None else camera.scale
    landmarks = cameras.project_from_afar(shapes.as_columns(), rotations, scale)
    if config.noise > 0:
        rng = random_stream(config.seed, NOISE_STREAM, batch)
        landmarks = add_noise(landmarks, config.noise, rng)
    if config.hidden > 0:
        rng = random_stream(config.seed, HIDDEN_STREAM, batch)
        landmarks = hide_share(landmarks, config.hidden, rng)
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


def random_stream(seed: int, purpose: int, batch: int) -> np.random.Generator:
    """Return the random generator of a purpose, such as NOISE_STREAM, for a batch."""
    return np.random.default_rng(
        np.random.SeedSequence(seed, spawn_key=(purpose, batch))
    )


def add_noise(landmarks: Floats, deviation: float, rng: np.random.Generator) -> Floats:
    """Add Gaussian noise to landmarks (n, 2, p), n <= IMAGES_DRAWN_AT_ONCE."""
    n, *rest = landmarks.shape
    noise = rng.standard_normal((IMAGES_DRAWN_AT_ONCE, *rest))[:n]
    return landmarks + deviation * noise


def hide_share(landmarks: Floats, share: float, rng: np.random.Generator) -> Floats:
    """Set a random `share` of the landmarks (n, 2, p) of each image to nan.

    n <= IMAGES_DRAWN_AT_ONCE. The number hidden in an image is share * p, rounded up or
    down at random so that the share holds on average; at least MIN_NOT_HIDDEN stay.
    """
    n, _, p = landmarks.shape
    rounding = rng.random(IMAGES_DRAWN_AT_ONCE)[:n]
    draws = rng.random((IMAGES_DRAWN_AT_ONCE, p))[:n]
    number = np.floor(share * p + rounding).clip(0, max(p - MIN_NOT_HIDDEN, 0))
    rank = draws.argsort(axis=1).argsort(axis=1)
    is_hidden = rank < number[:, None]
    return np.where(is_hidden[:, None], np.nan, landmarks)
