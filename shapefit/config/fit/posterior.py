"""The section `posterior` of `fit`: the model of the landmarks, and what is reported."""

from __future__ import annotations

from pydantic import Field

from shapefit.config.model import MOST_STEPS, ConfigModel
from shapefit.lifting.methods import PosteriorOptions


class PosteriorConfig(ConfigModel):
    """How `method: posterior` weighs landmarks against the prior over shapes."""

    misfit: float | None = Field(
        default=None,
        gt=0,
        description="Variance of a landmark's coordinate that prior and camera do not explain, in "
        "the unit of normalised shapes, at confidence 1; by default that of the dictionary, or "
        f"{PosteriorOptions.misfit} where it has none. It is added to the variance of `noise`.",
    )
    least_score: float | None = Field(default=PosteriorOptions.least_score, ge=0)
    """Hide landmarks whose confidence is below this, and take all others for equally precise: the
    score of a detector is a chance, not a precision. Landmarks with `landmark_covariance` keep
    theirs. With null the variances are divided by the square of the confidence."""
    gross_chance: float = Field(default=PosteriorOptions.gross_chance, ge=0, lt=1)
    """Probability that a landmark is grossly wrong, anywhere; 0 trusts all."""
    gross_density: float = Field(default=PosteriorOptions.gross_density, gt=0)
    """Density of gross landmarks, per area, for normalised landmarks."""
    widening: float = Field(default=PosteriorOptions.widening, gt=0)
    """Factor applied to all covariances, to allow for what the prior has not seen."""
    views: int = Field(default=PosteriorOptions.views, ge=0, le=1000)
    """Views, spread evenly, to start from besides that of the convex program."""
    covariance: bool = PosteriorOptions.covariance
    """Also write the covariance of all landmarks together, `shape_covariance` (n, 3p, 3p) (large;
    HDF5 and Parquet)."""
    csv_deviations: bool = False
    """CSV: also write the standard deviations, as sd_x, sd_y, sd_z."""
    max_rounds: int = Field(default=PosteriorOptions.max_rounds, ge=1, le=MOST_STEPS)
    """Maximum steps per start and component."""
    implausible: float = Field(default=0.05, ge=0, lt=1)
    """Images with a plausibility below this are not to be trusted."""
    widest: float = Field(default=0.8, gt=0)
    """Images whose error bars are wider than this are not to be trusted: the mean over landmarks,
    beside the spread of the shape."""
