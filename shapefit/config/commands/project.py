"""The config of `project`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from shapefit.config.expectation import Expected
from shapefit.config.model import CommandConfig, ConfigModel, FromLists
from shapefit.config.paths import InputPaths, OutputPath

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


class CameraConfig(ConfigModel):
    """The camera that sees the shapes."""

    model: Literal["orthographic", "weak-perspective"] = Field(
        default="orthographic", description="Orthographic, or orthographic times a scale."
    )
    view: Literal["turntable", "random", "fixed"] = Field(
        default="turntable",
        description="One full turn per sequence about the vertical axis, a random rotation for "
        "each image, or one given rotation for all.",
    )
    rotation: Annotated[Rotation | None, Expected("three rows of three numbers"), FromLists] = (
        Field(
            default=None,
            description="Rotation from object to camera frame (view: fixed): three rows, "
            "orthonormal, determinant +1.",
        )
    )
    scale: float = Field(
        default=1.0, gt=0, description="Pixels per unit of the shape (weak-perspective only)."
    )
    up: Literal["x", "y", "z"] = Field(default="y", description="The vertical axis of the shapes.")

    @field_validator("rotation")
    @classmethod
    def _proper(cls, rotation: Rotation | None) -> Rotation | None:
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
    """Grossly wrong landmarks."""

    share: float = Field(default=0.0, ge=0, lt=1, description="Share of the visible landmarks.")
    size: float = Field(
        default=1.0,
        gt=0,
        description="Largest distance by which an outlier is moved, in units of the landmarks.",
    )


class ProjectConfig(CommandConfig):
    """Project 3D shapes to synthetic 2D landmarks."""

    shapes: InputPaths = Field(description="Files of 3D shapes (HDF5 or CSV; - is stdin).")
    output: OutputPath = Field(
        description="Landmark file to write: HDF5, or tidy CSV if it ends in .csv or is - (stdout)."
    )
    camera: CameraConfig = Field(
        default_factory=CameraConfig.model_construct, description="The camera that sees the shapes."
    )
    noise: float = Field(
        default=0.0,
        ge=0,
        description="Standard deviation of Gaussian noise on landmarks, in units of the shape.",
    )
    hidden: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        description="Share of landmarks hidden, different ones in each image; at least three "
        "remain visible.",
    )
    outliers: OutlierConfig = Field(
        default_factory=OutlierConfig.model_construct,
        description="Grossly wrong landmarks.",
    )
    repeat: int = Field(
        default=1,
        ge=1,
        description="Passes over the shapes, each with different views and noise; the items of "
        "later passes end in #2, #3, ..., and `true_item` names the shape of each "
        "image.",
    )
    seed: int = Field(default=0, ge=0, description="Seed of every random choice.")

    @field_validator("camera")
    @classmethod
    def _rotation_goes_with_fixed(cls, camera: CameraConfig) -> CameraConfig:
        if (camera.view == "fixed") != (camera.rotation is not None):
            raise ValueError("`rotation` and `view: fixed` go together; give both or neither")
        return camera
