"""The config of `fit`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from shapefit.config.commands.input import (
    Count,
    MetresConfig,
    NotNegative,
    Positive,
    Text,
)
from shapefit.config.model import Auto, ConfigModel, Pair, section
from shapefit.config.paths import (
    UNNAMED_OUTPUT,
    Description,
    DictionaryPath,
    InputPaths,
    OptionalInputPath,
    OptionalPath,
    OutputOrFolder,
    find_dictionaries,
)
from shapefit.errors import listed
from shapefit.lifting.methods import (
    AUTO,
    METHODS,
    ROBUST,
    STARTS,
    Method,
    summarise,
)
from shapefit.timeline import parse_frame_range

if TYPE_CHECKING:
    MethodName = str
    BodyMeasure = str
else:
    MethodName = Literal[(AUTO, *METHODS)]
    BodyMeasure = Literal["head", "hips", "shoulders"]


def check_frames(text: str | None) -> str | None:
    """Return a text that is a range of frames or None; else raise ValueError."""
    parse_frame_range(text)
    return text


class CameraConfig(ConfigModel):
    """The camera of the images; the section is printed with every fit."""

    focal: Positive | Literal["auto", "none", "files"] = "auto"
    """Focal length in pixels; files: of their `camera_matrix`; none: weak perspective;
    auto: with a prior of the calibration, the files, or 1.1 times the longer side of
    the image, else none.
    """
    focal_sd: Annotated[float, Field(ge=0)] = 0.0
    """Standard deviation of the logarithm of `focal`, by which error bars with a prior
    grow; 0.2 where the focal length is assumed.
    """
    principal_point: Pair[float] | None = None
    """Pixel on the optical axis; by default of the camera matrix, or the centre."""
    calibration: OptionalInputPath = None
    """File of cameras: TOML of anipose, Pose2Sim, caliscope or FreeMoCap, or OpenCV's.
    """
    name: Text | None = None
    """The camera of the calibration, by section, name or port; not needed if there is
    one.
    """

    @model_validator(mode="after")
    def _check_keys(self) -> Self:
        """Raise ValueError for keys that exclude or need each other."""
        if self.calibration is not None and isinstance(self.focal, float | int):
            raise ValueError(
                "`focal` and `calibration` both give the focal length; leave one out"
            )
        if self.calibration is None and self.name is not None:
            raise ValueError("`name` names a camera of a `calibration`; give both")
        if self.focal in ("auto", "none") and self.principal_point is not None:
            raise ValueError(
                "`principal_point` needs a focal length; give `focal`, too"
            )
        return self


class PriorConfig(ConfigModel):
    """How the methods posterior and sequences weigh landmarks against the prior."""

    scale: Auto[Positive] = None
    """Factor on the covariances of the prior; auto: the likeliest of 1, 2, 4 and 8."""
    residual_variance: Auto[Positive] = None
    """Variance of a normalised coordinate that neither prior nor camera explains;
    `noise` adds to it. auto: the dictionary's value, times the likeliest of 1, 2, 4 and
    8.
    """
    calibration: OptionalInputPath = None
    """error_bars.json of a report of eval, whose factors scale the error bars."""
    bar_scale: Positive = 1.0
    """Factor on all covariances of error bars, for bodies and motions that the prior
    lacks.
    """


class SaveConfig(ConfigModel):
    """What an HDF5 result holds besides the shapes."""

    proof: Auto[bool] = None
    """The certificate for `shapefit verify`; auto: for methods without a prior."""
    covariance: bool = False
    """The covariance of all landmarks of an image, `shape_covariance` (n, 3p, 3p)
    (large).
    """


class ExportConfig(ConfigModel):
    """Mesh files of the fitted shapes, one per image."""

    folder: OptionalPath = None
    """Folder to write mesh files to; none writes none."""
    format: Literal["obj", "ply", "glb"] = "ply"
    """Format of the files."""


class FitConfig(MetresConfig):
    """Lift 2D landmarks to 3D shapes with a dictionary."""

    OUTPUT = ".h5"

    landmarks: InputPaths
    """Files of 2D landmarks (- is stdin, CSV), or folders with one file per frame."""
    dictionary: DictionaryPath = Field(
        default_factory=lambda: find_dictionaries()["people"]
    )
    """Dictionary file that learn-dict wrote, or the name of an installed one."""
    output: OutputOrFolder = UNNAMED_OUTPUT
    """Result file, by its ending (docs/export.md); - is stdout, FOLDER/ one file per
    part.
    """
    frames: Annotated[
        Text | None,
        Description("a range of frames, such as 100:400"),
        AfterValidator(check_frames),
    ] = None
    """Lift only these frames, the first up to before the last; 100: and :400 are open.
    """
    every: Count = 1
    """Lift every n-th frame of these, the first one first; frames keep their times."""
    method: MethodName = Field(
        default=AUTO,
        description=(
            f"How to lift: {summarise()}. auto: with a prior sequences for videos and "
            "posterior for single images, otherwise convex."
        ),
    )
    camera: CameraConfig = section(CameraConfig)
    lam: Positive | Literal["auto"] = Field(default=0.1, alias="lambda")
    """Weight of the sum of spectral norms; auto derives it from `noise`."""
    noise: NotNegative | None = None
    """Standard deviation of a landmark's coordinate in pixels."""
    outliers: Literal["none", "ransac", "sparse-error", "l1"] = "none"
    """Wrong landmarks, without a prior: rejected before the fit (ransac), or a robust
    loss.
    """
    outlier_threshold: Positive | None = None
    """Residual beyond which a landmark is an outlier: 0.25 for ransac, 0.1 for
    sparse-error.
    """
    tolerance: Auto[Positive] = None
    """Relative duality gap of a solved image; auto: 1e-6, with a prior 1e-3, of global
    0.01.
    """
    prior: PriorConfig = section(PriorConfig)
    skeleton: Annotated[
        Auto[dict[BodyMeasure, Positive]],
        Description("a mapping of head, hips and shoulders to factors > 0, or auto"),
    ] = None
    """A detector's height of the head and distances of hips and shoulders, times the
    dictionary's; auto: estimated from the first images.
    """
    leave_one_out: Text | None = None
    """Dataset with the training shape that the fit of an image must not use, or `item`.
    """
    starts: Annotated[int, Field(ge=1, le=1000)] = STARTS
    """Views from which alternate and mean-shape seek the pose of the mean shape; 1 is
    the paper's, the identity view turned in the plane.
    """
    save: SaveConfig = section(SaveConfig)
    export: ExportConfig = section(ExportConfig)
    threads: Annotated[int, Field(ge=0, le=1024)] = 0
    """Threads to solve with; 0 is one per core."""
    signed: bool = False
    """Coefficients of either sign, for methods that alternate between shape and
    rotation.
    """

    @model_validator(mode="after")
    def _check_keys(self) -> Self:
        """Raise ValueError for keys that need another one, or that the method lacks."""
        if self.lam == "auto" and self.noise is None:
            raise ValueError(
                "`lambda: auto` needs `noise`; give the noise of a landmark"
            )
        conflict = find_conflict(self)
        if conflict is not None:
            raise ValueError(conflict)
        return self


