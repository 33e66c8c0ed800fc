"""The config of `learn-dict`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationInfo, field_validator

from shapefit.config.commands.learn_dict_prior import PriorConfig
from shapefit.config.expectation import Expected
from shapefit.config.model import MOST_STEPS, CommandConfig, Renaming
from shapefit.config.paths import InputPaths, OutputPath

_ALIGN = "`all`, `none`, or a list of at least three different landmark names"


def _landmark_choice(value: Any) -> Any:
    if value in ("all", "none"):
        return value
    if not isinstance(value, list | tuple) or not all(isinstance(name, str) for name in value):
        raise ValueError(f"expected {_ALIGN}, found {value!r}")
    if len(value) < 3 or len(set(value)) < len(value):
        raise ValueError(f"expected {_ALIGN}, found {list(value)}")
    return tuple(value)


class LearnDictConfig(CommandConfig):
    """Learn a dictionary of rotatable basis shapes from 3D shapes."""

    shapes: InputPaths = Field(description="Files of 3D training shapes (HDF5 or CSV).")
    rename: Renaming = Field(
        default_factory=dict,
        description="Landmarks that the dictionary shall call otherwise: name in the files -> name "
        "in the dictionary.",
    )
    output: OutputPath = Field(description="Dictionary file to write (HDF5).")
    method: Literal["sparse-coding", "exemplars", "pca-bases"] = Field(
        default="sparse-coding",
        description="How to learn: non-negative sparse coding with bounded atoms; exemplars, every "
        "training shape an atom; or the principal components of each sequence, bases of either "
        "sign for matching pursuit.",
    )
    every: int = Field(
        default=1,
        ge=1,
        description="Keep every n-th shape of each sequence, starting with its first.",
    )
    align: Annotated[
        Literal["all", "none"] | tuple[str, ...],
        Expected(_ALIGN),
        BeforeValidator(_landmark_choice),
    ] = Field(
        default="all",
        description="Landmarks that decide how training shapes are turned onto each other; none "
        "keeps them in their common frame.",
    )
    symmetry: Literal["none", "symmetrise", "double"] = Field(
        default="none",
        description="Left and right, as the `mirror_index` of the shapes pairs them: symmetrise "
        "takes the mean of each training shape and its mirror image; double adds the mirror images "
        "as further training shapes. Either leaves meshes out.",
    )
    mirror: Annotated[
        dict[str, str] | None, Expected("a mapping of landmark names to landmark names")
    ] = Field(
        default=None,
        description="The partner of each landmark on one side, as rhip: lhip, for `symmetry`; "
        "landmarks that it does not name lie on the plane of symmetry. In place of `mirror_index`.",
    )
    k: int = Field(
        default=64,
        ge=1,
        description="Number of atoms; at most the number of shapes (sparse-coding only).",
    )
    beta: float = Field(
        default=0.1,
        ge=0,
        description="Weight of the sparsity of the coefficients (sparse-coding only).",
    )
    iterations: int = Field(
        default=15,
        ge=1,
        le=MOST_STEPS,
        description="Most rounds of coding all shapes and updating all atoms (sparse-coding only).",
    )
    tolerance: float = Field(
        default=0.0,
        ge=0,
        description="Stop when a round lowers the objective by less than this share of it; "
        "0 runs all rounds (sparse-coding only).",
    )
    atom_bound: Literal["unit", "mean"] = Field(
        default="unit",
        description="Largest norm of an atom: 1, or the mean norm of the atoms learning "
        "starts from (sparse-coding only).",
    )
    energy: float = Field(
        default=0.99,
        gt=0,
        le=1,
        description="Share of the variation within a sequence that its bases hold "
        "(pca-bases only).",
    )
    components: int | None = Field(
        default=None,
        ge=1,
        description="Number of bases of each sequence, instead of `energy` (pca-bases only).",
    )

    prior: PriorConfig = Field(
        default_factory=PriorConfig.model_construct,
        description="The prior over shapes, for `method: posterior` of fit.",
    )

    @field_validator("k", "beta", "iterations", "tolerance", "atom_bound", "energy", "components")
    @classmethod
    def _belongs_to_the_method(cls, value: object, info: ValidationInfo) -> object:
        key = str(info.field_name)
        owner = "pca-bases" if key in ("energy", "components") else "sparse-coding"
        if info.data.get("method", owner) != owner and value != cls.model_fields[key].default:
            raise ValueError(f"`{key}` belongs to `method: {owner}`; leave it out")
        return value

    @field_validator("components")
    @classmethod
    def _instead_of_energy(cls, components: int | None, info: ValidationInfo) -> int | None:
        default = cls.model_fields["energy"].default
        if components is not None and info.data.get("energy", default) != default:
            raise ValueError("`components` and `energy` exclude each other; give one of them")
        return components
