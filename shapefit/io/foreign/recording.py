"""What files of other tools hold, in one form: instances of landmarks, frame by frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.io.layout import UNKNOWN_UNIT

ANYBODY = -1
"""The individual of an instance whose identity over frames is not known."""


FRACTION = "fraction of the image"
"""Unit of coordinates that are divided by the width and the height of the image."""


@dataclass(frozen=True, kw_only=True)
class Rows:
    """What N instances have, whatever else: `take` and `stacked` know arrays, texts and extras."""

    points: Floats
    confidence: Floats | None = None
    frames: Integers
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.points)

    def take(self, rows: NDArray[np.intp] | slice, counts: Mapping[str, int] | None = None) -> Self:
        """Return these rows, those of a slice as views, with other counts, by default none."""
        if isinstance(rows, np.ndarray) and np.array_equal(rows, np.arange(len(self))):
            rows = slice(None)
        taken = {name: _taken(values, rows) for name, values in self._of_rows().items()}
        extras = {name: values[rows] for name, values in self.extras.items()}
        return replace(self, **taken, extras=extras, counts=counts or {})

    def blocks(self, size: int = 4096) -> Iterator[Self]:
        """Give out the rows, so many at a time."""
        return (self.take(slice(row, row + size)) for row in range(0, len(self), size))

    def _of_rows(self) -> dict[str, Any]:
        """Return the fields that have a row for each instance, but for extras, by name."""
        return {name: v for name, v in vars(self).items() if name not in ("extras", "counts")}


def _taken(values: Any, rows: NDArray[np.intp] | slice) -> Any:
    if values is None or isinstance(values, np.ndarray) or isinstance(rows, slice):
        return None if values is None else values[rows]
    return tuple(values[row] for row in rows.tolist())


R = TypeVar("R", bound=Rows)


def stacked(parts: Sequence[R]) -> R:
    """Return instances one after the other, their counts added up.

    Those without a confidence among others have 1.
    """
    if len(parts) == 1:
        return parts[0]
    if any(part.confidence is not None for part in parts):
        parts = [
            replace(part, confidence=np.ones(part.points.shape[:2]))
            if part.confidence is None
            else part
            for part in parts
        ]
    joined: dict[str, Any] = {}
    for name in parts[0]._of_rows():
        values = [getattr(part, name) for part in parts]
        if any(each is None for each in values):
            joined[name] = None
        elif isinstance(values[0], np.ndarray):
            joined[name] = np.concatenate(values)
        else:
            joined[name] = tuple(chain.from_iterable(values))
    extras = {
        name: np.concatenate([part.extras[name] for part in parts]) for name in parts[0].extras
    }
    counts = Counter[str]()
    for part in parts:
        counts.update(part.counts)
    return replace(parts[0], **joined, extras=extras, counts=counts)


@dataclass(frozen=True, kw_only=True)
class Instances(Rows):
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

    labels: Sequence[str]
    individuals: Integers
    videos: Sequence[str] | None = None

    @classmethod
    def of_one(
        cls, points: Floats, start: int, labels: Sequence[str] | None = None, **further: Any
    ) -> Self:
        """Return frames `start` and on of one individual; without labels they are numbers."""
        frames = np.arange(start, start + len(points))
        return cls(
            points=points,
            frames=frames,
            labels=list(map(str, frames.tolist())) if labels is None else labels,
            individuals=np.zeros(len(points), np.int64),
            **further,
        )

    @classmethod
    def of_all(
        cls, points: Floats, confidence: Floats | None, start: int, labels: Sequence[str]
    ) -> Self:
        """Return points (n, i, p, d) of frames `start` and on, i individuals in each."""
        n, many, p, d = points.shape
        return cls(
            points=points.reshape(n * many, p, d),
            confidence=None if confidence is None else confidence.reshape(n * many, p),
            frames=np.repeat(np.arange(start, start + n), many),
            labels=[label for label in labels for _ in range(many)],
            individuals=np.tile(np.arange(many), n),
        )


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A file (or a folder of them) of another tool.

    name             the path, for messages
    video            what items begin with: the name of the file without its endings
    dimensions       2 for landmarks, 3 for shapes
    landmark_count   p, where there are no names to count
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
    landmark_count: int = 0
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

    def __post_init__(self) -> None:
        """Count the landmarks that have names."""
        if self.landmark_names is not None:
            object.__setattr__(self, "landmark_count", len(self.landmark_names))


ENDINGS = (".analysis", ".predictions", ".pkg", ".pose")
"""Which the names of files have before their suffix, and their videos have not."""


def video_name(path: Path) -> str:
    """Return the name of a file without its endings, which is what its items begin with."""
    name = path.stem
    ending = next((ending for ending in ENDINGS if name.lower().endswith(ending)), "")
    return name[: len(name) - len(ending)] or path.name
