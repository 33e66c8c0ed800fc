"""The config of `project`."""

from __future__ import annotations

import itertools
from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from shapefit.config.expectation import Expected
from shapefit.config.model import CommandConfig, ConfigModel, FromLists
from shapefit.config.paths import InputPaths, OutputPath

Row = tuple[float, float, float]
Rotation = Annotated[tuple[Row, Row, Row], Expected("three rows of three numbers"), FromLists]


def _is_rotation(rows: tuple[Row, Row, Row], tolerance: float = 1e-6) -> bool:
    for (i, a), (j, b) in itertools.combinations_with_replacement(enumerate(rows), 2):
        if abs(sum(x * y for x, y in zip(a, b, strict=True)) - (i == j)) > tolerance:
            return False
    (a, b, c), (d, e, f), (g, h, i) = rows
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0


class CameraConfig(ConfigModel):
    """The camera that sees the shapes."""

    model: Literal["orthographic", "weak-perspective"] = Field(
        "orthographic", description="Orthographic, or orthographic times a scale."
    )
    view: Literal["turntable", "random", "fixed"] = Field(
        "turntable",
        description="One full turn a sequence about the vertical axis, a random rotation for each "
        "image, or one given rotation for all.",
    )
    rotation: Rotation | None = Field(
        None,
        description="Rotation from object to camera frame (view: fixed): three rows, "
        "orthonormal, determinant +1.",
    )
    scale: float = Field(
        1.0, gt=0, description="Image units per unit of the shape (weak-perspective only)."
    )
    up: Literal["x", "y", "z"] = Field("y", description="The vertical axis of the shapes.")

    @field_validator("rotation")
    @classmethod
    def _proper(cls, rotation: tuple[Row, Row, Row] | None) -> tuple[Row, Row, Row] | None:
        if rotation is not None and not _is_rotation(rotation):
            raise ValueError("expected a rotation (orthonormal rows, determinant +1)")
        return rotation

    @field_validator("scale")
    @classmethod
    def _scale_needs_weak_perspective(cls, scale: float, info: ValidationInfo) -> float:
        if scale != 1 and info.data.get("model") == "orthographic":
            raise ValueError("an orthographic camera has scale 1; use model: weak-perspective")
        return scale


class OutlierConfig(ConfigModel):
    """Landmarks that are grossly wrong."""

    share: float = Field(0.0, ge=0, lt=1, description="Share of the visible landmarks.")
    size: float = Field(
        1.0, gt=0, description="Largest displacement of an outlier, in units of the landmarks."
    )


class ProjectConfig(CommandConfig):
    """Turn 3D shapes into synthetic 2D landmarks."""

    shapes: InputPaths = Field(description="Files of 3D shapes (HDF5 or CSV; - is stdin).")
    output: OutputPath = Field(
        description="Landmark file to write: HDF5, or tidy CSV if it ends in .csv or is - (stdout)."
    )
    camera: CameraConfig = Field(
        default_factory=CameraConfig, description="The camera that sees the shapes."
    )
    noise: float = Field(
        0.0,
        ge=0,
        description="Standard deviation of Gaussian noise on landmarks, in units of the shape.",
    )
    hidden: float = Field(
        0.0, ge=0, lt=1, description="Share of landmarks hidden, other ones in each image."
    )
    outliers: OutlierConfig = Field(
        default_factory=OutlierConfig, description="Landmarks that are grossly wrong."
    )
    seed: int = Field(0, ge=0, description="Seed of every random choice.")

    @field_validator("camera")
    @classmethod
    def _rotation_goes_with_fixed(cls, camera: CameraConfig) -> CameraConfig:
        if (camera.view == "fixed") != (camera.rotation is not None):
            raise ValueError("`rotation` and `view: fixed` go together; give both or neither")
        return camera
