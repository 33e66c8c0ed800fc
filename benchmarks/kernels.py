"""What is measured in warm processes against the release before: arrays, and one job on each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.comparing import NOISE, Row, compare_workers, compared
from benchmarks.environments import Environment
from shapefit.arrays import Floats
from shapefit.convex.problem import build_problem
from shapefit.convex.solver import solve_newton
from shapefit.dictionary.learning import learn
from shapefit.dictionary.mixture import learn_mixture
from shapefit.geometry.cameras import project, turntable
from shapefit.geometry.normalisation import Normalised, normalise
from shapefit.geometry.pinhole import Camera, depth_sign
from shapefit.geometry.procrustes import generalised_procrustes
from shapefit.geometry.rotations import random_rotations, rotation_about
from shapefit.io import LandmarkSet, ShapeSet, open_landmarks, read_shapes
from shapefit.lifting.methods import Settings, choose_method
from shapefit.lifting.perspective.view import mean_coefficients
from shapefit.pipelines.fit.camera import read_intrinsics
from shapefit.pipelines.learn_dict.training_shapes import every_nth

LAMBDA = 0.1

Arrays = dict[str, Any]
Options = dict[str, object]


@dataclass(frozen=True)
class Goal:
    """A job of worker.py on the arrays that `build` makes.

    Both sides run with the same options, unless `instead_of` says that this version is compared
    with itself under other ones. `certified`: every image must be solved to its gap.
    """

    name: str
    job: str
    build: Callable[[], Arrays]
    options: Options
    instead_of: Options | None = None
    certified: bool = False
    repeats: int = 7


def newton(name: str, build: Callable[[], Arrays], tolerance: float = 1e-4) -> Goal:
    """The convex program on one thread."""
    return Goal(name, "newton", build, options(tolerance), certified=True)


def options(tolerance: float = 1e-4, threads: int = 1) -> Options:
    """Options of the solver."""
    return {"tolerance": tolerance, "threads": threads}


def mocap_goals(folder: Path) -> Iterator[Goal]:
    """Motion capture: many images with few landmarks."""
    frames = cache(partial(mocap_case, folder))
    seen = partial(program, frames)
    yield newton("subject 13, gap 1e-4", seen)
    yield newton("subject 13, gap 1e-6", seen, 1e-6)
    yield newton("subject 13, 30% hidden", partial(program, frames, 0.3))
    wall: Options = {"clock": "wall"}
    yield Goal("two threads over one", "newton", seen, options(threads=2) | wall, options() | wall)
    for p, n in ((15, 500), (41, 60), (75, 20)):
        how: Options = {"residual_variance": 0.006, "threads": 1}
        build = partial(bodies, folder, p, n)
        yield Goal(f"posterior, 32 components, p={p}", "posterior", build, how, repeats=5)
    yield Goal(
        "learn-dict, k=128", "learn", partial(training, folder), {"k": 128} | wall, repeats=3
    )


def cars_goals(folder: Path) -> Iterator[Goal]:
    """Cars: a mask for each image, 66 landmarks."""
    yield newton("cars, p=66", partial(program, partial(cars_case, folder)))
    for method, lam in (("convex+refine", 1.0), ("alternate", 0.1)):
        how: Options = {"method": method, "threads": 1}
        yield Goal(f"cars, {method}", "lift", partial(cars, folder, lam), how)
    one: Options = {"threads": 1}
    yield Goal("cars, perspective", "perspective", partial(cars_in_perspective, folder), one)
    yield Goal("cars, RANSAC", "ransac", partial(cars, folder, 1.0), one)


def grid_goals(quick: bool) -> Iterator[Goal]:
    """Made cases of many sizes, where nothing may be slower than before."""
    for k in (32, 64) if quick else (32, 64, 128, 256):
        for p in (15,) if quick else (15, 33, 66):
            made = cache(partial(made_case, 500 if quick else 2000, k, p))
            for name, hidden in (("", 0.0), (", 30% hidden", 0.3)):
                build = partial(program, made, hidden)
                yield replace(newton(f"made, k={k}, p={p}{name}", build), repeats=3)


def compare_goal(goal: Goal, old: Environment, new: Environment, folder: Path, repeats: int) -> Row:
    """Write the arrays of a goal and let both sides take turns."""
    arrays, data = goal.build(), folder / "arrays.npz"
    np.savez(data, **arrays)
    first = old.python if goal.instead_of is None else new.python
    found = compare_workers(
        (first, goal.instead_of or goal.options),
        (new.python, goal.options),
        goal.job,
        data,
        min(repeats, goal.repeats),
    )
    least = NOISE if goal.instead_of is None else 0.0
    images = len(arrays.get("landmarks", ()))
    return compared(goal.name, found, images=images, certified=goal.certified, least=least)


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
