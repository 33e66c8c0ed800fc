"""What is timed: the paper's motion capture case, and made cases of any size."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shapefit.arrays import Floats
from shapefit.dictionary.learning import learn
from shapefit.geometry.cameras import project, turntable
from shapefit.geometry.normalisation import Normalised, normalise
from shapefit.geometry.procrustes import generalised_procrustes
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.io import LandmarkSet, ShapeSet, open_landmarks, read_shapes
from shapefit.pipelines.learn_dict.training_shapes import every_nth

LAMBDA = 0.1


@dataclass(frozen=True)
class Case:
    """Normalised landmarks (n, 2, p), nan = hidden, and atoms (k, 3, p)."""

    name: str
    landmarks: Floats
    atoms: Floats


def made_case(n: int, k: int, p: int, seed: int = 0) -> Case:
    """Exemplar shapes of a 10-dimensional family as atoms; other members of it, turned, as images.

    Images come in runs of 50 between two shapes and two views, as frames of a sequence do.
    """
    rng = np.random.default_rng(seed)
    mean, modes = rng.standard_normal((3, p)), rng.standard_normal((10, 3, p))

    def shapes(weights: Floats) -> Floats:
        return normalise(mean + 0.3 * np.tensordot(weights, modes, 1)).points

    atoms = shapes(rng.standard_normal((k, 10)))
    atoms /= np.linalg.norm(atoms, axis=(1, 2))[:, None, None]
    runs = -(-n // 50)
    ends = rng.standard_normal((runs, 2, 10))
    t = np.linspace(0, 1, 50)[None, :, None]
    weights = (ends[:, :1] * (1 - t) + ends[:, 1:] * t).reshape(-1, 10)[:n]
    starts = random_rotations(runs, rng)
    about = rotation_about(np.array([0.0, 1.0, 0.0]), np.linspace(0, np.pi / 4, 50))
    views = (about[None] @ starts[:, None]).reshape(-1, 3, 3)[:n]
    landmarks = (views @ shapes(weights))[:, :2] + 0.02 * rng.standard_normal((n, 2, p))
    return Case(f"made, k={k}, p={p}", normalise(landmarks).points, atoms)


def hide(case: Case, share: float, seed: int = 0) -> Case:
    """The case with a share of the landmarks hidden, a different mask each image."""
    rng = np.random.default_rng(seed)
    n, _, p = case.landmarks.shape
    hidden = rng.random((n, p)).argsort(axis=1) < round(share * p)
    landmarks = np.where(hidden[:, None, :], np.nan, case.landmarks)
    return Case(f"{case.name}, {share:.0%} hidden", landmarks, case.atoms)


def mocap_case(folder: Path, k: int = 64) -> Case:
    """All frames of subject 13 under the turntable, a dictionary from subject 86."""
    views = turntable_views(read_shapes([folder / "subject13_24fps.h5"]))
    return Case(f"subject 13, k={k}, p=15", views, learn_mocap(folder, k))


def cars_case(folder: Path, times: int = 10) -> Case:
    """Annotated cars, each with its mask, several times over; all models but one as atoms."""
    images, atoms = read_cars(folder)
    points = np.where(np.isfinite(images.landmarks), normalise_seen(images).points, np.nan)
    return Case(f"cars, k={len(atoms)}, p={atoms.shape[2]}", np.tile(points, (times, 1, 1)), atoms)


def read_cars(folder: Path) -> tuple[LandmarkSet, Floats]:
    """Annotated cars, their landmarks in the order of the models, and the normalised models."""
    models = read_shapes([folder / "models.h5"])
    with open_landmarks([folder / "annotated_cars.h5"]) as source:
        (images,) = source.batches(source.count)
    return images.arrange(models.landmark_names), normalise(models.shapes).points[:-1]


def normalise_seen(images: LandmarkSet) -> Normalised:
    """Normalise by the landmarks that are seen."""
    return normalise(images.landmarks, np.asarray(np.isfinite(images.landmarks).all(axis=1)))


def learn_mocap(folder: Path, k: int = 64) -> Floats:
    """The paper's dictionary: every third frame of subject 86, beta = 0.1."""
    training = read_shapes([folder / "subject86_24fps.h5"])
    kept = every_nth(training.sequences or (), 3)
    aligned = generalised_procrustes(normalise(training.shapes[kept]).points)
    *_, learned = learn(aligned.shapes, k, 0.1, iterations=15)
    return learned.atoms


def turntable_views(shapes: ShapeSet) -> Floats:
    """Normalised landmarks of every frame, the camera turning once around each sequence."""
    lengths = Counter(shapes.sequences)
    turns = np.concatenate([np.arange(length) / length for length in lengths.values()])
    return normalise(project(shapes.shapes, turntable(turns, "y"))).points
