"""The plan of a fit: what config and dictionary ask of each of its steps, found out once."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.config import FitConfig
from shapefit.config.paths import ResultFolder
from shapefit.convex.newton import solve_newton
from shapefit.convex.problem import Loss
from shapefit.core import STRETCH
from shapefit.dictionary.model import Dictionary
from shapefit.dictionary.origin import describe_learning
from shapefit.errors import input_error
from shapefit.io import LandmarkSet, LandmarkSource
from shapefit.io.formats import HDF5, FileFormat, find_target_format
from shapefit.io.options import InputOptions, input_options
from shapefit.lifting.lift import Lifting, Program
from shapefit.lifting.methods import (
    METHODS,
    ROBUST,
    AlternationOptions,
    PosteriorOptions,
    Settings,
    choose_method,
)
from shapefit.lifting.options import BETA, PerspectiveOptions
from shapefit.pipelines.fit.camera import find_calibrated
from shapefit.pipelines.fit.chain import Chain, Lifter, Refinement, Search, View, weigh_seen
from shapefit.pipelines.fit.read import BATCH, ReadOptions, warn_of_source
from shapefit.pipelines.fit.record import RecordOptions, warn_of_names
from shapefit.pipelines.fit.report import ReportOptions
from shapefit.pipelines.joints import MEANS, Mapped, find_hung, match_names, of_files

if TYPE_CHECKING:
    from shapefit.geometry.pinhole import Camera
    from shapefit.lifting.methods import Solve

FEW_BATCHES = 8
"""That are lifted one at a time: what threads cost each other is more than what they gain."""

Given = TypeVar("Given")
Found = TypeVar("Found")


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What each step of a fit is given; no step sees the config, nor another step's options.

    dictionary     as the files of landmarks need it
    threads        1: nothing is done beside something else
    stores_names   the output holds further datasets of the landmarks
    needs_rate     the frame rate of the files counts
    warnings       of the dictionary
    """

    dictionary: Dictionary
    read: ReadOptions
    mapped: Mapped
    lift: Chain
    record: RecordOptions
    report: ReportOptions
    threads: int
    stores_names: bool
    needs_rate: bool
    warnings: tuple[str, ...]

    def lifts_at_a_time(self, source: LandmarkSource) -> int:
        """How many batches are lifted beside reading and writing; 0 where all is one after another.

        Of the convex program, which is solved quickly, one is arranged while another is solved.
        """
        if self.threads == 1 or source.count <= (self.read.batch or BATCH):
            return 0
        quick = self.record.optimum and self.lift.search is None
        return 2 if quick and source.count > FEW_BATCHES * BATCH else 1

    def warn_of(self, source: LandmarkSource) -> tuple[str, ...]:
        """Say what is doubtful of the files and of the dictionary together."""
        renamed = warn_of_names(source.head.further) if self.stores_names else ()
        return (*warn_of_source(source, self.read), *self.warnings, *renamed)


def plan_fit(config: FitConfig, dictionary: Dictionary, landmark_names: Sequence[str]) -> Plan:
    """Return the plan of a fit of landmarks of these names with a dictionary.

    Raises InputError where the dictionary lacks what the method needs, it and the landmarks have
    too few names in common, or the output cannot hold what the config asks for.
    """
    method, target = METHODS[config.method], output_format(config)
    dictionary = of_files(dictionary, landmark_names, in_place=method.has_prior)
    if config.transforms and target.points_only:
        found = f"cannot be stored in {config.output}: CSV holds points only"
        raise input_error("transforms", found, "name an HDF5 output, or leave it out")
    names, place = dictionary.landmark_names, ", ".join(map(str, config.landmarks))
    place += ": landmark names"
    joints, strange = match_names(landmark_names, names, place, in_place=method.has_prior)
    read = ReadOptions(
        names=names,
        joints=joints,
        leave_out=bool(strange),
        place=place,
        batch=None if method.sequences else math.ceil(config.chunk / STRETCH) * STRETCH,
        camera=find_calibrated(config.camera),
    )
    hung = find_hung(dictionary)
    active = method.has_prior and bool(joints.stand_ins or hung is not None)
    mapped = Mapped(
        joints,
        config.theta or MEANS,
        active,
        config.posterior.covariance,
        hung,
        find_misfit(config, dictionary),
    )
    return Plan(
        dictionary=dictionary,
        read=read,
        mapped=mapped,
        lift=choose_chain(with_covariance(config) if active else config, mapped.see(dictionary)),
        record=RecordOptions(
            transforms=config.transforms,
            proof=config.proof,
            optimum=method.proves == "optimum",
            frame_rate=config.sequences.frame_rate,
            implausible=config.posterior.implausible,
            widest=config.posterior.widest,
            left_out=choose_left_out(config, dictionary),
        ),
        report=ReportOptions(
            strict=config.strict,
            precisions=method.precisions and config.posterior.least_score is None,
            scores=method.precisions and config.posterior.least_score is not None,
            within=config.search.modes,
            leave_out=config.leave_out,
        ),
        threads=config.threads,
        stores_names=not target.points_only,
        needs_rate=method.sequences and not config.sequences.frame_rate,
        warnings=(*mismatch(config, dictionary), *describe_learning(dictionary)),
    )


