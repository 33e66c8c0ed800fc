"""The config of `fit`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, ValidationInfo, field_validator

from shapefit.config.model import CommandConfig, ConfigModel
from shapefit.config.paths import InputPath, InputPaths, OutputPath


class SolverConfig(ConfigModel):
    """How the convex program is solved, and when an image counts as solved."""

    name: Literal["newton", "admm"] = Field(
        default="newton", description="The fast solver, or the paper's ADMM."
    )
    tolerance: float = Field(
        default=1e-4,
        gt=0,
        description="An image is solved when its relative duality gap (stop: gap) or its relative "
        "residuals (stop: change) fall to this.",
    )
    stop: Literal["gap", "change"] = Field(
        default="gap",
        description="What the tolerance bounds: the relative duality gap, or the paper's rule on "
        "the change between iterations (admm only).",
    )
    max_iterations: int = Field(default=1000, ge=1, description="Most iterations for one image.")

    @field_validator("stop")
    @classmethod
    def _change_needs_admm(cls, stop: str, info: ValidationInfo) -> str:
        if stop == "change" and info.data.get("name") == "newton":
            raise ValueError("`stop: change` belongs to the solver admm; use `gap` or name: admm")
        return stop


class FitConfig(CommandConfig):
    """Lift 2D landmarks to 3D shapes with a dictionary."""

    landmarks: InputPaths = Field(description="Files of 2D landmarks (HDF5 or CSV; - is stdin).")
    dictionary: InputPath = Field(description="Dictionary file that learn-dict wrote.")
    output: OutputPath = Field(
        description="Result file to write: HDF5, or tidy CSV if it ends in .csv or is - (stdout)."
    )
    method: Literal["convex"] = Field(
        default="convex", description="How to lift: the convex program."
    )
    lam: float = Field(
        default=0.1,
        alias="lambda",
        ge=0,
        description="Weight of the sum of spectral norms, for normalised landmarks and atoms.",
    )
    solver: SolverConfig = Field(
        default_factory=SolverConfig, description="How the convex program is solved."
    )
    threads: int = Field(default=0, ge=0, description="Threads to solve with; 0 is one per core.")
    chunk: int = Field(default=4096, ge=1, description="Images held in memory at a time.")
    strict: bool = Field(
        default=False, description="Count an image whose tolerance was not reached as failed."
    )
    transforms: bool = Field(
        default=False, description="Also write the (k, 2, 3) transforms of every image (large)."
    )
