"""The config of `learn-dict`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from shapefit.config.expectation import Expected
from shapefit.config.model import CommandConfig
from shapefit.config.paths import InputPaths, OutputPath

_ALIGN = "`all`, or a list of at least three different landmark names"


def _landmark_choice(value: Any) -> Any:
    if value == "all":
        return value
    if not isinstance(value, list | tuple) or not all(isinstance(name, str) for name in value):
        raise ValueError(f"expected {_ALIGN}, found {value!r}")
    if len(value) < 3 or len(set(value)) < len(value):
        raise ValueError(f"expected {_ALIGN}, found {list(value)}")
    return tuple(value)


class LearnDictConfig(CommandConfig):
    """Learn a dictionary of rotatable basis shapes from 3D shapes."""

    shapes: InputPaths = Field(description="Files of 3D training shapes (HDF5 or CSV).")
    output: OutputPath = Field(description="Dictionary file to write (HDF5).")
    method: Literal["sparse-coding"] = Field(
        default="sparse-coding",
        description="How to learn: non-negative sparse coding with bounded atoms.",
    )
    every: int = Field(
        default=1,
        ge=1,
        description="Keep every n-th shape of each sequence, starting with its first.",
    )
    align: Annotated[
        Literal["all"] | tuple[str, ...], Expected(_ALIGN), BeforeValidator(_landmark_choice)
    ] = Field(
        default="all",
        description="Landmarks that decide how training shapes are turned onto each other.",
    )
    k: int = Field(default=64, ge=1, description="Number of atoms; at most the number of shapes.")
    beta: float = Field(
        default=0.1, ge=0, description="Weight of the sparsity of the coefficients."
    )
    iterations: int = Field(
        default=15, ge=1, description="Most rounds of coding all shapes and updating all atoms."
    )
    tolerance: float = Field(
        default=0.0,
        ge=0,
        description="Stop when a round lowers the objective by less than this share of it; "
        "0 runs all rounds.",
    )
    atom_bound: Literal["unit", "mean"] = Field(
        default="unit",
        description="Largest norm of an atom: 1, or the mean norm of the atoms learning "
        "starts from.",
    )
    seed: int = Field(default=0, ge=0, description="Seed of every random choice.")
