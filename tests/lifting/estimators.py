"""The methods that combine atoms, as functions of a problem alone."""

from collections.abc import Callable
from functools import partial
from inspect import signature
from typing import Any

from shapefit.convex.solver import solve_newton
from shapefit.lifting.estimate import Estimator
from shapefit.lifting.global_optimum import find_global
from shapefit.lifting.matching_pursuit import lift_by_pursuit
from shapefit.lifting.posterior.method import lift_to_posterior
from shapefit.lifting.reconstruction import lift_convex
from shapefit.lifting.shared_rotation import (
    alternate_from_mean,
    pose_mean_shape,
    refine_convex,
)

METHODS: dict[str, Callable[..., Any]] = {
    "convex": lift_convex,
    "convex+refine": refine_convex,
    "global": find_global,
    "alternate": alternate_from_mean,
    "mean-shape": pose_mean_shape,
    "pmp": lift_by_pursuit,
    "posterior": lift_to_posterior,
}


def make_estimator(name: str, **options: Any) -> Estimator[Any]:
    """Return a method with those of the options that it has."""
    method = METHODS[name]
    given = {"solve": solve_newton, **options}
    known = signature(method).parameters
    fitting = {key: value for key, value in given.items() if key in known}
    return partial(method, **fitting)
