"""The config of `fit`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

from shapefit.config.commands.input import LandmarksConfig
from shapefit.config.model import (
    HIDDEN,
    MAX_THREADS,
    Auto,
    ConfigModel,
    FromLists,
    Height,
    section,
)
from shapefit.config.paths import (
    UNNAMED,
    Description,
    DictionaryPath,
    Folder,
    InputPaths,
    OptionalInputPath,
    OutputOrFolder,
    ResultFolder,
    find_dictionaries,
)
from shapefit.geometry.pinhole import CAMERA_MATRIX
from shapefit.lifting.methods import (
    AUTO,
    METHODS,
    ROBUST,
    PosteriorOptions,
    find_conflict,
    summarise,
)

if TYPE_CHECKING:
    MethodName = str
else:
    MethodName = Literal[(AUTO, *METHODS)]

Positive = Annotated[float, Field(gt=0)]


def _text(value: Any) -> Any:
    """Return a port, which YAML reads as a number, as text."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


class CameraConfig(ConfigModel):
    """The camera of the images; the section is printed with every fit."""

    focal: Annotated[
        Positive | Literal["auto", "none", "files"],
        Description("a number > 0, auto, none or files"),
    ] = "auto"
    """Focal length of all images in pixels; files: that of the `camera_matrix` of the landmarks;
    none: weak perspective; auto: methods with a prior take the calibration, else the camera matrix
    of the files, else 1.1 times the longer side of the image where its size is known, else weak
    perspective, as other methods do."""
    principal_point: Annotated[
        tuple[float, float] | None, Description("two numbers, x and y"), FromLists
    ] = None
    """Where the optical axis meets the image, in pixels; by default as the camera matrix states it,
    else the centre of the image."""
    calibration: OptionalInputPath = None
    """File with calibrated cameras (TOML of anipose, Pose2Sim, caliscope or FreeMoCap, or OpenCV's
    YAML or JSON): focal length, principal point, lens distortion and place."""
    name: Annotated[str | None, Description("the name of a camera"), BeforeValidator(_text)] = (
        Field(default=None, min_length=1)
    )
    """The camera of the calibration that took the images: its section, name or port; not needed if
    the calibration has one camera."""

    @property
    def model(self) -> str:
        """The model of the projection: auto, weak-perspective or perspective."""
        if self.focal == "auto":
            return "auto"
        return "weak-perspective" if self.focal == "none" else "perspective"

    @property
    def matrices(self) -> str | None:
        """The dataset that holds the intrinsics of the images, if one does."""
        return CAMERA_MATRIX if self.focal == "files" else None

    @model_validator(mode="after")
    def _agree(self) -> Self:
        if self.calibration is not None and isinstance(self.focal, float | int):
            raise ValueError("`focal` and `calibration` both give the focal length; leave one out")
        if self.calibration is None and self.name is not None:
            raise ValueError("`name` is that of a camera in a `calibration`; give both")
        if self.focal in ("auto", "none") and self.principal_point is not None:
            raise ValueError("`principal_point` needs a focal length; give `focal`, too")
        return self


class PriorConfig(ConfigModel):
    """How the methods posterior and sequences weigh landmarks against the prior."""

    scale: Auto[Positive] = None
    """Factor on the covariances of the prior; auto: 1, 2, 4 or 8, whichever makes the first images
    most likely."""
    residual_variance: Auto[Positive] = Field(
        default=None,
        description="Variance of a landmark's coordinate that neither prior nor camera explains, "
        "in the unit of normalised shapes; `noise` adds to it. auto: that of the dictionary, or "
        f"{PosteriorOptions.residual_variance}, times 1, 2, 4 or 8, whichever makes the first "
        "images most likely.",
    )
    calibration: OptionalInputPath = None
    """error_bars.json of a report of eval, whose factors scale the error bars."""
    bar_scale: Annotated[float, Field(gt=0), HIDDEN] = PosteriorOptions.widening
    """Factor on all covariances, for bodies and motions that the prior lacks."""


class SaveConfig(ConfigModel):
    """What an HDF5 result holds besides the shapes."""

    proof: Auto[bool] = None
    """The certificate of the convex program, for `shapefit verify`; auto: for methods without a
    prior."""
    covariance: bool = False
    """The covariance of all landmarks of an image, `shape_covariance` (n, 3p, 3p) (large)."""


class ExportConfig(ConfigModel):
    """Mesh files of the fitted shapes, one per image."""

    folder: Folder = None
    """Folder to write mesh files to; none writes none."""
    format: Literal["obj", "ply", "glb"] = "ply"
    """Format of the files."""


