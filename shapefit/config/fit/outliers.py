"""The section `outliers` of `fit`: how wrong landmarks are found."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from shapefit.config.model import ConfigModel


class OutliersConfig(ConfigModel):
    """How wrong landmarks are found: by a search before the fit, or by a robust loss."""

    method: Literal["none", "ransac", "truncated", "sparse-error", "l1"] = "none"
    """none; ransac poses the mean shape on random triples of landmarks, keeps the pose with which
    most others agree, and the fit rejects the others; truncated rejects those of truncated least
    squares around the convex program, by graduated non-convexity; sparse-error and l1 are robust
    losses of the program: the squared residual plus sparse errors with weight `threshold`, and the
    sum of absolute residuals."""
    threshold: float | None = Field(default=None, gt=0)
    """Residual beyond which a landmark is wrong. Of a search, in units of the size of the shape as
    given by the other landmarks (the mean standard deviation of its coordinates), 0.25 if not
    given; of a robust loss, for normalised landmarks, 0.1 if not given."""
    draws: int = Field(default=500, ge=1)
    """ransac: triples drawn per image."""
    seed: int = Field(default=0, ge=0)
    """ransac: seed of the draws; those of an image depend on its name, not on its place in the
    file."""
    lam: float = Field(default=1.0, gt=0, alias="lambda")
    """truncated: weight of the sum of spectral norms in its programs."""
