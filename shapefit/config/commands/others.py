"""The configs of `learn-dict`, `project`, `eval`, `convert`, `info` and `view`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field

from shapefit.config.commands.input import (
    Count,
    LandmarksConfig,
    MetresConfig,
    NotNegative,
    Positive,
    Text,
    TruthConfig,
)
from shapefit.config.model import (
    FROM_LIST,
    CommandConfig,
    ConfigModel,
    ListOf,
    section,
)
from shapefit.config.paths import (
    UNNAMED_OUTPUT,
    Description,
    InputPaths,
    NamedFiles,
    OptionalDictionaryPath,
    OptionalPath,
    OutputPath,
)
from shapefit.evaluation.metrics import METRICS, SHARE

if TYPE_CHECKING:
    AnyMetric = str
else:
    AnyMetric = Literal[tuple(METRICS)]


class PriorConfig(ConfigModel):
    """The prior over shapes that the methods posterior and sequences of `fit` need."""

    components: Annotated[int, Field(ge=0, le=1000)] | Literal["auto"] = 0
    """Gaussians in the mixture; 0 learns none, auto one for every 150 shapes, from 1 to
    32.
    """
    bone_scale: float = Field(default=0.0, ge=0, le=1)
    """Standard deviation of log bone lengths of varied shapes, whose edges must be a
    tree.
    """
    exchange: float = Field(default=0.0, ge=0, le=1)
    """Share of the shapes that take limbs from other shapes."""
    shrinkage: Annotated[float, Field(ge=0, lt=1)] = 0.3
    """Share of the covariance of all shapes in that of a component of average size."""
    floor: Annotated[float, Field(gt=0)] = 0.01
    """Variance of every coordinate beyond that of the shapes, which are normalised."""


class LearnDictConfig(LandmarksConfig):
    """Learn a dictionary of rotatable basis shapes from 3D shapes or from 2D
    landmarks.
    """

    OUTPUT = "_dictionary.h5"

    shapes: InputPaths
    """Files of 3D training shapes, or of 2D landmarks."""
    output: OutputPath = UNNAMED_OUTPUT
    """Dictionary file to write (HDF5); by default NAME_dictionary.h5 in the working
    directory.
    """
    landmarks: ListOf[str] | None = Field(default=None, min_length=1)
    """Landmarks to keep, in this order, by their names after `rename`; by default, all.
    """
    method: Literal["sparse-coding", "exemplars", "pca-bases"] = "sparse-coding"
    """exemplars: every training shape is an atom; pca-bases: for matching pursuit."""
    every: Count | Annotated[Mapping[str, Count], Field(min_length=1)] = 1
    """Keep every n-th shape of each sequence; of {13_*: 18, "*": 2} the first glob that
    fits.
    """
    align: Literal["all", "none"] = "all"
    """Turn the training shapes onto their mean, or leave them in their common frame."""
    mirror: bool | dict[str, str] = False
    """Add mirror images: partners such as rhip: lhip, or true for those that the shapes
    state.
    """
    k: Count = 64
    """Number of atoms of sparse-coding."""
    flip: bool | None = None
    """Of shapes learned from 2D landmarks: true exchanges near and far, false confirms
    them. No shape is trusted without, unless cameras decide.
    """
    prior: PriorConfig = section(PriorConfig)
    beta: Annotated[float, Field(ge=0)] = 0.1
    """Weight of the sparsity of the coefficients."""
    iterations: Count = 15
    """Rounds of coding all shapes and updating all atoms."""


RotationRow = Annotated[tuple[float, float, float], FROM_LIST]
Rotation = Annotated[tuple[RotationRow, RotationRow, RotationRow], FROM_LIST]


def _check_view(view: str | Rotation) -> str | Rotation:
    """Return the view; raise ValueError for a matrix that is no rotation."""
    if not isinstance(view, str):
        R = np.array(view)
        if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0:
            raise ValueError("expected a rotation (orthonormal rows, determinant +1)")
    return view


class CameraConfig(ConfigModel):
    """The camera that sees the shapes."""

    view: Annotated[
        Literal["turntable", "random"] | Rotation,
        Description("turntable, random, or a rotation as three rows of three numbers"),
        AfterValidator(_check_view),
    ] = "turntable"
    """One turn per sequence about y, a random rotation per image, or one from object to
    camera.
    """
    scale: Positive | None = None
    """Pixels per unit of the shape; without it landmarks have the unit of the shapes.
    """


class ProjectConfig(CommandConfig):
    """Project 3D shapes to synthetic 2D landmarks."""

    OUTPUT = "_landmarks.h5"

    shapes: InputPaths
    """Files of 3D shapes (- is stdin, CSV)."""
    output: OutputPath = UNNAMED_OUTPUT
    """Landmark file to write, HDF5 or CSV; by default NAME_landmarks.h5 in the working
    folder.
    """
    camera: CameraConfig = section(CameraConfig)
    y_axis: Literal["down", "up"] = "down"
    """Direction of y in the landmarks."""
    noise: NotNegative = 0.0
    """Standard deviation of Gaussian noise on each coordinate, in the unit of the
    landmarks.
    """
    hidden: float = Field(default=0.0, ge=0, lt=1)
    """Share of landmarks hidden, different ones in each image; at least three remain
    visible.
    """
    seed: int = Field(default=0, ge=0)
    """Seed of every random choice."""


class EvalConfig(TruthConfig):
    """Compare results with the truth."""

    OUTPUT = "_report"

    results: NamedFiles
    """Result files to compare, each with its name; in a list files name themselves."""
    truth: InputPaths
    """Files of the true 3D shapes."""
    output: OutputPath = UNNAMED_OUTPUT
    """Folder to write the report to; by default NAME_report in the working directory.
    """
    groups: Mapping[str, str] = Field(default_factory=dict)
    """Groups of sequences to average over: name -> glob on sequence names."""
    metrics: ListOf[AnyMetric] = Field(
        default=tuple(name for name, metric in METRICS.items() if metric.unit != SHARE),
        min_length=1,
    )
    """Errors to measure; those of the outlier labels only where they are named."""
    least_visible: Annotated[int, Field(ge=0)] = 0
    """Minimum number of visible landmarks of an image; others are counted in a warning.
    """
    truth_frame: Literal["object", "camera"] = "object"
    """Frame of the true shapes; `object` is turned by the result's `true_rotation`."""
    plots: Literal["svg", "png", "pdf", "none"] = "svg"
    """Format of the figures beside the page, which has them too; none leaves them out.
    They need matplotlib.
    """