class FitConfig(LandmarksConfig):
    """Lift 2D landmarks to 3D shapes with a dictionary."""

    COMMAND = "fit"
    OUTPUT = ".h5"

    landmarks: InputPaths
    """Files of 2D landmarks (- is stdin, CSV), or folders with one file per frame."""
    dictionary: DictionaryPath = Field(default_factory=lambda: find_dictionaries()["people"])
    """Dictionary file that learn-dict wrote, or the name of an installed one."""
    output: OutputOrFolder = UNNAMED
    """Result file: HDF5, CSV (.csv, or - for stdout), TRC, C3D or BVH by its ending
    (docs/export.md); FOLDER/ for one file per part; by default NAME.h5 in the working directory,
    after the first input."""
    method: MethodName = Field(
        default=AUTO,
        description=f"How to lift: {summarise()}. auto: with a prior sequences for videos and "
        "posterior for single images, otherwise convex.",
    )
    frame_rate: Positive | None = None
    """Frames per second; by default, as stated in the files. Without either, the motion between
    images is assumed to be that between the training shapes."""
    height: Height = None
    """Height of the body or object in metres, for outputs in metres (TRC, C3D, BVH); by default
    that of the training shapes."""
    camera: CameraConfig = section(CameraConfig)
    lam: Annotated[Positive | Literal["auto"], Description("a number > 0 or auto")] = Field(
        default=0.1, alias="lambda"
    )
    """Weight of the sum of spectral norms, for normalised landmarks and atoms; auto derives it from
    `noise`."""
    noise: float | None = Field(default=None, ge=0)
    """Standard deviation of a landmark's coordinate, in pixels; 0 for projected motion capture.
    `lambda: auto` needs it; with a prior it adds to `prior.residual_variance`."""
    outliers: Literal["none", "ransac", "sparse-error", "l1"] = "none"
    """How methods without a prior treat wrong landmarks: ransac rejects them before the fit;
    sparse-error and l1 are robust losses of the convex program."""
    outlier_threshold: Annotated[float | None, Field(gt=0), HIDDEN] = None
    """Residual beyond which a landmark is an outlier: 0.25 for ransac, 0.1 for sparse-error."""
    tolerance: Auto[Positive] = None
    """Relative duality gap at which an image is solved; auto: 1e-6, 1e-3 for methods with a prior,
    and 0.01 for global."""
    prior: PriorConfig = section(PriorConfig)
    bone_lengths: OptionalInputPath = None
    """Known lengths of the bones, for sequences: shapes of the body, whose mean lengths are taken,
    or CSV with the header `from,to,length`, in any unit; by default estimated."""
    skeleton: Auto[dict[str, float]] = None
    """How the skeleton of a detector of people differs from that of the dictionary, as {head: 1.5,
    hips: 1.15, shoulders: 1}: factors on the height of the head above the shoulders and on the
    distances of hips and shoulders; auto: estimated from the first images."""
    leave_one_out: str | None = Field(default=None, min_length=1)
    """Dataset of the landmarks that names, for each image, the training shape whose atoms its fit
    must not use (dictionaries of exemplars); `item` if images are named after training shapes."""
    markers: Literal["joints", "input"] = "joints"
    """Markers of a TRC file: joints, or input for the landmarks of the detector by their names."""
    save: SaveConfig = section(SaveConfig)
    export: ExportConfig = section(ExportConfig)
    fail_untrusted: float | None = Field(default=None, ge=0, le=1)
    """Exit with 1 if more than this share of images is not to be trusted."""
    threads: int = Field(default=0, ge=0, le=MAX_THREADS)
    """Threads to solve with; 0 is one per core."""
    partition: Annotated[int, Field(ge=1), HIDDEN] = 100_000
    """Images per part of a folder."""
    scheduler: Annotated[str | None, HIDDEN] = None
    """Address of a running Dask scheduler."""
    scheduler_file: Annotated[OptionalInputPath, HIDDEN] = None
    """File in which a Dask scheduler left its address."""
    workers: Annotated[int | None, Field(ge=1, le=MAX_THREADS), HIDDEN] = None
    """Processes of this machine that do the parts."""
    dry_run: Annotated[bool, HIDDEN] = False
    """Only list the parts."""
    replace: Annotated[bool, HIDDEN] = False
    """Replace other results in the folder."""
    signed: Annotated[bool, HIDDEN] = False
    """Coefficients of either sign, for methods that alternate between shape and rotation."""

    @property
    def loss(self) -> str:
        """The data term of the convex program."""
        return self.outliers if self.outliers in ROBUST else "squared"

    @property
    def searches_outliers(self) -> bool:
        """Whether outliers are rejected before the fit."""
        return self.outliers not in ("none", *ROBUST)

    @property
    def solver_tolerance(self) -> float:
        """The tolerance given, or that of the method."""
        return METHODS[self.method].tolerance if self.tolerance is None else self.tolerance

    @property
    def saves_proof(self) -> bool:
        """Whether the certificate is stored."""
        if self.save.proof is not None:
            return self.save.proof
        return not METHODS[self.method].has_prior

    @field_validator("skeleton")
    @classmethod
    def _has_known_parts(cls, skeleton: dict[str, float] | None) -> dict[str, float] | None:
        unknown = sorted(set(skeleton or {}) - {"head", "hips", "shoulders"})
        if unknown or not all(factor > 0 for factor in (skeleton or {}).values()):
            raise ValueError("expected factors > 0 of head, hips and shoulders")
        return skeleton

    @model_validator(mode="after")
    def _belong_together(self) -> Self:
        if self.lam == "auto" and self.noise is None:
            raise ValueError("`lambda: auto` needs `noise`; give the noise of a landmark")
        named = (self.scheduler, self.scheduler_file, self.workers)
        if sum(each is not None for each in named) > 1:
            raise ValueError("`scheduler`, `scheduler_file` and `workers` exclude each other")
        if (any(named) or self.dry_run) and not isinstance(self.output, ResultFolder):
            raise ValueError("parts need a folder; end the name of the `output` with /")
        if (conflict := find_conflict(self)) is not None:
            raise ValueError(conflict)
        return self
