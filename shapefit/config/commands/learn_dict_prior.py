"""The section `prior` of `learn-dict`: the mixture of Gaussians over shapes."""

from __future__ import annotations

from pydantic import Field

from shapefit.config.model import MOST_STEPS, ConfigModel


class PriorConfig(ConfigModel):
    """The prior over shapes that `method: posterior` of `fit` needs."""

    components: int = Field(
        default=0,
        ge=0,
        le=1000,
        description="Gaussians in the mixture; 0 learns none.",
    )
    shrinkage: float = Field(
        default=0.3,
        ge=0,
        lt=1,
        description="Share of the covariance of all shapes in that of a component of average size.",
    )
    floor: float = Field(
        default=0.01,
        gt=0,
        description="Variance of every coordinate beyond that of the shapes, which are normalised.",
    )
    copies: int = Field(
        default=1,
        ge=1,
        le=100,
        description="Number of copies of each shape, each varied at random.",
    )
    stretch: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Standard deviation of the logarithm of the lengths of bones (the edges of the "
        "shapes, a tree): other bodies.",
    )
    exchange: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Share of the shapes whose limbs, the chains of bones that end freely, come "
        "from other shapes: other poses.",
    )
    weights: str | None = Field(
        default=None,
        min_length=1,
        description="Dataset of the shapes that holds the weight of each.",
    )
    max_rounds: int = Field(
        default=20, ge=1, le=MOST_STEPS, description="Maximum rounds of expectation maximisation."
    )
    folds: int = Field(
        default=0,
        ge=0,
        le=100,
        description="Cross-validates the mixture on as many groups of whole sequences (without "
        "sequences: blocks of shapes), and reports the log likelihood of a shape left out; 0 "
        "skips this.",
    )