def output_format(config: FitConfig) -> FileFormat:
    """Return the format of the results."""
    if isinstance(config.output, ResultFolder):
        return HDF5
    return find_target_format(config.output)


def read_options(config: FitConfig) -> InputOptions:
    """Return how the landmark files are read.

    Detections without identity are joined to sequences where those are needed.
    """
    joined = output_format(config).by_sequence or METHODS[config.method].sequences
    return input_options(config.input, "motion" if joined else "none")


def with_covariance(config: FitConfig) -> FitConfig:
    """Ask for the covariance of all landmarks, of which the joints have their error bars."""
    posterior = config.posterior.model_copy(update={"covariance": True})
    return config.model_copy(update={"posterior": posterior})


def choose_chain(config: FitConfig, dictionary: Dictionary) -> Chain:
    """Return the steps that the config asks for.

    Raises InputError where the dictionary lacks what they need.
    """
    check_needs(config, dictionary)
    METHODS[config.method].load()
    solve = one_at_a_time(choose_solver(config))
    return Chain(
        sequences=choose_refinement(config, dictionary),
        program=choose_program(config),
        precisions=METHODS[config.method].precisions,
        weigh=choose_weights(config),
        aside=dictionary.hung >= 0 if METHODS[config.method].has_prior else None,
        search=choose_search(config),
        method=lambda part: choose_method(config.method, choose_settings(config, part, solve)),
        camera=choose_camera(config),
        view=choose_view(config),
        leave_out=choose_groups(config, dictionary),
    )


def one_at_a_time(work: Callable[[Given], Found]) -> Callable[[Given], Found]:
    """Return work that one thread does while others wait: it has threads of its own."""
    turn = Lock()

    def alone(given: Given) -> Found:
        with turn:
            return work(given)

    return alone


def choose_weights(config: FitConfig) -> Callable[[LandmarkSet], Floats]:
    """Return what weighs landmarks (n, p): their confidence, or whether it is enough."""
    least = config.posterior.least_score
    if least is None or not METHODS[config.method].precisions:
        return LandmarkSet.weights
    return partial(weigh_seen, least=least)


def choose_groups(
    config: FitConfig, dictionary: Dictionary
) -> Callable[[LandmarkSet, Dictionary, Lifter], Lifting] | None:
    """Return what lifts each image without the model that it shows, if the config asks for it."""
    if config.leave_out is None:
        return None
    from shapefit.pipelines.fit.left_out import check_items, lift_left_out

    check_items(dictionary)
    return partial(lift_left_out, dataset=config.leave_out, threads=config.threads)


def choose_left_out(
    config: FitConfig, dictionary: Dictionary
) -> Callable[[LandmarkSet], NDArray[np.str_]] | None:
    """Return what names the item that the fit of each image does without, if the config asks."""
    if config.leave_out is None:
        return None
    from shapefit.pipelines.fit.left_out import find_left_out

    return partial(find_left_out, dataset=config.leave_out, dictionary=dictionary)


def choose_search(config: FitConfig) -> Search | None:
    """Return the search for outliers that the config names, if any."""
    if config.outliers.method in ("none", *ROBUST):
        return None
    from shapefit.pipelines.fit.outlier_search import choose_search as choose
    from shapefit.pipelines.fit.outlier_search import find_inliers

    search = choose(config.outliers, config.threads)
    return partial(find_inliers, search)


def choose_view(config: FitConfig) -> View | None:
    """Return what follows weak perspective: nothing, or refinement under the full projection."""
    if config.camera.model != "perspective" or METHODS[config.method].perspective != "refined":
        return None
    import shapefit.lifting.perspective.view  # noqa: F401 - before the clock of solving starts
    from shapefit.pipelines.fit.camera import refine_through_camera

    options = choose_options(config)
    views = AlternationOptions(views=config.alternation.views).number_of_views
    return partial(refine_through_camera, config=config.camera, options=options, views=views)


