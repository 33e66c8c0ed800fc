"""`fit`: landmarks in, chunk by chunk, 3D shapes with their certificates out."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from shapefit import __version__
from shapefit.config import FitConfig
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import Loss
from shapefit.convex.solution import Status
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import (
    LandmarkSet,
    LandmarkSource,
    digest,
    open_landmarks,
    read_dictionary,
    result_writer,
)
from shapefit.lifting.lift import Lifting, Program, lift
from shapefit.lifting.methods import Settings, Solve, choose_method
from shapefit.lifting.path import WarmSolve, follow_path
from shapefit.lifting.temporal import Sequencing, refine_sequences
from shapefit.pipelines.fit_record import as_result
from shapefit.pipelines.outcome import Failure, Outcome
from shapefit.pipelines.whole_sequences import whole_sequences

Floats = NDArray[np.float64]
Refinement = Callable[[Lifting, LandmarkSet], Lifting]


def run(config: FitConfig) -> Iterator[Outcome]:
    """Lift every image of the landmark files; yields an Outcome a chunk."""
    dictionary = read_dictionary(config.dictionary)
    program = choose_program(config)
    estimator = choose_method(config.method, choose_settings(config, dictionary))
    refinement = choose_refinement(config, dictionary)
    newton = choose_newton(config)
    solve_seconds, done = 0.0, 0
    with open_landmarks(config.landmarks) as source, result_writer(config.output) as writer:
        for chunk in find_chunks(source, config):
            images = chunk.arrange(dictionary.landmark_names, source_names(config))
            began = time.perf_counter()
            lifting = lift(
                images.landmarks, find_weights(images), dictionary.atoms, program, estimator
            )
            lifting = refinement(lifting, images)
            solve_seconds += time.perf_counter() - began
            path = follow_path(lifting.problem, config.path, newton) if config.path else None
            writer.append(as_result(images, lifting, path, config))
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
                {str(path): digest(path) for path in (*config.landmarks, config.dictionary)}
            ),
            solve_seconds=solve_seconds,
            images_per_second=done / solve_seconds if solve_seconds > 0 else 0.0,
        )
    yield Outcome(total=source.count, written=(config.output,))


def find_chunks(source: LandmarkSource, config: FitConfig) -> Iterator[LandmarkSet]:
    """Give out the images, with `temporal.depths` in chunks that divide no sequence."""
    chunks = source.chunks(config.chunk)
    return whole_sequences(map(with_sequences, chunks)) if config.temporal.depths else chunks


def with_sequences(images: LandmarkSet) -> LandmarkSet:
    """Return the images, and refuse them where they name no sequences."""
    if images.sequences is None:
        raise input_error(
            "temporal.depths", "landmarks without `sequence`", "name the sequence of each image"
        )
    return images


def choose_refinement(config: FitConfig, dictionary: Dictionary) -> Refinement:
    """Return what the images of a sequence tell about each other: nothing, or the depths."""
    if not config.temporal.depths:
        return lambda lifting, _: lifting
    if dictionary.edges is None:
        raise input_error(
            "temporal.depths",
            f"{config.dictionary} without `edges`",
            "learn the dictionary from shapes with edges: they are the bones",
        )
    settings = Sequencing(
        smoothness=config.temporal.smoothness,
        rigidity=config.temporal.rigidity,
        tolerance=config.temporal.tolerance,
        max_rounds=config.temporal.max_rounds,
    )
    return partial(refine, bones=dictionary.edges, settings=settings)


def refine(
    lifting: Lifting, images: LandmarkSet, bones: NDArray[np.integer], settings: Sequencing
) -> Lifting:
    """Refine the depths along each sequence, with x and y as observed where a landmark is seen.

    Bones keep their lengths in the observed landmarks, not in those fitted image by image. What
    is hidden or set aside as an outlier keeps its fitted x and y. All but the shapes stays.
    """
    seen = lifting.problem.weights > 0
    if lifting.estimate.outliers is not None:
        seen &= ~lifting.estimate.outliers
    seen &= np.isfinite(lifting.scale)[:, None]
    shapes = lifting.shapes.copy()
    shapes[:, :2] = np.where(seen[:, None, :], images.landmarks, shapes[:, :2])
    refined = refine_sequences(shapes, images.sequences or (), bones, settings)
    return replace(lifting, shapes=refined)


def choose_program(config: FitConfig) -> Program:
    """Return the convex program that the config names."""
    return Program(
        lam=None if config.lam == "auto" else config.lam,
        loss=Loss(config.loss),
        beta=config.beta,
        noise=config.noise or 0.0,
    )


def choose_settings(config: FitConfig, dictionary: Dictionary) -> Settings:
    """Return what the methods need besides the problem."""
    if config.method == "pmp" and dictionary.edges is None:
        raise input_error(
            config.dictionary,
            "no `edges`, the limbs whose lengths pmp keeps",
            "learn it with `method: pca-bases` from shapes with edges",
        )
    options = config.alternation
    return Settings(
        solve=choose_solver(config),
        mean_shape=dictionary.mean_shape,
        edges=dictionary.edges,
        orthogonal=config.orthogonal,
        signed=options.signed,
        views=options.views,
        multi_start=options.multi_start,
        tolerance=options.tolerance,
        max_rounds=options.max_rounds,
        threads=config.threads,
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
    return choose_newton(config)


def choose_newton(config: FitConfig) -> WarmSolve:
    """Return the fast solver with the options of the config."""
    options = config.solver
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


def find_failures(images: LandmarkSet, lifting: Lifting, config: FitConfig) -> tuple[Failure, ...]:
    """List the items without a shape and, where `strict`, those that are not optimal."""
    reasons = dict(lifting.failures)
    if config.strict:
        for image, status in enumerate(lifting.estimate.status):
            if status not in (Status.OPTIMAL, Status.CONVERGED):
                reasons.setdefault(image, describe(lifting, image))
    return tuple(Failure(images.items[image], reasons[image]) for image in sorted(reasons))


def find_warnings(lifting: Lifting, config: FitConfig) -> tuple[str, ...]:
    """Say how many images stopped at the iteration limit."""
    limited = [
        image
        for image, status in enumerate(lifting.estimate.status)
        if status is Status.ITERATION_LIMIT
    ]
    if config.strict or not limited:
        return ()
    gap = lifting.estimate.relative_gap
    worst = limited[0] if gap is None else max(limited, key=lambda image: gap[image])
    return (f"{len(limited)} images not optimal, the worst: {describe(lifting, worst)}",)


def describe(lifting: Lifting, image: int) -> str:
    """Say how far an image got."""
    found = lifting.estimate
    reached = f"{found.status[image].value} after {found.iterations[image]} iterations"
    if found.relative_gap is None:
        return reached
    return f"{reached}, relative gap {found.relative_gap[image]:.2g}"
