"""How the files of a command are read, from the section `input` of its config."""

from __future__ import annotations

from typing import TYPE_CHECKING

from shapefit.io.options import InputOptions, Track

if TYPE_CHECKING:
    from shapefit.config.commands.input import InputConfig


def input_options(config: InputConfig, track: Track = "none") -> InputOptions:
    """Return what the section says; `track` where it leaves that open."""
    return InputOptions(
        format=config.format,
        keypoints=config.keypoints,
        individual=config.individual,
        track=config.track or track,
        likelihood_below=config.likelihood_below,
        rename=config.rename,
        image_size=config.image_size,
        y_axis=config.y_axis,
    )
