"""What files of other tools hold, in one form: instances of landmarks, frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.io.layout import UNKNOWN_UNIT

ANYBODY = -1
"""The individual of an instance whose identity over frames is not known."""


FRACTION = "fraction of the image"
"""Unit of coordinates that are divided by the width and the height of the image."""


@dataclass(frozen=True, kw_only=True)
class Instances:
    """N instances, each one individual in one frame, in order of the frames.

    points (N, p, 2) or (N, p, 3), NaN where the format says that a landmark is missing; confidence
    (N, p), NaN where a landmark has none (then 1), or None where the format has none; frames (N,),
    the place of each frame in its video, from 0, never falling within a video; labels (N),
    what the file calls the frame (a number, a time, an image); individuals (N,), places in
    `Recording.individuals`, or ANYBODY; videos (N), where a file holds more than one; extras
    (N, ...), further datasets.

    counts: what was left out or replaced here, by the words of a warning, as {"predicted
    instances replaced by those that a user placed": 3}.
    """

    points: Floats
    confidence: Floats | None = None
    frames: Integers
    labels: Sequence[str]
    individuals: Integers
    videos: Sequence[str] | None = None
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A file (or a folder of them) of another tool.

    name             the path, for messages
    video            what items begin with: the name of the file without its endings
    dimensions       2 for landmarks, 3 for shapes
    landmark_count   p
    landmark_names   None where the file has none: then `keypoints` names them
    blocks           reads all instances anew, some thousand frames at a time
    individuals      their names; empty where the format knows no individuals, or names none
    frames           of the source, those without an instance too; None where that takes a count
    frame_rate       in Hz
    y_axis           direction of y in the image (2 dimensions)
    edges            pairs of landmarks, by place
    extras           datasets of the whole file: camera_matrix (3, 3), distortion, image_size
    size_needed      of fractions of the image: whether they are useless without `image_size`
    notes            warnings about the file as a whole
    unordered        whether the images are, as far as names say, no frames of a video
    default_keypoints  the skeleton that the format implies, where landmarks have no names
    """

    name: str
    video: str
    dimensions: Literal[2, 3]
    landmark_count: int
    landmark_names: tuple[str, ...] | None = None
    blocks: Callable[[], Iterable[Instances]]
    individuals: tuple[str, ...] = ()
    frames: int | None = None
    frame_rate: float | None = None
    unit: str = UNKNOWN_UNIT
    y_axis: Literal["up", "down"] = "down"
    edges: tuple[tuple[int, int], ...] = ()
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    size_needed: bool = False
    notes: tuple[str, ...] = ()
    unordered: bool = False
    default_keypoints: str | None = None


ENDINGS = (".analysis", ".predictions", ".pkg", ".pose")
"""Which the names of files have before their suffix, and their videos have not."""


def video_name(path: Path) -> str:
    """Return the name of a file without its endings, which is what its items begin with."""
    name = path.stem
    ending = next((ending for ending in ENDINGS if name.lower().endswith(ending)), "")
    return name[: len(name) - len(ending)] or path.name
