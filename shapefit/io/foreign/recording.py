"""What a file of another tool holds, as whole arrays: instances of landmarks, frame by frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import input_error
from shapefit.io.layout import UNKNOWN_UNIT

ANYBODY = -1
"""The individual of an instance whose identity over frames is not known."""

FRACTION = "fraction of the image"
"""Unit of coordinates that are divided by the width and the height of the image."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """N instances, each one individual in one frame, in order of the frames of each video.

    name         the path, for messages
    video        what items begin with: the name of the file without its endings
    points       (N, p, 2) or (N, p, 3), NaN where the format says that a landmark is missing
    confidence   (N, p), NaN where a landmark has none (then 1); None where the format has none
    frames       (N,), the place of each frame in its video, from 0, never falling within a video
    labels       (N), what the file calls the frame: a number, a time, an image
    individuals  (N,), places in `individual_names`, or ANYBODY
    videos       (N), where a file holds more than one

    individual_names  empty where the format knows no individuals, or names none
    landmark_names    None where the file has none: then `keypoints` names them
    frame_count       of the source, frames without an instance too; None where it does not say
    frame_rate        in Hz
    y_axis            direction of y in the image (2 dimensions)
    edges             pairs of landmarks, by place
    size_needed       of fractions of the image: whether they are useless without `image_size`
    notes             warnings: what was left out or replaced, what is in doubt
    unordered         whether the images are, as far as names say, no frames of a video
    default_keypoints  the skeleton that the format implies, where landmarks have no names
    """

    name: str
    video: str
    points: Floats
    confidence: Floats | None = None
    frames: Integers
    labels: Sequence[str]
    individuals: Integers
    videos: Sequence[str] | None = None
    individual_names: tuple[str, ...] = ()
    landmark_names: tuple[str, ...] | None = None
    frame_count: int | None = None
    frame_rate: float | None = None
    unit: str = UNKNOWN_UNIT
    y_axis: Literal["up", "down"] = "down"
    edges: tuple[tuple[int, int], ...] = ()
    size_needed: bool = False
    notes: tuple[str, ...] = ()
    unordered: bool = False
    default_keypoints: str | None = None

    def __len__(self) -> int:
        return len(self.points)

    @property
    def dimensions(self) -> int:
        """2 for landmarks, 3 for shapes."""
        return self.points.shape[2]

    @property
    def landmark_count(self) -> int:
        """Number of landmarks, p."""
        return self.points.shape[1]


def one_individual(points: Floats, labels: Sequence[str] | None = None) -> dict[str, Any]:
    """Return the fields of a `Recording` of one individual from points (n, p, d), a frame each."""
    frames = np.arange(len(points))
    return {
        "points": points,
        "frames": frames,
        "labels": list(map(str, frames.tolist())) if labels is None else labels,
        "individuals": np.zeros(len(points), np.int64),
    }


def all_individuals(
    points: Floats, confidence: Floats | None, labels: Sequence[str]
) -> dict[str, Any]:
    """Return the fields of a recording of points (n, i, p, d), i individuals in each frame."""
    n, many, p, d = points.shape
    return {
        "points": points.reshape(n * many, p, d),
        "confidence": None if confidence is None else confidence.reshape(n * many, p),
        "frames": np.repeat(np.arange(n), many),
        "labels": [label for label in labels for _ in range(many)],
        "individuals": np.tile(np.arange(many), n),
    }


def take_instances(fields: Mapping[str, Any], rows: NDArray[Any]) -> dict[str, Any]:
    """Return the fields of a recording for some of its instances."""
    places = np.arange(len(rows))[rows] if rows.dtype == bool else rows
    return {
        name: values
        if values is None
        else values[places]
        if isinstance(values, np.ndarray)
        else [values[place] for place in places.tolist()]
        for name, values in fields.items()
    }


ENDINGS = (".analysis", ".predictions", ".pkg", ".pose")
"""Which the names of files have before their suffix, and their videos have not."""


def video_name(path: Path) -> str:
    """Return the name of a file without its endings, which is what its items begin with."""
    name = path.stem
    ending = next((ending for ending in ENDINGS if name.lower().endswith(ending)), "")
    return name[: len(name) - len(ending)] or path.name


IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


def image_labels(paths: Sequence[str]) -> list[str]:
    """Return names of images: without folder and suffix where that tells them apart."""
    stems = [_without_suffix(name_of(path)) for path in paths]
    return stems if len(set(stems)) == len(stems) else [_without_suffix(path) for path in paths]


def number_label(value: float) -> str:
    """Return a frame's number or time in seconds as text, to the microsecond."""
    return str(int(value)) if value == int(value) else f"{value:.6f}".rstrip("0")


def number_labels(place: str, values: NDArray[Any]) -> list[str]:
    """Return the numbers or times of frames as text; InputError where one is no number."""
    wrong = ~np.isfinite(values)
    if wrong.any():
        found = f"entry {int(np.argmax(wrong))} is {values[wrong][0]}, which is no frame"
        raise input_error(place, found, "number the frames")
    return [number_label(value) for value in values.tolist()]


def name_of(path: str) -> str:
    """Return the last part of a path, whichever system wrote it."""
    return PureWindowsPath(path).name if "\\" in path else PurePosixPath(path).name


def numbered_repeats(names: Sequence[str]) -> tuple[str, ...]:
    """Return names, those that repeat an earlier one with a number after them."""
    taken: set[str] = set()
    found = []
    for name in names:
        free, number = name, 2
        while free in taken:
            free, number = f"{name} ({number})", number + 1
        taken.add(free)
        found.append(free)
    return tuple(found)


def check_unique(place: str, names: Sequence[str], what: str) -> None:
    """Raise InputError for names that are empty or repeat."""
    known: set[str] = set()
    for name in names:
        if not name:
            raise input_error(place, f"a {what} has no name", "name each of them")
        if name in known:
            found = f"the {what} {name!r} is there twice"
            raise input_error(place, found, "give each a name of its own")
        known.add(name)


def edges_of(lines: Any, count: int) -> tuple[tuple[int, int], ...]:
    """Return those of a list of lines that join two of so many landmarks."""
    pairs = lines if isinstance(lines, list) else []
    whole = [
        tuple(pair)
        for pair in pairs
        if isinstance(pair, list) and len(pair) == 2 and all(type(end) is int for end in pair)
    ]
    return tuple((a, b) for a, b in whole if 0 <= a < count and 0 <= b < count)


def _without_suffix(path: str) -> str:
    ending = next((ending for ending in IMAGES if path.lower().endswith(ending)), "")
    return path[: len(path) - len(ending)]