def choose_camera(config: FitConfig) -> Callable[[LandmarkSet], Camera] | None:
    """Return what finds the cameras of images for a method that looks through them itself."""
    if config.camera.model != "perspective" or METHODS[config.method].perspective != "own":
        return None
    from shapefit.pipelines.fit.camera import find_camera

    return partial(find_camera, config=config.camera)


def choose_options(config: FitConfig) -> PerspectiveOptions:
    """Return how the config wants shapes refined under perspective."""
    return PerspectiveOptions(
        threads=config.threads,
    )


def choose_refinement(config: FitConfig, dictionary: Dictionary) -> Refinement | None:
    """Return the inference over whole sequences, where the method is for these."""
    if not METHODS[config.method].sequences:
        return None
    from shapefit.lifting.sequences.method import refine_lifting
    from shapefit.lifting.sequences.through_camera import refine_through_camera
    from shapefit.pipelines.fit.motion import find_lengths, find_motion

    path = config.sequences.lengths
    lengths = None if path is None else find_lengths(path, dictionary)

    def refine(lifting: Lifting, images: LandmarkSet) -> Lifting:
        rate = config.sequences.frame_rate or images.frame_rate
        motion = find_motion(dictionary, rate, lengths)

        def refine_weak(lifting: Lifting, landmarks: Floats) -> Lifting:
            return refine_lifting(
                lifting,
                landmarks,
                images.sequences or (),
                motion,
                find_misfit(config, dictionary),
                config.posterior.widening,
                config.threads,
            )

        return refine_through_camera(lifting, images.landmarks, refine_weak)

    return refine


def choose_program(config: FitConfig) -> Program:
    """Return the convex program that the config names."""
    return Program(
        lam=None if config.lam == "auto" else config.lam,
        loss=Loss(config.data_term),
        beta=config.outliers.threshold or BETA,
        noise=config.noise or 0.0,
    )


def choose_settings(config: FitConfig, dictionary: Dictionary, solve: Solve) -> Settings:
    """Return what the methods need besides the problem."""
    method = METHODS[config.method]
    options = None
    if method.section is not None:
        name, kind = method.section
        section = getattr(config, name)
        keys = type(section).model_fields.keys() & {key.name for key in fields(kind)}
        values = {key: getattr(section, key) for key in keys}
        if "misfit" in keys:
            values["misfit"] = find_misfit(config, dictionary)
        options = kind(**values)
    return Settings(
        solve=solve,
        mean_shape=dictionary.mean_shape,
        needs={need.name: getattr(dictionary, need.name) for need in method.needs},
        options=options,
        orthogonal=config.rotations == "orthogonal",
        tolerance=config.solver.tolerance,
        threads=config.threads,
    )


def find_misfit(config: FitConfig, dictionary: Dictionary) -> float:
    """Return the misfit of the config, of the dictionary, or the default."""
    if config.posterior.misfit is not None:
        return config.posterior.misfit
    known = dictionary.misfit
    return PosteriorOptions.misfit if known is None else float(known[0])


def choose_solver(config: FitConfig) -> Solve:
    """Return the solver with the options of the config.

    Where the tolerance is that of another gap, the convex program is solved at its own default.
    """
    options, tolerance = config.solver, config.solver.tolerance
    if METHODS[config.method].proves == "global":
        tolerance = min(tolerance, METHODS["convex"].tolerance)
    return partial(
        solve_newton,
        tolerance=tolerance,
        max_iterations=options.max_iterations,
        threads=config.threads,
    )


def check_needs(config: FitConfig, dictionary: Dictionary) -> None:
    """Raise InputError where the dictionary lacks what the method needs, or it is of no use."""
    for need in METHODS[config.method].needs:
        missing = getattr(dictionary, need.name) is None
        found = f"no `{need.name}`" if missing else need.useless(dictionary)
        if found:
            raise input_error(config.dictionary, f"{found}: {need.what}", need.fix)


def mismatch(config: FitConfig, dictionary: Dictionary) -> tuple[str, ...]:
    """Return a warning where the method is made for dictionaries that were learned otherwise.

    A dictionary that does not state how it was learned passes, and any where signs are free.
    """
    learned = dictionary.provenance.get("method")
    wanted = METHODS[config.method].learned
    if learned is None or not wanted or config.alternation.signed or learned in wanted:
        return ()
    kinds = " or ".join(f"`{kind}`" for kind in wanted)
    if len(wanted) == 1:
        kinds = f"`method: {wanted[0]}`"
    found = f"the dictionary was learned with `method: {learned}`"
    return (f"{found}; {config.method} is made for {kinds}",)
