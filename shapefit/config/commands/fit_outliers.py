"""The section `outliers` of `fit`: how wrong landmarks are found before the fit."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from shapefit.config.model import ConfigModel


class OutlierSearchConfig(ConfigModel):
    """Which landmarks the fit leaves out because they are wrong."""

    method: Literal["none", "ransac", "truncated"] = Field(
        default="none",
        description="Nothing; ransac, the mean shape posed on random triples of the landmarks "
        "and the pose that most others agree with; truncated, truncated least squares around the "
        "convex program, by graduated non-convexity.",
    )
    threshold: float = Field(
        default=0.25,
        gt=0,
        description="Residual beyond which a landmark is wrong, in units of the size of the shape "
        "that the other landmarks show (the mean standard deviation of its coordinates).",
    )
    draws: int = Field(default=500, ge=1, description="ransac: triples drawn for one image.")
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
        default=100, ge=1, description="Most rounds of fitting and judging again."
    )
