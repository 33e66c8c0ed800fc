"""`fit`: landmarks in, chunk by chunk, 3D shapes with their certificates out."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from shapefit import __version__
from shapefit.config import FitConfig
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import Loss
from shapefit.convex.solution import Status
from shapefit.io import (
    LandmarkSet,
    ResultSet,
    digest,
    open_landmarks,
    read_dictionary,
    result_writer,
)
from shapefit.io.extras import Extras
from shapefit.lifting.lift import Lifting, Program, Solve, lift
from shapefit.pipelines.outcome import Failure, Outcome

Floats = NDArray[np.float64]


def run(config: FitConfig) -> Iterator[Outcome]:
    """Lift every image of the landmark files; yields an Outcome a chunk."""
    dictionary = read_dictionary(config.dictionary)
    program, solve = choose_program(config), choose_solver(config)
    solve_seconds, done = 0.0, 0
    with open_landmarks(config.landmarks) as source, result_writer(config.output) as writer:
        for chunk in source.chunks(config.chunk):
            images = chunk.arrange(dictionary.landmark_names, source_names(config))
            began = time.perf_counter()
            lifting = lift(images.landmarks, find_weights(images), dictionary.atoms, program, solve)
            solve_seconds += time.perf_counter() - began
            writer.append(as_result(images, lifting, config))
            done += len(images)
            yield Outcome(
                done=len(images),
                total=source.count,
                failures=find_failures(images, lifting, config),
                warnings=find_warnings(lifting, config),
            )
        writer.attributes.update(
            method=config.method,
            version=__version__,
            config=config.as_json(),
            inputs=json.dumps(
                {path.name: digest(path) for path in (*config.landmarks, config.dictionary)}
            ),
            solve_seconds=solve_seconds,
            images_per_second=done / solve_seconds if solve_seconds > 0 else 0.0,
        )
    yield Outcome(total=source.count, written=(config.output,))


def choose_program(config: FitConfig) -> Program:
    """Return the convex program that the config names."""
    return Program(
        lam=None if config.lam == "auto" else config.lam,
        loss=Loss(config.loss),
        beta=config.beta,
        noise=config.noise or 0.0,
    )


def choose_solver(config: FitConfig) -> Solve:
    """Return the solver that the config names, with its options."""
    options = config.solver
    if options.name == "admm":
        from shapefit.convex.admm import solve_admm

        return partial(
            solve_admm,
            tolerance=options.tolerance,
            stop=options.stop,
            max_iterations=options.max_iterations,
        )
    return partial(
        solve_newton,
        tolerance=options.tolerance,
        max_iterations=options.max_iterations,
        threads=config.threads,
    )


def source_names(config: FitConfig) -> str:
    """Name the place of the landmark names for messages."""
    return ", ".join(str(path) for path in config.landmarks) + ": landmark names"


def find_weights(images: LandmarkSet) -> Floats:
    """Omega (n, p): the confidence, or 1, where a landmark is seen, and 0 elsewhere."""
    seen = np.isfinite(images.landmarks).all(axis=1)
    return np.where(seen, 1.0 if images.confidence is None else images.confidence, 0.0)


def as_result(images: LandmarkSet, lifting: Lifting, config: FitConfig) -> ResultSet:
    """Lay out a chunk as it is stored, with the observed landmarks beside the fitted ones."""
    solution, found = lifting.solution, lifting.reconstruction
    failed = np.isnan(lifting.scale)

    def known(values: Floats) -> Floats:
        shape = (-1,) + (1,) * (values.ndim - 1)
        return np.where(failed.reshape(shape), np.nan, values)

    return ResultSet(
        shapes=lifting.shapes,
        landmarks_fitted=lifting.landmarks_fitted,
        coefficients=known(found.coefficients),
        rotation=known(found.rotation),
        translation=lifting.translation,
        scale=lifting.scale,
        objective=known(solution.objective),
        relative_gap=known(solution.relative_gap),
        iterations=solution.iterations,
        status=np.array([status.value for status in solution.status], dtype=object),
        landmark_names=images.landmark_names,
        items=images.items,
        sequences=images.sequences,
        transforms=known(solution.transforms) if config.transforms else None,
        unit=images.unit,
        y_axis=images.y_axis,
        extras=further_datasets(images, lifting),
    )


def further_datasets(images: LandmarkSet, lifting: Lifting) -> Extras:
    """Join what came with the landmarks with what only some fits have."""
    visible = (lifting.problem.weights > 0)[:, None, :]
    own = {
        "landmarks": np.where(visible, images.landmarks, np.nan).swapaxes(1, 2),
        "lambda": lifting.problem.lam,
        "residual": lifting.solution.residual,
        "active_atoms": lifting.reconstruction.active_atoms,
        "tight": lifting.reconstruction.tight,
    }
    if lifting.outliers is not None:
        own["outliers"] = lifting.outliers
    carried = Extras.of(images.extras, len(images))
    return Extras({**carried.per_item, **own}, carried.whole)


def find_failures(images: LandmarkSet, lifting: Lifting, config: FitConfig) -> tuple[Failure, ...]:
    """List the items without a shape and, where `strict`, those that are not optimal."""
    reasons = dict(lifting.failures)
    if config.strict:
        for image, status in enumerate(lifting.solution.status):
            if status is not Status.OPTIMAL:
                reasons.setdefault(image, describe(lifting, image))
    return tuple(Failure(images.items[image], reasons[image]) for image in sorted(reasons))


def find_warnings(lifting: Lifting, config: FitConfig) -> tuple[str, ...]:
    """Say how many images stopped at the iteration limit."""
    limited = [
        image
        for image, status in enumerate(lifting.solution.status)
        if status is Status.ITERATION_LIMIT
    ]
    if config.strict or not limited:
        return ()
    worst = max(limited, key=lambda image: lifting.solution.relative_gap[image])
    return (f"{len(limited)} images not optimal, the worst: {describe(lifting, worst)}",)


def describe(lifting: Lifting, image: int) -> str:
    """Say how far an image got."""
    solution = lifting.solution
    return (
        f"{solution.status[image].value} after {solution.iterations[image]} iterations, "
        f"relative gap {solution.relative_gap[image]:.2g}"
    )
