"""The config of `simulate`."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge
from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from shapefit.config.model import (
    MOST_STEPS,
    MOST_THREADS,
    CommandConfig,
    ConfigModel,
    FromLists,
    Plots,
    section,
)
from shapefit.config.paths import Expected, OutputPath


def _distinct(values: tuple[int, ...]) -> tuple[int, ...]:
    if len(set(values)) < len(values):
        raise ValueError(f"expected different numbers, found {list(values)}")
    return values


Landmarks = Annotated[
    tuple[Annotated[int, Ge(2)], ...],
    FromLists,
    AfterValidator(_distinct),
    Expected("a list of whole numbers >= 2"),
]
ActiveAtoms = Annotated[
    tuple[Annotated[int, Ge(1)], ...],
    FromLists,
    AfterValidator(_distinct),
    Expected("a list of whole numbers >= 1"),
]


class ExactSolverConfig(ConfigModel):
    """When the noiseless program counts as solved."""

    tolerance: float = Field(default=1e-6, gt=0)
    """An instance is solved when its relative duality gap and its relative residual fall to
    this."""
    max_iterations: int = Field(default=10000, ge=1, le=MOST_STEPS)
    """Maximum iterations per instance."""


class SimulateConfig(CommandConfig):
    """Measure how often the noiseless program recovers planted transforms exactly."""

    output: OutputPath
    """Folder to write the report to."""
    k: int = Field(default=50, ge=1)
    """Number of atoms, their entries N(0, 1)."""
    landmarks: Landmarks = tuple(range(5, 51, 5))
    """Numbers of landmarks (p), one per row."""
    active_atoms: ActiveAtoms = Field(default=tuple(range(1, 11)), validate_default=True)
    """Numbers of atoms in use (z), one per column."""
    trials: int = Field(default=100, ge=1)
    """Random instances in each cell."""
    translation: Literal["free", "none"] = "free"
    """free: the program has a translation T, which is equivalent to centring landmarks and atoms
    and costs the information of one landmark; none: T is 0."""
    solver: ExactSolverConfig = section(ExactSolverConfig)
    seed: int = Field(default=0, ge=0)
    """Seed of every random choice."""
    threads: int = Field(default=0, ge=0, le=MOST_THREADS)
    """Threads to solve with; 0 is one per core."""
    plots: Plots = "auto"
    """Also draw the heat map (PNG and SVG); auto: where matplotlib is installed."""

    @field_validator("landmarks", "active_atoms")
    @classmethod
    def _at_least_one(cls, values: tuple[int, ...]) -> tuple[int, ...]:
        if not values:
            raise ValueError("expected at least one number, found an empty list")
        return values

    @field_validator("active_atoms")
    @classmethod
    def _not_more_than_there_are(
        cls, values: tuple[int, ...], info: ValidationInfo
    ) -> tuple[int, ...]:
        k = info.data.get("k")
        if k is not None and max(values) > k:
            raise ValueError(
                f"expected numbers of atoms in use up to k = {k}, found {max(values)}; "
                "leave out larger numbers, or raise k"
            )
        return values
