"""The section `sequences` of `fit`: how the images of a sequence hang together."""

from __future__ import annotations

from pydantic import Field

from shapefit.config.model import ConfigModel
from shapefit.config.paths import OptionalInputPath


class SequencesConfig(ConfigModel):
    """How `method: sequences` ties the images of a sequence together."""

    frame_rate: float | None = Field(default=None, gt=0)
    """Images per second; by default, `frame_rate` of the landmark files. Without either, the motion
    between images is assumed to be that between the training shapes."""
    lengths: OptionalInputPath = None
    """Known lengths of the bones: shapes of the body, of which the mean lengths are taken, or a CSV
    file with the header `from,to,length`, in any unit. By default, they are estimated in each
    sequence."""
