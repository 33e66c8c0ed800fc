"""The section `camera` of `fit`: how the camera saw the landmarks."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator, model_validator

from shapefit.config.fields import Expected
from shapefit.config.model import ConfigModel, FromLists
from shapefit.config.paths import OF_THE_DATA, OptionalInputPath
from shapefit.lifting.options import PerspectiveOptions

CAMERA_MATRIX = "camera_matrix"
"""Dataset (3, 3) or (n, 3, 3) of the landmarks, and where a calibration puts its matrix."""


def _text(value: Any) -> Any:
    """Return a port, which YAML reads as a number, as text."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


class ViewingConfig(ConfigModel):
    """The camera of the images, and how a shape is refined under its full projection."""

    model: Literal["auto", "weak-perspective", "perspective"] = "auto"
    """Weak perspective, as in the convex program; or rotation, translation and coefficients refined
    from there under the full projection, which requires the focal length. The methods posterior and
    sequences look through the camera themselves. auto: perspective for these two where the
    calibration or the landmarks hold a camera matrix, or landmarks are pixels: then the focal
    length is 1.1 times the longer side of the image, and the optical axis meets its centre; else
    weak perspective."""
    image_size: Annotated[
        tuple[float, float] | None,
        Expected("two numbers, width and height"),
        FromLists,
        OF_THE_DATA,
    ] = None
    """auto: width and height of the images in pixels; by default those that the files state, or
    else as far as the landmarks reach."""
    focal: Annotated[float | None, OF_THE_DATA] = Field(default=None, gt=0)
    """Focal length of all images, in the unit of the landmarks."""
    intrinsics: str | None = Field(default=None, min_length=1)
    """Dataset of the landmarks that holds focal lengths or 3x3 camera matrices, one for the file or
    one per image; instead of `focal`."""
    principal_point: Annotated[
        tuple[float, float] | None, Expected("two numbers, x and y"), FromLists, OF_THE_DATA
    ] = None
    """Where the optical axis meets the image, in the unit of the landmarks; by default that of the
    camera matrices, or 0, 0."""
    calibration: Annotated[OptionalInputPath, OF_THE_DATA] = None
    """Calibration of the cameras (TOML of anipose, Pose2Sim, caliscope or FreeMoCap), which gives
    focal length, principal point, lens distortion and place; instead of `focal` or `intrinsics`."""
    name: Annotated[
        str | None, Expected("the name of a camera"), BeforeValidator(_text), OF_THE_DATA
    ] = Field(default=None, min_length=1)
    """The camera of the calibration that took the images: its section, its `name` or its `port`;
    not needed where there is one only."""
    ridge: float = Field(default=PerspectiveOptions.ridge, gt=0)
    """perspective: weight of the squared distance of the coefficients to those of the mean
    shape."""
    softness: float = Field(default=PerspectiveOptions.softness, gt=0)
    """perspective: residual, for normalised landmarks, beyond which the pull of a landmark
    decreases (Cauchy's loss)."""

    @property
    def matrices(self) -> str | None:
        """The dataset that holds the intrinsics of the images, if any does."""
        return self.intrinsics if self.calibration is None else CAMERA_MATRIX

    @field_validator("principal_point", "ridge", "softness")
    @classmethod
    def _belongs_to_perspective(cls, value: object, info: ValidationInfo) -> object:
        key = str(info.field_name)
        default = cls.model_fields[key].default
        if value != default and info.data.get("model", value) != "perspective":
            raise ValueError(f"`{key}` belongs to `model: perspective`; leave it out")
        return value

    @model_validator(mode="after")
    def _knows_the_focal_length(self) -> Self:
        if self.focal is not None and self.intrinsics is not None:
            raise ValueError("`focal` and `intrinsics` exclude each other; give one of them")
        known = self.focal is not None or self.intrinsics is not None
        if self.calibration is not None:
            if known:
                key = "focal" if self.focal is not None else "intrinsics"
                raise ValueError(f"`calibration` and `{key}` exclude each other; give one of them")
            return self
        if self.name is not None:
            raise ValueError("`name` is that of a camera in a `calibration`; give both or neither")
        if (self.model == "perspective") != known:
            raise ValueError(
                "`model: perspective` and a focal length (`focal` or `intrinsics`) go together; "
                "give both or neither"
            )
        return self
