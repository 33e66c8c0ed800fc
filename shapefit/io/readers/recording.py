"""What a file of another tool holds, as whole arrays: instances of landmarks, frame by frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import abbreviate, counted, input_error, printable
from shapefit.io.layout import UNKNOWN_UNIT

ANYBODY = -1
"""The individual of an instance whose identity over frames is not known."""

FRACTION = "fraction of the image"
"""Unit of coordinates that are divided by the width and the height of the image."""

Edges = tuple[tuple[int, int], ...]

STRANGE = (LookupError, TypeError, ValueError, AttributeError, OverflowError)
"""What a reader stumbles over in a file that is not as it expects."""


@contextmanager
def at(place: str | Path, fix: str) -> Iterator[None]:
    """Turn whatever a reader stumbles over here into the InputError that names the place."""
    try:
        yield
    except STRANGE as error:
        raise input_error(place, said(error), fix) from error


class UnexpectedError(ValueError):
    """What a file should not hold, in words; `at` names the place."""


def said(error: BaseException) -> str:
    """Return what an error says, on one line."""
    text = printable(str(error).strip().partition("\n")[0][:160])
    if isinstance(error, UnexpectedError):
        return text
    missing = isinstance(error, KeyError)
    return f"there is no {text}" if missing else f"is not as its format says ({text})"


def expect(condition: object, found: str) -> None:
    """Raise UnexpectedError with what was found, unless a condition holds."""
    if not condition:
        raise UnexpectedError(found)


def check_names(names: Sequence[str], what: str) -> None:
    """Raise UnexpectedError for names that are empty or repeat."""
    expect(all(names), f"a {what} has no name")
    twice = next((name for name, number in Counter(names).items() if number > 1), "")
    expect(not twice, f"the {what} {twice!r} is there twice")


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
    edges: Edges = ()
    size_needed: bool = False
    notes: tuple[str, ...] = ()
    unordered: bool = False
    default_keypoints: str | None = None

    @classmethod
    def of_frames(
        cls,
        path: Path,
        points: Floats,
        confidence: Floats | None = None,
        labels: Sequence[str] | None = None,
        *,
        individuals: Integers | None = None,
        there: NDArray[np.bool_] | None = None,
        **further: Any,
    ) -> Self:
        """Return the recording of points (n, i, p, d), i individuals in each of n frames.

        Points (n, p, d) are those of one individual. confidence (n, [i,] p); labels (n), by default
        the places of the frames; individuals (n, i), by default their places; `there` (n, i) are
        those that count, by default all. 2D points are in pixels, and `further` fields of a
        Recording go over all that.
        """
        n, p, d = len(points), *points.shape[-2:]
        many = points.shape[1] if points.ndim == 4 else 1
        labels = labels or list(map(str, range(n)))
        who = np.tile(np.arange(many), n) if individuals is None else individuals
        fields: dict[str, Any] = {
            "points": points.reshape(n * many, p, d),
            "confidence": None if confidence is None else confidence.reshape(n * many, p),
            "frames": np.repeat(np.arange(n), many),
            "labels": [label for label in labels for _ in range(many)],
            "individuals": who.ravel(),
        }
        if there is not None:
            fields = take_instances(fields, there.ravel())
        fields |= {"name": str(path), "video": video_name(path), "frame_count": n}
        fields["unit"] = "px" if d == 2 else UNKNOWN_UNIT
        return cls(**fields | further)

    def __post_init__(self) -> None:
        """Raise InputError for names that are empty or repeat, and fields that do not agree."""
        n, p, d = self.points.shape
        with at(self.name, "give each a name of its own, and each point its place"):
            check_names(self.individual_names, "individual")
            check_names(self.landmark_names or (), "landmark")
            expect(d in (2, 3), f"has points of {d} coordinates")
            named = p if self.landmark_names is None else len(self.landmark_names)
            expect(named == p or not n, f"has {p} landmarks, and names {named}")
            for field in ("frames", "labels", "individuals", "videos", "confidence"):
                if (values := getattr(self, field)) is not None:
                    found = f"has {len(values)} {field} of {n} instances"
                    expect(len(values) == n, found)
            known = max(1, len(self.individual_names))
            expect((self.individuals < known).all(), f"has points of more than {known} individuals")

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

IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


def video_name(path: Path) -> str:
    """Return the name of a file without its endings, which is what its items begin with."""
    return _without(path.stem, ENDINGS) or path.name


def image_labels(paths: Sequence[str]) -> list[str]:
    """Return names of images: without folder and suffix where that tells them apart."""
    stems = [_without(name_of(path), IMAGES) for path in paths]
    return stems if len(set(stems)) == len(stems) else [_without(path, IMAGES) for path in paths]


def _without(name: str, endings: Sequence[str]) -> str:
    ending = next((ending for ending in endings if name.lower().endswith(ending)), "")
    return name[: len(name) - len(ending)]


def number_labels(place: str, values: NDArray[Any]) -> list[str]:
    """Return numbers or times of frames, in seconds, as text, to the microsecond.

    Raises InputError where one is no number.
    """
    wrong = ~np.isfinite(values)
    if wrong.any():
        found = f"entry {int(np.argmax(wrong))} is {values[wrong][0]}, which is no frame"
        raise input_error(place, found, "number the frames")
    return [
        str(int(value)) if value == int(value) else f"{value:.6f}".rstrip("0")
        for value in values.tolist()
    ]


def name_of(path: str) -> str:
    """Return the last part of a path, whichever system wrote it."""
    return PureWindowsPath(path).name if "\\" in path else PurePosixPath(path).name


def numbered_repeats(
    labels: Sequence[str], form: str = "{}_{}"
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return labels, those that repeat an earlier one with a number after them, and a note.

    A label without a text is `*7`, as C3D files call the eighth.
    """
    names = [label.strip() or f"*{place}" for place, label in enumerate(labels)]
    taken, seen = set(names), Counter[str]()
    changed = []
    for place, name in enumerate(names):
        seen[name] += 1
        if seen[name] > 1:
            numbers = count(seen[name])
            names[place] = next(n for k in numbers if (n := form.format(name, k)) not in taken)
            taken.add(names[place])
            changed.append(names[place])
    note = f"{counted(len(changed), 'label')} repeated, and numbered ({abbreviate(changed)})"
    return tuple(names), (note,) if changed else ()


def edges_of(lines: Any, landmarks: int) -> Edges:
    """Return those of a list of lines that join two of so many landmarks."""
    return tuple(
        (pair[0], pair[1])
        for pair in (lines if isinstance(lines, list) else [])
        if isinstance(pair, list)
        and len(pair) == 2
        and all(type(end) is int and 0 <= end < landmarks for end in pair)
    )


def read_yaml(folder: Path, name: str, levels: int) -> tuple[Path, Any] | None:
    """Return the nearest file of this name in a folder or so many above it, and its content.

    Raises InputError for what is no YAML.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    place = folder.resolve()
    near = (each / name for each in (place, *place.parents[:levels]))
    path = next((each for each in near if each.is_file()), None)
    if path is None:
        return None
    try:
        return path, YAML(typ="safe", pure=True).load(path)
    except (YAMLError, RecursionError, ValueError) as error:
        text = " ".join(str(error).split())[:80]
        raise input_error(path, f"is no YAML ({text})", "correct it") from error
