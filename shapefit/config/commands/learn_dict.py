"""The config of `learn-dict`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from shapefit.config.commands.input import Count, LandmarksConfig
from shapefit.config.model import HIDDEN, ConfigModel, FromLists, section
from shapefit.config.paths import UNNAMED, Description, InputPaths, OutputPath


class PriorConfig(ConfigModel):
    """The prior over shapes that the methods posterior and sequences of `fit` need."""

    components: Annotated[int, Field(ge=0, le=1000)] | Literal["auto"] = 0
    """Gaussians in the mixture; 0 learns none, auto one for every 150 shapes, from 1 to 32."""
    bone_scale: float = Field(default=0.0, ge=0, le=1)
    """Standard deviation of the logarithm of bone lengths, by which training shapes are varied;
    their edges must be a tree."""
    exchange: float = Field(default=0.0, ge=0, le=1)
    """Share of the shapes that take limbs from other shapes."""
    shrinkage: Annotated[float, Field(ge=0, lt=1), HIDDEN] = 0.3
    """Share of the covariance of all shapes in that of a component of average size."""
    floor: Annotated[float, Field(gt=0), HIDDEN] = 0.01
    """Variance of every coordinate beyond that of the shapes, which are normalised."""


class LearnDictConfig(LandmarksConfig):
    """Learn a dictionary of rotatable basis shapes from 3D shapes or from 2D landmarks."""

    OUTPUT = "_dictionary.h5"

    shapes: InputPaths
    """Files of 3D training shapes, or of 2D landmarks."""
    output: OutputPath = UNNAMED
    """Dictionary file to write (HDF5); by default NAME_dictionary.h5 in the working directory."""
    landmarks: Annotated[tuple[str, ...] | None, FromLists] = Field(default=None, min_length=1)
    """Landmarks to keep, in this order, by their names after `rename`; by default, all."""
    method: Literal["sparse-coding", "exemplars", "pca-bases"] = "sparse-coding"
    """Non-negative sparse coding; exemplars: every training shape an atom; or principal components
    of each sequence, for matching pursuit."""
    every: Annotated[
        Count | Annotated[Mapping[str, Count], Field(min_length=1)],
        Description("a whole number >= 1, or a mapping of globs on sequence names to such numbers"),
    ] = 1
    """Keep every n-th shape of each sequence; of {13_*: 18, "*": 2} the first glob that fits."""
    align: Literal["all", "none"] = "all"
    """Turn the training shapes onto their mean, or leave them in their common frame."""
    mirror: Annotated[
        dict[str, str] | bool, Description("true, false, or a mapping of landmark names")
    ] = False
    """Learn from mirror images, too: the partner of each landmark of one side, such as rhip: lhip,
    or true for the pairs that the shapes state."""
    k: Count = 64
    """Number of atoms of sparse-coding."""
    flip: bool | None = None
    """Of shapes learned from 2D landmarks: true exchanges near and far, false confirms them. No
    shape is trusted without, unless cameras decide."""
    prior: PriorConfig = section(PriorConfig)
    beta: Annotated[float, Field(ge=0), HIDDEN] = 0.1
    """Weight of the sparsity of the coefficients."""
    iterations: Annotated[Count, HIDDEN] = 15
    """Rounds of coding all shapes and updating all atoms."""
    bases: Annotated[Annotated[float, Field(gt=0, lt=1)] | Count, HIDDEN] = 0.99
    """Bases of each sequence (pca-bases): their number, or the share of variance they explain."""