def find_conflict(fit: FitConfig) -> str | None:
    """Say which key of a config its method cannot use, and how to fix it, else None."""
    if fit.method == AUTO:
        return None
    for fault, fix in list_conflicts(fit, METHODS[fit.method]):
        return f"the method {fit.method} {fault}; {fix}"
    return None


def list_conflicts(fit: FitConfig, method: Method) -> Iterator[tuple[str, str]]:
    """Yield fault and fix of each key of a config that a method cannot use."""
    given = fit.model_fields_set
    if fit.outliers in ROBUST and fit.outliers not in method.losses:
        yield f"does not support `outliers: {fit.outliers}`", "use `method: convex`"
    if fit.leave_one_out and method.needs_prior:
        yield (
            "has a prior that was learned from all shapes; `leave_one_out` needs"
            " another",
            "use another method, or a dictionary learned without the shapes",
        )
    if fit.camera.focal not in ("auto", "none") and method.perspective == "none":
        yield "has no perspective camera", "leave out `camera.focal`"
    keys = keys_of_priors(fit)
    if keys and not method.needs_prior:
        priors = name_methods(lambda row: row.needs_prior)
        yield (
            f"has no prior; `{keys[0]}` needs one",
            f"use {priors}, or leave it out",
        )
    if "starts" in given and not method.has_starts:
        starts = name_methods(lambda row: row.has_starts)
        yield "does not support `starts`", f"use {starts}, or leave it out"


def keys_of_priors(fit: FitConfig) -> list[str]:
    """Return the keys that a config sets and only methods with a prior have."""
    keys = [f"prior.{key}" for key in sorted(fit.prior.model_fields_set)]
    if "skeleton" in fit.model_fields_set and fit.skeleton is not None:
        keys.append("skeleton")
    if fit.save.covariance:
        keys.append("save.covariance")
    return keys


def name_methods(suits: Callable[[Method], bool]) -> str:
    """List in words the methods for which `suits` is true, for a message."""
    return listed(f"`method: {name}`" for name, row in METHODS.items() if suits(row))
