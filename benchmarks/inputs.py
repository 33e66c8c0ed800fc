"""The arrays of each job, in files that every measured version reads."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import LAMBDA, Case, cars_case, hide, normalise_seen, read_cars
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import build_problem
from shapefit.dictionary.mixture_learning import learn_mixture
from shapefit.geometry.cameras import project, turntable
from shapefit.geometry.normalisation import normalise
from shapefit.geometry.pinhole import Camera, depth_sign
from shapefit.geometry.procrustes import generalised_procrustes
from shapefit.io import read_shapes
from shapefit.lifting.methods import Settings, choose_method
from shapefit.lifting.perspective.start import mean_coefficients
from shapefit.pipelines.fit.camera import read_intrinsics
from shapefit.pipelines.learn_dict.training_shapes import every_nth

Arrays = dict[str, Any]


def program(build: Callable[[], Case], hidden: float = 0.0, lam: float = LAMBDA) -> Arrays:
    """The convex program of a case, with a share of the landmarks hidden."""
    case = hide(build(), hidden) if hidden else build()
    return {"landmarks": case.landmarks, "atoms": case.atoms, "lam": np.array(lam)}


def cars(folder: Path, lam: float) -> Arrays:
    """Annotated cars, once each, with the mean of their models."""
    arrays = program(partial(cars_case, folder, 1), lam=lam)
    return arrays | {"mean_shape": arrays["atoms"].mean(axis=0)}


def cars_in_perspective(folder: Path) -> Arrays:
    """Cars, their cameras in normalised units, and the rotations that the refinement starts from.

    The optical axis is at 0, 0 (see configs/cars/fit.yaml).
    """
    images, _ = read_cars(folder)
    arrays, norm = cars(folder, 1.0), normalise_seen(images)
    atoms, mean = arrays["atoms"], arrays["mean_shape"]
    settings = Settings(solve=partial(solve_newton, tolerance=1e-4), mean_shape=mean)
    found = choose_method("convex+refine", settings)(build_problem(arrays["landmarks"], atoms, 1.0))
    focal, _ = read_intrinsics(images, "camera_matrix")
    camera = Camera(focal, np.zeros_like(focal), depth_sign(images.y_axis)).normalised_as(norm)
    return arrays | {
        "rotation": found.rotation,
        "prior": mean_coefficients(atoms, mean),
        "focal": camera.focal,
        "centre": camera.centre,
        "sign": np.array(camera.sign),
    }


def bodies(folder: Path, p: int, n: int) -> Arrays:
    """Frames of subject 86 with p landmarks, and a prior of 32 components from the other frames.

    Landmarks beyond the joints lie between two of them, where a third one pulls, with an error.
    """
    shapes = read_shapes([folder / "subject86_24fps.h5"])
    rng = np.random.default_rng(p)
    joints = shapes.shapes.shape[2]
    mixing = np.eye(joints, p)
    for column in range(joints, p):
        mixing[rng.permutation(joints)[:3], column] = rng.dirichlet([2.0, 2.0, 0.5])
    points = shapes.shapes @ mixing
    points[:, :, joints:] += 0.003 * rng.standard_normal((len(points), 3, p - joints))
    prior_shapes = generalised_procrustes(normalise(points[::3]).points).shapes
    prior = learn_mixture(prior_shapes, 32, shrinkage=0.3, floor=0.01, max_rounds=5).mixture
    seen = points[1 :: len(points) // n][:n]
    atoms = prior.means / np.linalg.norm(prior.means, axis=(1, 2))[:, None, None]
    return {
        "landmarks": normalise(project(seen, turntable(np.arange(n) / n, "y"))).points,
        "atoms": atoms,
        "lam": np.array(LAMBDA),
        "mean_shape": prior_shapes.mean(axis=0),
        "weights": prior.weights,
        "means": prior.means,
        "covariances": prior.covariances,
    }


def training(folder: Path) -> Arrays:
    """The paper's training shapes, as learn-dict aligns them."""
    shapes = read_shapes([folder / "subject86_24fps.h5"])
    kept = every_nth(shapes.sequences or (), 3)
    return {"shapes": generalised_procrustes(normalise(shapes.shapes[kept]).points).shapes}