class ConvertConfig(MetresConfig):
    """Write what files hold in another format."""

    files: InputPaths
    """Files of landmarks, shapes or results, of one kind, or folders with one file per
    frame.
    """
    output: OutputPath
    """File to write, or the folder of meshes; - is stdout (CSV)."""
    dictionary: OptionalDictionaryPath = None
    """Dictionary that a result was fitted with: its meshes or edges are written."""
    to: Text = "auto"
    """Format to write (docs/export.md), by default that of the output's ending, or
    HDF5. obj, ply and glb write a mesh of each image of a result into the folder
    `output`.
    """
    every: Count = 1
    """Take every n-th item of each sequence, the first one first."""
    unit: Text | None = None
    """Unit of shapes whose files do not state it (m, cm, mm, ...), for outputs in
    metres.
    """
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    """Axis of the shapes, or of the world of the camera, that points up and becomes y
    in metres; by default that of the shapes, or the nearest to up in the image.
    """


class InfoConfig(CommandConfig):
    """Describe files and print the next command."""

    files: InputPaths = ()
    """Files of any kind, or names of dictionaries; without any, what is installed is
    listed.
    """
    format: Text = "auto"
    """Format of the files (docs/formats.md); auto recognises it by their content."""
    keypoints: Text | None = None
    """Skeleton that names the landmarks of files without names, such as body_25b."""


class ViewConfig(TruthConfig):
    """Write one HTML page that shows results, to rotate and play."""

    files: NamedFiles
    """Results, shapes or landmarks to show, each with its name; in a list files name
    themselves.
    """
    truth: InputPaths = ()
    """Files of the true 3D shapes, aligned with the first result by the best
    similarity.
    """
    keypoints: Text | None = None
    """Skeleton that names the landmarks of files without names, such as body_25b."""
    dictionary: OptionalDictionaryPath = None
    """Dictionary with the edges and meshes to draw."""
    images: OptionalPath = None
    """What lies under the landmarks: a folder of PNG or JPEG images, named after the
    items or frames, or on a page a film (MP4, WebM) of up to 14 MB.
    """
    items: ListOf[str] = ("*",)
    """Items to show: names or globs."""
    frame_rate: Positive | None = None
    """Frames per second; by default, as stated in the files."""
    output: OptionalPath = None
    """HTML file to write, or PNG or SVG for a sheet of pictures; by default NAME.html.
    """
