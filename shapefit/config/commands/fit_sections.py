"""The sections of `fit`: camera, outliers, posterior, sequences, and the files to look at."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator, model_validator

from shapefit.config.model import ConfigModel, FromLists
from shapefit.config.paths import OF_THE_DATA, Expected, Folder, OptionalInputPath
from shapefit.geometry.pinhole import CAMERA_MATRIX
from shapefit.lifting.methods import PosteriorOptions


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

    @property
    def matrices(self) -> str | None:
        """The dataset that holds the intrinsics of the images, if any does."""
        return self.intrinsics if self.calibration is None else CAMERA_MATRIX

    @field_validator("principal_point")
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


class OutliersConfig(ConfigModel):
    """How wrong landmarks are found: by a search before the fit, or by a robust loss."""

    method: Literal["none", "ransac", "sparse-error", "l1"] = "none"
    """none; ransac poses the mean shape on random triples of landmarks, keeps the pose with which
    most others agree, and the fit rejects the others; sparse-error and l1 are robust
    losses of the program: the squared residual plus sparse errors with weight `threshold`, and the
    sum of absolute residuals."""
    threshold: float | None = Field(default=None, gt=0)
    """Residual beyond which a landmark is wrong. Of a search, in units of the size of the shape as
    given by the other landmarks (the mean standard deviation of its coordinates), 0.25 if not
    given; of a robust loss, for normalised landmarks, 0.1 if not given."""


class PosteriorConfig(ConfigModel):
    """How `method: posterior` weighs landmarks against the prior over shapes."""

    prior_scale: float | None = Field(default=None, gt=0)
    """Factor on the covariances of the prior: poses that its training shapes lack. By default 1, 2,
    4 or 8, as the first images say by their evidence."""
    residual_variance: float | None = Field(
        default=None,
        gt=0,
        description="Variance of a landmark's coordinate that prior and camera do not explain, in "
        "the unit of normalised shapes, at confidence 1; by default that of the dictionary, or "
        f"{PosteriorOptions.residual_variance} where it has none, or 2, 4 or 8 times that, as the "
        "first images say by their evidence. It is added to the variance of `noise`.",
    )
    least_score: float | None = Field(default=PosteriorOptions.least_score, ge=0)
    """Hide landmarks whose confidence is below this, and take all others for equally precise: the
    score of a detector is a chance, not a precision. Landmarks with `landmark_covariance` keep
    theirs. With null the variances are divided by the square of the confidence."""
    outlier_rate: float = Field(default=PosteriorOptions.outlier_rate, ge=0, lt=1)
    """Probability that a landmark is grossly wrong, anywhere; 0 trusts all."""
    widening: float = Field(default=PosteriorOptions.widening, gt=0)
    """Factor applied to all covariances, to allow for what the prior has not seen."""
    calibration: OptionalInputPath = None
    """error_bars.json of a report of eval: error bars get so many times as wide that 90% of that
    truth would have been in their 90% ellipsoids."""
    covariance: bool = PosteriorOptions.covariance
    """Also write the covariance of all landmarks together, `shape_covariance` (n, 3p, 3p) (large;
    HDF5)."""
    implausible: float = Field(default=0.05, ge=0, lt=1)
    """Images with a plausibility below this are not to be trusted."""


class SequencesConfig(ConfigModel):
    """How `method: sequences` ties the images of a sequence together."""

    frame_rate: float | None = Field(default=None, gt=0)
    """Images per second; by default, `frame_rate` of the landmark files. Without either, the motion
    between images is assumed to be that between the training shapes."""
    lengths: OptionalInputPath = None
    """Known lengths of the bones: shapes of the body, of which the mean lengths are taken, or a CSV
    file with the header `from,to,length`, in any unit. By default, they are estimated in each
    sequence."""


class ExportConfig(ConfigModel):
    """Mesh files of the fitted shapes, one per image."""

    folder: Folder = None
    """Folder to write mesh files to; none writes none."""
    format: Literal["obj", "ply", "glb"] = "ply"
    """Format of the files."""
