"""What the labels and the views of the annotated cars allow, whatever the method.

    python -m benchmarks.car_limits FOLDER

FOLDER holds models.h5 and annotated_cars.h5. Three fits of the cars with at least 20 visible
landmarks, each with the refinement under perspective from the labelled pose:

- the true model: its pose alone, so that what is left is the label against the landmarks;
- the other models, landmarks as annotated;
- the other models, landmarks as the true model in its fitted pose projects them, without noise.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.config import FitConfig, load_config
from shapefit.evaluation import metrics
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.pinhole import Camera, project
from shapefit.geometry.rotations import rotation_angle
from shapefit.io import open_landmarks, read_shapes
from shapefit.lifting.options import PerspectiveOptions
from shapefit.lifting.perspective.refinement import refine_perspective
from shapefit.lifting.perspective.start import mean_coefficients
from shapefit.pipelines.fit.plan import choose_options

LEAST_VISIBLE = 20
CONFIG = Path(__file__).parents[1] / "configs" / "cars" / "fit.yaml"
"""Says how the poses are refined."""
WRONG_LABEL = 20.0
"""Degrees between the label and the pose of the true model from which the label must be wrong."""


@dataclass(frozen=True)
class Cars:
    """n cars: landmarks (n, 2, p) about the optical axis, in units of focal lengths.

    models (n,) index the normalised shapes (m, 3, p); rotation (n, 3, 3) as labelled.
    """

    landmarks: Floats
    models: NDArray[np.intp]
    rotation: Floats
    shapes: Floats


@dataclass(frozen=True)
class Fits:
    """Shapes in the camera frame (n, 3, p), rotations (n, 3, 3), projections (n, 2, p)."""

    shapes: Floats
    rotation: Floats
    projected: Floats


def main() -> None:
    cars = read(Path(sys.argv[1]))
    config = load_config("fit", CONFIG)
    assert isinstance(config, FitConfig)
    options = choose_options(config)
    true = fit(cars, cars.landmarks, cars.rotation, options, own=True)
    report("true model", cars, cars.rotation, true)
    others = fit(cars, cars.landmarks, cars.rotation, options)
    report("other models", cars, cars.rotation, others)
    fine = rotation_angle(true.rotation, cars.rotation) < WRONG_LABEL
    print(f"{(~fine).sum()} labels are more than {WRONG_LABEL:g} degrees off; without them:")
    report("true model", cars, cars.rotation, true, fine)
    report("other models", cars, cars.rotation, others, fine)
    for ridge in (0.003, 0.01, 0.03, 0.1):
        clean = fit(cars, true.projected, true.rotation, replace(options, ridge=ridge))
        report(f"other models, exact landmarks, ridge {ridge:g}", cars, true.rotation, clean, fine)


def read(folder: Path) -> Cars:
    """Read the cars with enough visible landmarks."""
    models = read_shapes([folder / "models.h5"])
    with open_landmarks([folder / "annotated_cars.h5"]) as source:
        (images,) = source.batches(source.count)
    visible = np.isfinite(images.landmarks).all(axis=1).sum(axis=1)
    images = images.take(visible >= LEAST_VISIBLE).arrange(models.landmark_names)
    focal = np.asarray(images.columns["camera_matrix"], float)[[0, 1], [0, 1]]
    return Cars(
        landmarks=images.landmarks / focal[:, None],
        models=np.array([models.items.index(str(name)) for name in images.columns["true_model"]]),
        rotation=np.asarray(images.columns["true_rotation"], float),
        shapes=normalise(models.shapes).points,
    )


def fit(
    cars: Cars, landmarks: Floats, start: Floats, options: PerspectiveOptions, *, own: bool = False
) -> Fits:
    """Fit each car with the models of the others, or with its own one alone."""
    seen = np.asarray(np.isfinite(cars.landmarks).all(axis=1))
    norm = normalise(landmarks, seen)
    unit = Camera(np.ones_like(norm.centroid), np.zeros_like(norm.centroid), 1.0)
    camera = unit.normalised_as(norm)
    shapes, projected = np.empty((len(seen), 3, seen.shape[1])), np.empty_like(landmarks)
    rotation = np.empty_like(start)
    for model in np.unique(cars.models):
        rows = np.flatnonzero(cars.models == model)
        atoms = cars.shapes[[model]] if own else np.delete(cars.shapes, model, axis=0)
        part = camera.take(rows)
        found = refine_perspective(
            norm.points[rows], seen[rows].astype(float), atoms, part, start[rows],
            mean_coefficients(atoms, normalise(atoms.mean(axis=0)).points), options,
        )  # fmt: skip
        rotation[rows] = found.rotation
        shapes[rows] = found.rotation @ np.tensordot(found.coefficients, atoms, axes=1)
        flat = project(part, shapes[rows] + found.translation[..., None])
        projected[rows] = norm.scale[rows, None, None] * flat + norm.centroid[rows, :, None]
    return Fits(shapes, rotation, projected)


def report(
    name: str, cars: Cars, rotation: Floats, found: Fits, rows: NDArray[np.bool_] | None = None
) -> None:
    """Print mean / median of the errors against the true models in these rotations."""
    truth = cars.shapes[cars.models]
    scale = metrics.truth_scale(found.shapes, truth)
    errors = {
        "similarity": metrics.similarity(found.shapes, truth) / scale,
        "camera": metrics.camera(found.shapes, truth, rotation) / scale,
        "rotation": rotation_angle(found.rotation, rotation),
    }
    rows = np.ones(len(truth), bool) if rows is None else rows
    cells = [f"{key} {e[rows].mean():.4f} / {np.median(e[rows]):.4f}" for key, e in errors.items()]
    print(f"{name} ({rows.sum()} cars): " + ", ".join(cells))


if __name__ == "__main__":
    main()
