"""The arguments of the functions: their words and sections, and how they are checked.

A config of the command is made of them: same keys, defaults and errors.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Mapping
from difflib import get_close_matches
from functools import wraps
from inspect import signature
from os import PathLike
from pathlib import Path
from typing import Literal, ParamSpec, TypedDict, TypeVar

import numpy as np

from shapefit.arrays import Floats
from shapefit.config import CONFIGS, CommandConfig, load_config
from shapefit.errors import InputError

File = str | PathLike[str]
Automatic = Literal["auto"]

Method = Literal[
    "auto",
    "convex",
    "convex+refine",
    "global",
    "alternate",
    "pmp",
    "mean-shape",
    "posterior",
    "sequences",
]
"""How `fit` lifts."""

Outliers = Literal["none", "ransac", "sparse-error", "l1"]
"""What becomes of wrong landmarks."""

Direction = Literal["down", "up"]
"""Where y points."""

BodyMeasure = Literal["head", "hips", "shoulders"]
"""What differs between the skeletons of detectors."""

LearningMethod = Literal["sparse-coding", "exemplars", "pca-bases"]
"""How `learn` makes atoms."""

Metric = Literal[
    "similarity",
    "camera",
    "rotation",
    "reprojection",
    "expected",
    "precision",
    "recall",
]
"""What `evaluate` measures."""


class Camera(TypedDict, total=False):
    """The camera of the images: the section `camera` of a config of `fit`.

    Attributes
    ----------
    focal : float, "auto", "none", "files" or array of shape (3, 3) or (n, 3, 3)
        Focal length in pixels, or the matrices of a perspective camera.
    focal_sd : float
        Standard deviation of its logarithm.
    principal_point : (x, y)
        Pixel on the optical axis.
    calibration : path
        File of cameras (TOML, YAML or JSON).
    name : str
        The camera of the calibration.

    """

    focal: float | Literal["auto", "none", "files"] | Floats
    focal_sd: float
    principal_point: tuple[float, float] | None
    calibration: File | None
    name: str | None


class Prior(TypedDict, total=False):
    """How landmarks are weighed against the prior: the section `prior` of `fit`.

    Attributes
    ----------
    scale : float or "auto"
        Factor on the covariances of the prior.
    residual_variance : float or "auto"
        Variance of a normalised coordinate that neither prior nor camera explains.
    calibration : path
        `error_bars.json` of a report of `eval`.
    bar_scale : float
        Factor on all covariances of error bars.

    """

    scale: float | Automatic
    residual_variance: float | Automatic
    calibration: File | None
    bar_scale: float


class Save(TypedDict, total=False):
    """What a fit holds besides the shapes: the section `save` of `fit`.

    Attributes
    ----------
    proof : bool or "auto"
        The certificate of the optimum.
    covariance : bool
        The covariance of all landmarks of an image.

    """

    proof: bool | Automatic
    covariance: bool


class LearnedPrior(TypedDict, total=False):
    """The prior over shapes: the section `prior` of a config of `learn-dict`.

    Attributes
    ----------
    components : int or "auto"
        Gaussians in the mixture; 0 learns no prior.
    bone_scale : float
        Standard deviation of the logarithm of bone lengths of varied shapes.
    exchange : float
        Share of the shapes that take limbs from others.
    shrinkage : float
        Share of the covariance of all shapes in that of a component.
    floor : float
        Variance of every coordinate beyond that of the shapes.

    """

    components: int | Automatic
    bone_scale: float
    exchange: float
    shrinkage: float
    floor: float


KEY_OF = {"lam": "lambda"}
"""Arguments whose keys have a name that Python reserves."""

P = ParamSpec("P")
Made = TypeVar("Made")


def with_suggestions(function: Callable[P, Made]) -> Callable[P, Made]:
    """Wrap a function: an unknown argument raises InputError with the nearest one.

    Python's own TypeError has no hint.
    """
    known = signature(function).parameters

    @wraps(function)
    def call(*args: P.args, **keywords: P.kwargs) -> Made:
        unknown = [name for name in keywords if name not in known]
        if unknown:
            raise unknown_arguments(function.__name__, unknown, known)
        return function(*args, **keywords)

    return call


def unknown_arguments(
    function: str, unknown: Collection[str], known: Collection[str]
) -> InputError:
    """Return the InputError for arguments that a function does not have."""
    problems = []
    for name in unknown:
        near = get_close_matches(name, known, n=1)
        fix = f"the arguments are {', '.join(known)}"
        if near:
            fix = f"did you mean `{near[0]}`?"
        elif name in _keys_of(function):
            fix = "it is for files: give it to what reads or writes them"
        problems.append(f"{function}.{name}: there is no argument `{name}`; {fix}")
    return InputError(problems)


COMMANDS = {"fit": "fit", "learn": "learn-dict", "evaluate": "eval"}
"""The command that does the same as a function."""


def _keys_of(function: str) -> Collection[str]:
    """Return the config keys of the command that a function stands for, if any."""
    command = COMMANDS.get(function)
    return CONFIGS[command].model_fields if command else ()


Config = TypeVar("Config", bound=CommandConfig)


def config_of(
    function: str,
    schema: type[Config],
    given: Mapping[str, object],
    placeholders: Mapping[str, object],
    file: File | None = None,
) -> Config:
    """Return the checked config of a file, if any, and a function's arguments `given`.

    `placeholders` stand for the files of the command in messages. Raises InputError for
    each problem, with the name of its argument.
    """
    config = load_config(
        COMMANDS[function],
        None if file is None else Path(file),
        arguments=in_plain_types(given),
        prefix=f"{function}.",
        placeholders=placeholders,
    )
    assert isinstance(config, schema)
    return config


def in_plain_types(given: Mapping[str, object]) -> dict[str, object]:
    """Return values in types of YAML: arrays and tuples as lists, paths as texts."""

    def as_text_or_numbers(part: object) -> object:
        return part.tolist() if isinstance(part, np.ndarray | np.generic) else str(part)

    values: dict[str, object] = json.loads(
        json.dumps(given, default=as_text_or_numbers)
    )
    return values
