"""The config of `project`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from shapefit.config.model import CommandConfig, ConfigModel, FromLists, section
from shapefit.config.paths import UNNAMED, Description, InputPaths, OutputPath

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


def _view(view: str | Rotation) -> str | Rotation:
    if not isinstance(view, str) and not _is_rotation(view):
        raise ValueError("expected a rotation (orthonormal rows, determinant +1)")
    return view


class CameraConfig(ConfigModel):
    """The camera that sees the shapes."""

    view: Annotated[
        Literal["turntable", "random"] | Rotation,
        Description("turntable, random, or a rotation as three rows of three numbers"),
        FromLists,
        AfterValidator(_view),
    ] = "turntable"
    """One full turn per sequence about the y axis, a random rotation per image, or one
    rotation for all, from object to camera frame (x and y as in the landmarks): three rows,
    orthonormal, determinant +1."""
    scale: float | None = Field(default=None, gt=0)
    """Pixels per unit of the shape, for a weak-perspective camera; without it the camera is
    orthographic and landmarks have the unit of the shapes."""


class ProjectConfig(CommandConfig):
    """Project 3D shapes to synthetic 2D landmarks."""

    COMMAND = "project"
    OUTPUT = "_landmarks.h5"

    shapes: InputPaths
    """Files of 3D shapes (- is stdin, CSV)."""
    output: OutputPath = UNNAMED
    """Landmark file to write: HDF5, or tidy CSV if it ends in .csv or is - (stdout); by default
    NAME_landmarks.h5 in the working directory."""
    camera: CameraConfig = section(CameraConfig)
    y_axis: Literal["down", "up"] = "down"
    """Where y points in the landmarks that are written: down, as pixels are counted, or up."""
    noise: float = Field(default=0.0, ge=0)
    """Standard deviation of Gaussian noise on each coordinate, in the unit of the landmarks."""
    hidden: float = Field(default=0.0, ge=0, lt=1)
    """Share of landmarks hidden, different ones in each image; at least three remain visible."""
    seed: int = Field(default=0, ge=0)
    """Seed of every random choice."""
