"""A neural lifter trained on the same poses: what a network makes of the footage.

`python -m benchmarks.neural_peer --data FOLDER`, after `python -m benchmarks.footage`, trains for
some minutes and writes results/footage/BODY/peer.h5; `--methods convex posterior sequences peer` of
that command then judges it beside the others. It needs JAX, which the package does without:
`pip install jax`.

The classic lifter: normalised landmarks and which of them are seen -> two residual blocks of 256
units -> depths and corrections. It is trained on the poses of subject 86, mirrored, with stretched
bones, in views all around with the tilts of the footage, at its distances, with its detector's
joints, noise and gaps: it knows all that the footage does.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.footage import (
    AWAY,
    BODY_SPREAD,
    CONSTANT,
    FOLDER,
    LASTING,
    PEER,
    SCORED,
    TILT,
    UNSEEN,
    landmark_rows,
    turn,
)
from shapefit.dictionary.variations import find_skeleton, vary
from shapefit.io import open_landmarks, read_shapes, result_writer
from shapefit.io.records import ResultSet, ShapeSet
from shapefit.io.skeletons import THETA

Floats = NDArray[np.float64]

UNITS, BLOCKS = 256, 2
ROUNDS, BATCH, RATE = 20_000, 512, 1e-3
SEED = 7


def views(shapes: ShapeSet, rng: np.random.Generator) -> Iterator[tuple[Floats, Floats]]:
    """Yield batches without end: inputs (n, 3m) of what a detector finds, joints (n, 3p)."""
    edges = shapes.edges
    assert edges is not None
    poses = shapes.shapes - shapes.shapes.mean(axis=2, keepdims=True)
    skeleton = find_skeleton(edges, poses.shape[2])
    names = shapes.landmark_names
    swap = [
        names.index({"r": "l", "l": "r"}[name[0]] + name[1:])
        if name[1:] in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
        else names.index(name)
        for name in names
    ]
    while True:
        x = poses[rng.integers(0, len(poses), BATCH)]
        x = vary(x, skeleton, copies=2, stretch=0.15, exchange=0.5, partners=np.array(swap))[BATCH:]
        mirrored = rng.random(BATCH) < 0.5
        x[mirrored] = (x * [[-1.0], [1.0], [1.0]])[mirrored][..., swap]
        tall = np.ptp(x[:, 1], axis=1)
        turns = np.stack(
            [
                turn(2, TILT * a) @ turn(0, TILT * b) @ np.diag([1.0, -1.0, -1.0]) @ turn(1, yaw)
                for a, b, yaw in zip(
                    rng.standard_normal(BATCH),
                    rng.standard_normal(BATCH),
                    rng.uniform(0, 2 * np.pi, BATCH),
                    strict=True,
                )
            ]
        )
        seen = turns @ (x - x.mean(axis=2, keepdims=True))
        theta = {
            name: THETA[name].mean * np.exp(spread * rng.standard_normal())
            for name, spread in BODY_SPREAD.items()
        }
        marks = seen @ landmark_rows(names, theta)[1].T
        noise = rng.standard_normal((BATCH, 2, marks.shape[2]))
        marks[:, :2] += np.hypot(CONSTANT, LASTING) * noise
        away = tall * rng.uniform(*AWAY, BATCH)
        flat = marks[:, :2] / (marks[:, 2:] + away[:, None, None])
        hidden = rng.random((BATCH, marks.shape[2])) < UNSEEN
        size = seen.std(axis=2).mean(axis=1)[:, None, None]
        yield as_input(np.where(hidden[:, None], np.nan, flat)), (seen / size).reshape(BATCH, -1)


def as_input(landmarks: Floats) -> Floats:
    """Normalised landmarks (n, 2, m), 0 where hidden, and which are seen: (n, 3m)."""
    seen: NDArray[np.bool_] = np.asarray(np.isfinite(landmarks).all(axis=1))
    count = np.maximum(seen.sum(axis=1), 1)[:, None, None]
    filled = np.where(seen[:, None], landmarks, 0.0)
    apart = np.where(seen[:, None], filled - filled.sum(axis=2, keepdims=True) / count, 0.0)
    size = np.sqrt((apart**2).sum(axis=(1, 2), keepdims=True) / (2 * count)) + 1e-12
    return np.concatenate([apart / size, seen[:, None].astype(float)], axis=1).reshape(
        len(seen), -1
    )


def train(shapes: ShapeSet, rounds: int) -> Any:
    """Return a function from inputs to joints, trained by Adam with a falling rate."""
    try:
        jax, jnp = import_module("jax"), import_module("jax.numpy")
    except ImportError:
        sys.exit("the neural peer needs JAX: pip install jax")
    rng = np.random.default_rng(SEED)
    batches = views(shapes, rng)
    inputs, targets = next(batches)
    sizes = [inputs.shape[1], *([UNITS] * (1 + 2 * BLOCKS)), targets.shape[1]]
    layers = [
        (rng.standard_normal((a, b)) * np.sqrt(2 / a), np.zeros(b)) for a, b in pairwise(sizes)
    ]

    def lift(layers: Any, x: Any) -> Any:
        x = jax.nn.relu(x @ layers[0][0] + layers[0][1])
        for block in range(BLOCKS):
            y = x
            for W, b in layers[1 + 2 * block : 3 + 2 * block]:
                y = jax.nn.relu(y @ W + b)
                y = (y - y.mean(axis=1, keepdims=True)) / (y.std(axis=1, keepdims=True) + 1e-3)
            x = x + y
        return x @ layers[-1][0] + layers[-1][1]

    def loss(layers: Any, x: Any, y: Any) -> Any:
        apart = (lift(layers, x) - y).reshape(len(x), 3, -1)
        return jnp.sqrt((apart**2).sum(axis=1) + 1e-6).mean()

    def advance(layers: Any, first: Any, second: Any, x: Any, y: Any, t: Any, rate: Any) -> Any:
        slope = jax.grad(loss)(layers, x, y)
        first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, slope)
        second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, second, slope)
        scale = jnp.sqrt(1 - 0.999**t) / (1 - 0.9**t)
        moved = jax.tree.map(
            lambda w, m, v: w - rate * scale * m / (jnp.sqrt(v) + 1e-8), layers, first, second
        )
        return moved, first, second

    step = jax.jit(advance)
    layers = jax.tree.map(jnp.asarray, layers)
    first = second = jax.tree.map(jnp.zeros_like, layers)
    for t in range(1, rounds + 1):
        x, y = next(batches)
        rate = RATE * 0.5 * (1 + np.cos(np.pi * t / rounds))
        layers, first, second = step(layers, first, second, x, y, float(t), rate)
        if t % 1000 == 0:
            print(f"{t} of {rounds} rounds, error {float(loss(layers, x, y)):.3f}", flush=True)
    return lambda x: np.asarray(lift(layers, x), dtype=np.float64)


def main() -> None:
    """Train, and lift the footage of the bodies."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/mocap"))
    parser.add_argument("--bodies", nargs="*", default=SCORED)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    given = parser.parse_args()
    shapes = read_shapes([given.data / "subject86_24fps.h5"])
    lift = train(shapes.take(np.arange(0, len(shapes), 3)), given.rounds)
    for body in given.bodies:
        with open_landmarks([FOLDER / body / "landmarks.h5"]) as source:
            images = source.whole()
        names, _ = landmark_rows(shapes.landmark_names, dict.fromkeys(THETA, 1.0))
        found = lift(as_input(images.arrange(names).landmarks))
        points = found.reshape(len(images), 3, -1)
        with result_writer(FOLDER / body / f"{PEER}.h5") as writer:
            writer.append(
                ResultSet(
                    shapes=points,
                    landmark_names=shapes.landmark_names,
                    items=images.items,
                    sequences=images.sequences,
                    unit="px",
                    y_axis="down",
                )
            )


if __name__ == "__main__":
    main()
