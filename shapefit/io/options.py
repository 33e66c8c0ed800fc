"""How files of landmarks and shapes are read: what the section `input` of every command says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Track = Literal["nearest", "none"]


@dataclass(frozen=True, kw_only=True)
class InputOptions:
    """How files are read; the defaults take them as they are.

    format            a name in the table of formats, auto by their content
    keypoints         the skeleton whose names landmarks have in files that do not name them
    individual        the one individual that is read, by its name; None for all
    track             nearest joins detections without identity over frames; none leaves each
                      an item of its own
    likelihood_below  landmarks whose confidence is below this are hidden
    rename            landmarks, as files have them -> the names that they are given out under
    """

    format: str = "auto"
    keypoints: str | None = None
    individual: str | None = None
    track: Track = "none"
    likelihood_below: float = 0.0
    rename: Mapping[str, str] = field(default_factory=dict)


AS_THEY_ARE = InputOptions()
