"""The config of `fit`."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from annotated_types import Gt
from pydantic import Field, PlainValidator, ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticCustomError

from shapefit.config.commands.fit_camera import ViewingConfig
from shapefit.config.commands.fit_export import ExportConfig, PicturesConfig
from shapefit.config.commands.fit_outliers import OutlierSearchConfig
from shapefit.config.commands.fit_posterior import PosteriorConfig
from shapefit.config.commands.fit_sequences import SequencesConfig
from shapefit.config.expectation import Expected
from shapefit.config.model import (
    MOST_STEPS,
    MOST_THREADS,
    CommandConfig,
    ConfigModel,
    FromLists,
    Renaming,
)
from shapefit.config.paths import InputPath, InputPaths, OutputPath
from shapefit.errors import listed
from shapefit.lifting.methods import (
    ALTERNATION,
    METHODS,
    ROBUST,
    AlternationOptions,
    summarise,
    those,
)

if TYPE_CHECKING:
    MethodName = str
else:
    MethodName = Literal[tuple(METHODS)]

SEARCHING = listed(those(lambda method: method.section == ALTERNATION), "and")
"""The methods that read the section `alternation`."""


def _number_or_auto(value: Any) -> float | Literal["auto"]:
    if value == "auto":
        return "auto"
    number = value if isinstance(value, int | float) and not isinstance(value, bool) else math.nan
    if not (math.isfinite(number) and number > 0):
        raise PydanticCustomError("number_or_auto", "expected a number > 0 or auto")
    return float(number)


class SolverConfig(ConfigModel):
    """How the convex program is solved, and when an image counts as solved."""

    name: Literal["newton", "admm"] = Field(
        default="newton", description="The fast solver, or the paper's ADMM."
    )
    tolerance: float = Field(
        default=METHODS["convex"].tolerance,
        gt=0,
        description="An image is solved when its relative duality gap (stop: gap) or its relative "
        "residuals (stop: change) fall to this.",
    )
    stop: Literal["gap", "change"] = Field(
        default="gap",
        description="What the tolerance bounds: the relative duality gap, or the paper's rule on "
        "the change between iterations (admm only).",
    )
    max_iterations: int = Field(
        default=1000, ge=1, le=MOST_STEPS, description="Most iterations for one image."
    )

    @field_validator("stop")
    @classmethod
    def _change_needs_admm(cls, stop: str, info: ValidationInfo) -> str:
        if stop == "change" and info.data.get("name") == "newton":
            raise ValueError("`stop: change` belongs to the solver admm; use `gap` or name: admm")
        return stop


class AlternationConfig(ConfigModel):
    """How the methods that share one rotation alternate."""

    signed: bool = Field(
        default=AlternationOptions.signed,
        description="Coefficients of either sign (convex+refine keeps them >= 0).",
    )
    views: int = Field(
        default=AlternationOptions.views,
        ge=1,
        le=1000,
        description="Views, spread evenly, from which the pose of the mean shape is sought.",
    )
    multi_start: bool = Field(
        default=AlternationOptions.multi_start,
        description="alternate: also start from each of the views, and keep the lowest objective.",
    )
    tolerance: float = Field(
        default=AlternationOptions.tolerance,
        gt=0,
        description="Relative fall of the objective at which a round is the last.",
    )
    max_rounds: int = Field(
        default=AlternationOptions.max_rounds,
        ge=1,
        le=MOST_STEPS,
        description="Most rounds for one image.",
    )


class FitConfig(CommandConfig):
    """Lift 2D landmarks to 3D shapes with a dictionary."""

    landmarks: InputPaths = Field(description="Files of 2D landmarks (HDF5 or CSV; - is stdin).")
    dictionary: InputPath = Field(description="Dictionary file that learn-dict wrote.")
    rename: Renaming = Field(
        default_factory=dict,
        description="Landmarks that the files call otherwise: name in the files -> name in the "
        "dictionary.",
    )
    output: OutputPath = Field(
        description="Result file to write: HDF5, or tidy CSV if it ends in .csv or is - (stdout)."
    )
    method: MethodName = Field(default="convex", description=f"How to lift: {summarise()}.")
    loss: Literal["squared", "exact", "l1", "sparse-error"] = Field(
        default="squared",
        description="The data term: half the squared residual; exact, no residual at all (lambda "
        "has no say); l1, the sum of absolute residuals; sparse-error, the squared residual "
        "beside sparse errors with weight beta. The last two survive outliers and label them.",
    )
    lam: Annotated[
        float | Literal["auto"],
        Expected("a number > 0 or auto"),
        PlainValidator(_number_or_auto),
    ] = Field(
        default=0.1,
        alias="lambda",
        description="Weight of the sum of spectral norms, for normalised landmarks and atoms; "
        "auto follows from `noise`.",
    )
    noise: float | None = Field(
        default=None,
        ge=0,
        description="Expected standard deviation of a landmark's coordinate, in the unit of the "
        "landmarks; `lambda: auto` needs it.",
    )
    beta: float = Field(
        default=0.1,
        gt=0,
        description="Residual, for normalised landmarks, beyond which a robust loss judges a "
        "landmark an outlier; the weight of the errors of sparse-error.",
    )
    path: Annotated[
        tuple[Annotated[float, Gt(0)], ...], FromLists, Expected("a list of falling numbers > 0")
    ] = Field(
        default=(),
        description="Lambdas, falling, at which the program is solved too, each from the "
        "solution before it; objective, gap, residual and active atoms go into the result.",
    )
    solver: SolverConfig = Field(
        default_factory=SolverConfig.model_construct,
        description="How the convex program is solved.",
    )
    orthogonal: bool = Field(
        default=False,
        description="convex: replace the rotation of each atom by the nearest proper one.",
    )
    alternation: AlternationConfig = Field(
        default_factory=AlternationConfig.model_construct,
        description=f"How {SEARCHING} search.",
    )
    posterior: PosteriorConfig = Field(
        default_factory=PosteriorConfig.model_construct,
        description="How posterior weighs landmarks against the prior over shapes.",
    )
    sequences: SequencesConfig = Field(
        default_factory=SequencesConfig.model_construct,
        description="How the method sequences ties the images of a sequence together.",
    )
    leave_out: str | None = Field(
        default=None,
        min_length=1,
        description="Dataset of the landmarks that names, for each image, the training shape "
        "whose atoms its fit must do without (dictionaries of exemplars); `item` where images are "
        "named like training shapes.",
    )
    outliers: OutlierSearchConfig = Field(
        default_factory=OutlierSearchConfig.model_construct,
        description="Which landmarks the fit leaves out because they are wrong.",
    )
    camera: ViewingConfig = Field(
        default_factory=ViewingConfig.model_construct,
        description="How the camera saw the landmarks.",
    )
    export: ExportConfig = Field(
        default_factory=ExportConfig.model_construct, description="Mesh files of the fitted shapes."
    )
    pictures: PicturesConfig = Field(
        default_factory=PicturesConfig.model_construct, description="Pictures of the fitted shapes."
    )
    threads: int = Field(
        default=0, ge=0, le=MOST_THREADS, description="Threads to solve with; 0 is one per core."
    )
    chunk: int = Field(
        default=4096,
        ge=1,
        le=10_000_000,
        description="Images held in memory at a time, rounded up to a multiple of 64; no result "
        "depends on it, except with `leave_out`, within the tolerance of the solver. With "
        "`method: sequences` whole sequences are held instead.",
    )
    strict: bool = Field(
        default=False, description="Count an image whose tolerance was not reached as failed."
    )
    transforms: bool = Field(
        default=False, description="Also write the (k, 2, 3) transforms of every image (large)."
    )
    proof: bool = Field(
        default=True,
        description="Also write what proves the optimum of the convex program, the dual and the "
        "active transforms, for `shapefit verify` (HDF5 only).",
    )

    @property
    def labels_outliers(self) -> bool:
        """Whether the fit says which landmarks it judges wrong."""
        return self.loss in ROBUST or self.outliers.method != "none"

    @field_validator("path")
    @classmethod
    def _path_falls(cls, path: tuple[float, ...]) -> tuple[float, ...]:
        if any(after >= before for before, after in pairwise(path)):
            raise ValueError(f"expected falling numbers, found {list(path)}")
        return path

    @model_validator(mode="after")
    def _belong_together(self) -> Self:
        if self.lam == "auto" and self.noise is None:
            raise ValueError("`lambda: auto` needs `noise`; give the noise of a landmark")
        if self.loss != "squared" and self.solver.name == "admm":
            raise ValueError(f"the solver admm knows only `loss: squared`, not {self.loss}")
        method = METHODS[self.method]
        if self.loss not in method.losses:
            fit = those(lambda other: self.loss in other.losses)[0]
            raise ValueError(
                f"the method {self.method} does not know `loss: {self.loss}`; "
                f"take `loss: {method.losses[0]}` or `method: {fit}`"
            )
        if self.loss in ROBUST and self.outliers.method != "none":
            raise ValueError(
                f"`loss: {self.loss}` and `outliers: {{method: {self.outliers.method}}}` both look "
                "for outliers; leave out one of them"
            )
        optima = listed(those(lambda other: other.proves == "optimum"))
        if self.path and method.proves != "optimum":
            raise ValueError(f"`path` belongs to the method {optima}; leave it out")
        if self.path and (self.loss == "exact" or self.solver.name == "admm"):
            raise ValueError(
                "`path` needs the solver newton and a loss that lambda weighs against; leave it out"
            )
        if self.path and (self.leave_out or self.outliers.method != "none"):
            raise ValueError(
                "`path` goes with neither `leave_out` nor a search for outliers; leave it out"
            )
        weak = self.camera.model == "weak-perspective"
        free = listed(those(lambda other: not other.one_rotation))
        if self.export.rotation == "per-atom" and (method.one_rotation or not weak):
            raise ValueError(
                f"`export: {{rotation: per-atom}}` belongs to the method {free} and weak "
                "perspective; the others have one rotation an image: set shared"
            )
        if not (weak or method.perspective):
            raise ValueError(
                f"`camera: {{model: perspective}}` does not go with the method {self.method}; "
                "take another"
            )
        return self
