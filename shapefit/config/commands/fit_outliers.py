"""The section `outliers` of `fit`: how wrong landmarks are found before the fit."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from shapefit.config.model import ConfigModel


class OutlierSearchConfig(ConfigModel):
    """Which landmarks the fit rejects as wrong."""

    method: Literal["none", "ransac", "truncated"] = Field(
        default="none",
        description="none; ransac poses the mean shape on random triples of landmarks and keeps "
        "the pose with which most others agree; truncated solves truncated least "
        "squares around the convex program, by graduated non-convexity.",
    )
    threshold: float = Field(
        default=0.25,
        gt=0,
        description="Residual beyond which a landmark is wrong, in units of the size of the "
        "shape as given by the other landmarks (the mean standard deviation of its "
        "coordinates).",
    )
    draws: int = Field(default=500, ge=1, description="ransac: triples drawn per image.")
    seed: int = Field(
        default=0,
        ge=0,
        description="ransac: seed of the draws; those of an image depend on its name, not on its "
        "place in the file.",
    )
    lam: float = Field(
        default=1.0,
        gt=0,
        alias="lambda",
        description="truncated: weight of the sum of spectral norms in its programs.",
    )
    max_rounds: int = Field(
        default=100, ge=1, description="Maximum rounds of fitting and judging again."
    )
