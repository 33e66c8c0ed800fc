"""A method of lifting and all that it needs beside the images, by the config of a fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shapefit.convex.problem import Loss
from shapefit.convex.solver import solve_newton
from shapefit.dictionary.mixture import widen
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.geometry.pinhole import Camera
from shapefit.io import LandmarkSet
from shapefit.lifting.lift import BETA, Program
from shapefit.lifting.methods import (
    METHODS,
    Method,
    PosteriorOptions,
    Settings,
)
from shapefit.pipelines.fit.camera import camera_of

if TYPE_CHECKING:
    from shapefit.config import FitConfig

RATE = 24.0
"""Frames a second where no file states it."""

RANSAC_THRESHOLD = 0.25
"""Residual of an outlier in units of the size of the shape."""


@dataclass(frozen=True, kw_only=True)
class Lifter:
    """A method and all that it needs beside the images; None stands for its own default.

    camera is None for weak perspective; leave_one_out names the dataset of the atoms to do without.
    """

    method: str
    dictionary: Dictionary
    camera: Callable[[LandmarkSet], Camera] | None = None
    program: Program = field(default_factory=lambda: Program(0.1))
    noise: float | None = None
    tolerance: float | None = None
    residual_variance: float | None = None
    posterior: PosteriorOptions = field(default_factory=PosteriorOptions)
    prior_scale: float = 1.0
    image_size: tuple[float, float] | None = None
    min_confidence: float | None = None
    signed: bool = False
    outlier_threshold: float | None = None
    leave_one_out: str | None = None
    frame_rate: float | None = None
    threads: int = 0

    @property
    def row(self) -> Method:
        """The row of the table of methods."""
        return METHODS[self.method]

    @property
    def variance(self) -> float:
        """The residual variance: as given, of the dictionary, or the default."""
        learned = self.dictionary.residual_variance
        if self.residual_variance is not None or learned is None:
            return self.residual_variance or self.posterior.residual_variance
        return float(learned[0])


def lifter_of(config: FitConfig, dictionary: Dictionary) -> Lifter:
    """Return what lifts landmarks of a dictionary as a config says."""
    names = (field.name for field in fields(Lifter) if hasattr(config, field.name))
    shared: dict[str, Any] = {name: getattr(config, name) for name in names}
    lam, prior = None if config.lam == "auto" else config.lam, config.prior
    beta, noise = config.outlier_threshold or BETA, config.noise or 0.0
    threshold = config.outlier_threshold or RANSAC_THRESHOLD
    chosen = {
        "dictionary": dictionary,
        "camera": camera_of(config.camera),
        "program": Program(lam, Loss(config.loss), beta, noise),
        "residual_variance": prior.residual_variance,
        "posterior": PosteriorOptions(bar_scale=prior.bar_scale, covariance=config.save.covariance),
        "prior_scale": prior.scale or 1.0,
        "outlier_threshold": threshold if config.searches_outliers else None,
    }
    return Lifter(**shared | chosen)


def settings_of(lifter: Lifter) -> Settings:
    """Return what the method needs besides the problem."""
    method, dictionary = lifter.row, lifter.dictionary
    of_program = tolerance = method.tolerance if lifter.tolerance is None else lifter.tolerance
    if method.proves == "global":  # by another gap
        of_program = min(tolerance, METHODS["convex"].tolerance)
    needs = {need.name: getattr(dictionary, need.name) for need in method.needs}
    if method.has_prior:
        from shapefit.lifting.posterior.p_value import moments_at

        scale, table = lifter.prior_scale, dictionary.p_value_table
        needs["prior"] = widen(needs["prior"], scale)
        needs["p_value_table"] = None if table is None else moments_at(table, scale)
    return Settings(
        solve=partial(solve_newton, tolerance=of_program, threads=lifter.threads),
        mean_shape=dictionary.mean_shape,
        needs=needs,
        signed=lifter.signed,
        posterior=replace(lifter.posterior, residual_variance=lifter.variance),
        tolerance=tolerance,
        threads=lifter.threads,
    )


def check_needs(method: str, dictionary: Dictionary, place: str | Path) -> None:
    """Raise InputError where the dictionary lacks what the method needs, or it is of no use."""
    for need in METHODS[method].needs:
        missing = getattr(dictionary, need.name) is None
        fault = f"no `{need.name}`" if missing else need.useless(dictionary)
        if fault:
            raise input_error(place, f"{fault}: {need.what}", need.fix)
