"""How files are read, by the keys of a command, and how they are written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Generic, Literal, NamedTuple, TypeVar

if TYPE_CHECKING:
    from shapefit.geometry.cameras import Up

Track = Literal["nearest", "none", "motion"]
Direction = Literal["down", "up"]
Markers = Literal["joints", "input"]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class InputOptions:
    """How files are read: the keys of commands, the defaults take files as they are.

    track joins detections without identity over frames: `nearest`; `motion`, which
    refuses images that follow no order; or `none`. min_confidence hides landmarks whose
    confidence is below. landmarks are those that are retained, in this order, by their
    new names; None for all. Of frames only those in `frames`, first to before the last,
    are read (None is open), and of these every n-th.
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
    frames: tuple[int | None, int | None] = (None, None)
    every: int = 1

    @property
    def skips_frames(self) -> bool:
        """Whether some frames are left out, by `every` or `frames`."""
        return self.every > 1 or self.frames != (None, None)


AS_THEY_ARE = InputOptions()


def input_options(config: object, track: Track = "none") -> InputOptions:
    """Return the options for reading files, from the keys of a command's config."""
    keys = ("format", "individual", "rename", "keypoints", "y_axis", "image_size")
    given = {key: getattr(config, key) for key in keys if hasattr(config, key)}
    least = getattr(config, "min_confidence", None) or 0.0
    return InputOptions(**given, track=track, min_confidence=least)


class OutputOptions(NamedTuple):
    """How shapes get into files in metres.

    height in metres, by default that of the training shapes; unit of shapes whose files
    do not state it; up, the axis that points up; markers `input` are the landmarks that
    were lifted.
    """

    height: float | None = None
    unit: str | None = None
    up: Up | None = None
    markers: Markers = "joints"


BY_DEFAULT = OutputOptions()


class Summary(NamedTuple):
    """What was written: the unit and axes, what to beware of, and the files if not the
    target; how certain joint angles are, where they are what was asked for; the digest
    of its contents, where the file states it.
    """

    note: str = ""
    warnings: tuple[str, ...] = ()
    written: tuple[Path, ...] = ()
    angles: str = ""
    digest: str = ""


Record = TypeVar("Record")


class RecordWriter(Generic[Record]):
    """Takes records one after another; `attributes` are stored with the file on a clean
    exit.

    After that `summary` says what was written. `begun` is whether a record was
    appended. Where `seal` is not None before the first record, HDF5 gets a digest of
    all that it holds, with these attributes: it is the result of a fit, as it was made.
    """

    def __init__(self) -> None:
        self.attributes: dict[str, str | float | int] = {}
        self.summary = Summary()
        self.begun = False
        self.seal: dict[str, str] | None = None

    def append(self, record: Record) -> None:
        """Write the items of a record after those already written."""
        raise NotImplementedError

    def check_begun(self) -> None:
        """Raise ValueError where nothing was appended."""
        if not self.begun:
            raise ValueError(
                "nothing was appended; append one record, which may be empty"
            )
