"""How files are read, by the keys of a command, and how they are written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar

if TYPE_CHECKING:
    from shapefit.geometry.cameras import Up


Track = Literal["nearest", "none", "motion"]
Direction = Literal["down", "up"]
Markers = Literal["joints", "input"]


@dataclass(frozen=True, kw_only=True)
class InputOptions:
    """How files are read; the defaults take them as they are.

    format            a name in the table of formats, auto by their content
    keypoints         the skeleton whose names landmarks have in files that do not name them
    individual        the one individual that is read, by its name; None for all
    track             nearest joins detections without identity over frames; none leaves each
                      an item of its own; motion joins them, and refuses images that follow no
                      order (the default where sequences are asked for)
    min_confidence    landmarks whose confidence is below this are hidden
    rename            landmarks, as files have them -> the names that they are given out under
    image_size        width and height of the images in pixels, by which fractions are multiplied
    y_axis            where y points in landmarks, against what a format of others has by
                      convention; None as files say it, and down where they do not
    landmarks         those that are kept, in this order, by their new names; None for all
    """

    format: str = "auto"
    keypoints: str | None = None
    individual: str | None = None
    track: Track = "none"
    min_confidence: float = 0.0
    rename: Mapping[str, str] = field(default_factory=dict)
    image_size: tuple[float, float] | None = None
    y_axis: Direction | None = None
    landmarks: tuple[str, ...] | None = None


AS_THEY_ARE = InputOptions()

OF_COMMANDS = ("format", "individual", "rename", "keypoints", "y_axis", "image_size")
"""The keys by which commands read files."""


def input_options(config: Any, track: Track = "none") -> InputOptions:
    """Return how a command reads its files, by the keys of its config.

    `track` says how detections without identity are joined.
    """
    given = {key: getattr(config, key) for key in OF_COMMANDS if hasattr(config, key)}
    least = getattr(config, "min_confidence", None) or 0.0
    return InputOptions(**given, track=track, min_confidence=least)


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """How shapes get into files in metres.

    height      of the body or the object in metres; by default results are as large as the training
                shapes of their dictionary
    unit        of shapes whose files do not say it
    up          axis of the shapes, or of the world that the extrinsics know, that points up
    markers     input: the landmarks of the files that were lifted, in place of the joints
    """

    height: float | None = None
    unit: str | None = None
    up: Up | None = None
    markers: Markers = "joints"

    @property
    def given(self) -> tuple[str, ...]:
        """Return the names of the keys of a config that are set."""
        return tuple(name for name, value in vars(self).items() if value != vars(AS_KNOWN)[name])


AS_KNOWN = OutputOptions()


@dataclass(frozen=True, kw_only=True)
class Summary:
    """What was written: the unit and axes, what to beware of, and the files if not the target."""

    note: str = ""
    warnings: tuple[str, ...] = ()
    written: tuple[Path, ...] = ()


Record = TypeVar("Record")


class RecordWriter(Generic[Record]):
    """Takes records one after another; `attributes` are stored with the file on a clean exit.

    After that `summary` says what was written. `begun` is whether a record was appended.
    """

    def __init__(self) -> None:
        self.attributes: dict[str, str | float | int] = {}
        self.summary = Summary()
        self.begun = False

    def append(self, record: Record) -> None:
        """Write the items of a record after those that are there."""
        raise NotImplementedError

    def check_begun(self) -> None:
        """Raise ValueError where nothing was appended."""
        if not self.begun:
            raise ValueError("nothing was appended; append one record, which may be empty")
