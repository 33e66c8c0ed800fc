"""The config of `project`."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, PlainValidator
from pydantic_core import PydanticCustomError

from shapefit.config.commands.input import InputConfig
from shapefit.config.model import CommandConfig, ConfigModel, FromLists, section
from shapefit.config.paths import Expected, InputPaths, OutputPath

Row = tuple[float, float, float]
Rotation = tuple[Row, Row, Row]


def _dot(a: Row, b: Row) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _is_rotation(rows: Rotation, tolerance: float = 1e-6) -> bool:
    """Return whether the rows are orthonormal and the third is the cross product of the others."""
    (a, b, c), (d, e, f), third = rows
    cross = (b * f - c * e, c * d - a * f, a * e - b * d)
    products = [(_dot(x, y), i == j) for i, x in enumerate(rows) for j, y in enumerate(rows)]
    products.append((_dot(cross, third), True))
    return all(abs(product - target) <= tolerance for product, target in products)


_VIEW = "turntable, random, or a rotation as three rows of three numbers"


def _view(value: Any) -> str | Rotation:
    if value in ("turntable", "random"):
        return str(value)
    if not _is_3_by_3(value):
        raise PydanticCustomError("view", f"expected {_VIEW}")
    rows: Rotation = tuple(tuple(map(float, row)) for row in value)  # type: ignore[assignment]
    if not _is_rotation(rows):
        raise ValueError("expected a rotation (orthonormal rows, determinant +1)")
    return rows


def _is_3_by_3(value: Any) -> bool:
    return (
        isinstance(value, list | tuple)
        and len(value) == 3
        and all(isinstance(row, list | tuple) and len(row) == 3 for row in value)
        and all(
            isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x)
            for row in value
            for x in row
        )
    )


class CameraConfig(ConfigModel):
    """The camera that sees the shapes."""

    view: Annotated[
        Literal["turntable", "random"] | Rotation, Expected(_VIEW), FromLists, PlainValidator(_view)
    ] = "turntable"
    """One full turn per sequence about the vertical axis, a random rotation per image, or one
    rotation for all, from object to camera frame (x and y as in the landmarks): three rows,
    orthonormal, determinant +1."""
    scale: float | None = Field(default=None, gt=0)
    """Pixels per unit of the shape, for a weak-perspective camera; without it the camera is
    orthographic and landmarks have the unit of the shapes."""
    up: Literal["x", "y", "z"] = "y"
    """The vertical axis of the shapes."""


class ProjectConfig(CommandConfig):
    """Project 3D shapes to synthetic 2D landmarks."""

    shapes: InputPaths
    """Files of 3D shapes (- is stdin, CSV)."""
    input: InputConfig = section(InputConfig)
    output: OutputPath
    """Landmark file to write: HDF5, or Parquet if it ends in .parquet, or tidy CSV if it ends in
    .csv or is - (stdout)."""
    camera: CameraConfig = section(CameraConfig)
    y_axis: Literal["down", "up"] = "down"
    """Where y points in the landmarks that are written: down, as pixels are counted, or up."""
    noise: float = Field(default=0.0, ge=0)
    """Standard deviation of Gaussian noise on each coordinate, in the unit of the landmarks."""
    hidden: float = Field(default=0.0, ge=0, lt=1)
    """Share of landmarks hidden, different ones in each image; at least three remain visible."""
    seed: int = Field(default=0, ge=0)
    """Seed of every random choice."""
