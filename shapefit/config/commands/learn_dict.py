"""The config of `learn-dict`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from shapefit.config.commands.input import InputConfig
from shapefit.config.model import (
    MOST_STEPS,
    CommandConfig,
    ConfigModel,
    FromLists,
    section,
)
from shapefit.config.paths import (
    OF_THE_DATA,
    Expected,
    InputPaths,
    OutputPath,
)

_ALIGN = "`all`, `none`, or a list of at least three different landmark names"


def _landmark_choice(value: Any) -> Any:
    if value in ("all", "none"):
        return value
    if not isinstance(value, list | tuple) or not all(isinstance(name, str) for name in value):
        raise ValueError(f"expected {_ALIGN}, found {value!r}")
    if len(value) < 3 or len(set(value)) < len(value):
        raise ValueError(f"expected {_ALIGN}, found {list(value)}")
    return tuple(value)


AtLeastOne = Annotated[int, Field(ge=1)]
Share = Annotated[float, Field(gt=0, lt=1)]


class PriorConfig(ConfigModel):
    """The prior over shapes that `method: posterior` of `fit` needs."""

    components: Annotated[
        Annotated[int, Field(ge=0, le=1000)] | Literal["auto"],
        Expected("a whole number from 0 to 1000, or auto"),
    ] = 0
    """Gaussians in the mixture; 0 learns none, auto one for every 150 shapes, from 1 to 32."""
    shrinkage: float = Field(default=0.3, ge=0, lt=1)
    """Share of the covariance of all shapes in that of a component of average size."""
    floor: float = Field(default=0.01, gt=0)
    """Variance of every coordinate beyond that of the shapes, which are normalised."""
    stretch: float = Field(default=0.0, ge=0, le=1)
    """Standard deviation of the logarithm of the lengths of bones (the edges of the shapes, a
    tree): other bodies. Shapes that are varied count twice, or more often if they are few."""
    exchange: float = Field(default=0.0, ge=0, le=1)
    """Share of the shapes whose limbs, the chains of bones that end freely, come from other shapes:
    other poses."""
    weights: str | None = Field(default=None, min_length=1)
    """Dataset of the shapes that holds the weight of each."""


class LearnDictConfig(CommandConfig):
    """Learn a dictionary of rotatable basis shapes from 3D shapes."""

    COMMAND = "learn-dict"

    shapes: InputPaths
    """Files of 3D training shapes."""
    input: InputConfig = section(InputConfig)
    output: OutputPath
    """Dictionary file to write (HDF5)."""
    method: Literal["sparse-coding", "exemplars", "pca-bases"] = "sparse-coding"
    """How to learn: non-negative sparse coding with bounded atoms; exemplars, which makes every
    training shape an atom; or the principal components of each sequence, bases of either sign for
    matching pursuit."""
    every: Annotated[
        AtLeastOne | Annotated[Mapping[str, AtLeastOne], Field(min_length=1)],
        Expected("a whole number >= 1, or a mapping of globs on sequence names to such numbers"),
    ] = 1
    """Keep every n-th shape of each sequence, starting with its first; a mapping such as {13_*: 18,
    "*": 2} keeps so many of the sequences that a glob fits, the first that fits, and all shapes of
    those that none fits."""
    frame_rate: float | None = Field(default=None, gt=0)
    """Frames per second that the shapes should have: files of another rate are refused, and of one
    that does not state its rate there is a warning."""
    align: Annotated[
        Literal["all", "none"] | tuple[str, ...],
        Expected(_ALIGN),
        BeforeValidator(_landmark_choice),
    ] = "all"
    """Landmarks by which training shapes are aligned; none keeps them in their common frame."""
    symmetry: Literal["none", "double"] = "none"
    """Left and right, as paired by the `mirror_index` of the shapes: double adds the mirror images
    as further training shapes, without meshes."""
    mirror: Annotated[
        dict[str, str] | None, Expected("a mapping of landmark names to landmark names")
    ] = None
    """The partner of each landmark on one side, as rhip: lhip, for `symmetry`; landmarks that it
    does not name lie on the plane of symmetry. In place of `mirror_index`."""
    k: int = Field(default=64, ge=1)
    """Number of atoms; at most the number of shapes (sparse-coding only)."""
    beta: float = Field(default=0.1, ge=0)
    """Weight of the sparsity of the coefficients (sparse-coding only)."""
    iterations: int = Field(default=15, ge=1, le=MOST_STEPS)
    """Rounds of coding all shapes and updating all atoms (sparse-coding only)."""
    bases: Annotated[
        Share | AtLeastOne, Expected("a whole number >= 1, or a share > 0 and < 1")
    ] = 0.99
    """Bases of each sequence: their number, or, below 1, the share of the variation within the
    sequence that they explain (pca-bases only)."""

    flip: bool | None = None
    """Shapes learned from 2D landmarks, which alone do not tell near from far: true exchanges them,
    false states that they are right. Without it no shape that the dictionary lifts is trusted,
    unless cameras tell."""
    origin: Annotated[
        Mapping[Literal["source", "licence", "acknowledgement"], str],
        Expected("a mapping of source, licence and acknowledgement to texts"),
        OF_THE_DATA,
    ] = Field(default_factory=dict)
    """Where the shapes come from (`source`), their terms of use (`licence`) and what their users
    are asked to acknowledge (`acknowledgement`): the dictionary states it, and `shapefit info`
    shows it."""
    suits: Annotated[tuple[str, ...], FromLists, OF_THE_DATA] = ()
    """Installed configs that `fit` takes with this dictionary where it is given none: for single
    images and, second, for whole sequences."""
    prior: PriorConfig = section(PriorConfig)
