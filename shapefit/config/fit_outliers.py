"""The section `outliers` of `fit`: how wrong landmarks are found before the fit."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from shapefit.config.model import ConfigModel


class OutlierSearchConfig(ConfigModel):
    """Which landmarks the fit leaves out because they are wrong."""

    method: Literal["none", "ransac", "truncated"] = Field(
        default="none",
        description="Nothing; ransac, the mean shape posed on random subsets of the landmarks "
        "and the largest consensus; truncated, truncated least squares around the convex "
        "program, by graduated non-convexity.",
    )
    threshold: float = Field(
        default=0.25,
        gt=0,
        description="Residual, for landmarks normalised by the inliers, beyond which a landmark "
        "is wrong.",
    )
    draws: int = Field(default=500, ge=1, description="ransac: subsets drawn for one image.")
    subset: int = Field(default=4, ge=3, description="ransac: landmarks of a subset.")
    max_rounds: int = Field(
        default=30, ge=1, description="Most rounds of fitting and judging again."
    )
    seed: int = Field(default=0, ge=0, description="ransac: seed of the draws.")
