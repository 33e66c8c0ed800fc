"""The section `corrupt` of `sweep`: observed landmarks made wrong on purpose."""

from __future__ import annotations

from pydantic import Field

from shapefit.config.model import ConfigModel


class CorruptionConfig(ConfigModel):
    """Visible landmarks replaced by points drawn at random, to see which are found."""

    share: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="Share of the visible landmarks of each image to replace by points drawn "
        "uniformly from the bounding box of these landmarks, grown on each side by a tenth of its "
        "size.",
    )
    seed: int = Field(default=0, ge=0, description="Seed of the choice and of the points.")
