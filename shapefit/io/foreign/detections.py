"""Detections of people and animals as a recording, and the files that they come in.

Files of one frame each are one recording: their names say which video and which frame. JSON is read
whole.
"""

from __future__ import annotations

import gc
import json
import math
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.arrays import Floats, Integers
from shapefit.errors import counted, input_error, listed
from shapefit.io.foreign.recording import ANYBODY, Recording, take_instances
from shapefit.io.inputs import BYTE_ORDER_MARK, read_whole

_LAST_NUMBER = re.compile(r"^(.*?)([0-9]{1,18})([^0-9]*)$", re.DOTALL)
_DIGITS = re.compile(r"([0-9]+)")


class FrameFile(NamedTuple):
    """A file, its video, the place of its frame there, and what the name calls the frame."""

    path: Path
    video: str
    frame: int
    label: str


def files_in(folder: Path, suffix: str) -> tuple[Path, ...]:
    """Return the files of a folder with this ending, in any order; folders in it do not count.

    Raises InputError for links that lead nowhere, pipes and devices, which cannot be read whole.
    """
    with os.scandir(folder) as entries:
        named = [folder / entry.name for entry in entries if entry.name.lower().endswith(suffix)]
    found = [path for path in named if not path.is_dir()]
    for path in found:
        if not path.is_file():
            what = "leads to no file" if path.is_symlink() else "is not a regular file"
            raise input_error(path, what, "remove it, or name the files themselves")
    return tuple(found)


MOST_APART = 100
"""Numbers per image, between the least and the largest, of what is a series of frames."""


def are_series(names: Sequence[str]) -> bool:
    """Whether names differ in one number, by which they can be the frames of a video."""
    found = [_LAST_NUMBER.match(name) for name in names]
    parts = {(match[1], match[3]) for match in found if match}
    numbers = {int(match[2]) for match in found if match}
    if None in found or len(parts) > 1 or len(numbers) < len(names):
        return False
    return not numbers or max(numbers) - min(numbers) < MOST_APART * len(numbers)


def frame_files(paths: Sequence[Path], folder: str) -> list[FrameFile]:
    """Return files in order of videos and frames; `folder` is the name of a single video.

    The last number in a name is that of the frame. Names that differ in more than this number are
    of several videos, unless one of these would have a single frame: then each name is that of an
    image. Raises InputError where two files have the same number.
    """
    series: dict[tuple[str, str], dict[int, Path]] = {}
    by_name = sorted(paths, key=lambda path: path.name)
    parts = {path: _LAST_NUMBER.match(_stem(path)) for path in by_name}
    for path, match in parts.items():
        if match is None:
            continue
        own = series.setdefault((match[1], match[3]), {})
        number = int(match[2])
        if number in own:
            found = f"two files of frame {number}, {own[number].name} and {path.name}"
            raise input_error(path.parent, found, "remove or rename one of them")
        own[number] = path
    alone = len(series) > 1 and any(len(own) == 1 for own in series.values())
    if None in parts.values() or alone:
        images = sorted(paths, key=_natural)
        return [FrameFile(path, folder, place, _stem(path)) for place, path in enumerate(images)]
    names = _video_names(list(series), folder)
    return [
        FrameFile(own[number], name, number - numbers[0], str(number))
        for name, own in zip(names, series.values(), strict=True)
        for numbers in [sorted(own)]
        for number in numbers
    ]


class Images(NamedTuple):
    """Files of one recording: how messages name them, their video, and each in order."""

    name: str
    video: str
    files: list[FrameFile]

    @property
    def unordered(self) -> bool:
        """Whether files are named as images, without numbers of frames."""
        return not all(file.label.isdigit() for file in self.files)


def images_in(paths: Sequence[Path], suffix: str, but: str = "") -> Images:
    """Return the files of a folder that is given as a whole, but for one, or these files.

    Raises InputError as `files_in` and `frame_files`.
    """
    folder = paths[0] if paths[0].is_dir() else paths[0].parent
    own = paths
    if paths[0].is_dir():
        own = [path for path in files_in(folder, suffix) if path.name != but]
    video = folder.resolve().name
    return Images(str(paths[0] if len(own) == 1 else folder), video, frame_files(own, video))


def _video_names(series: list[tuple[str, str]], folder: str) -> list[str]:
    """Return the names of videos: what their files have before the number, where that differs."""
    if len(series) == 1:
        return [folder]
    short = [before.rstrip("._- ") for before, _ in series]
    return (
        short if len({*short, ""}) > len(series) else [before + after for before, after in series]
    )


def _stem(path: Path) -> str:
    name = path.name
    return name.rpartition(".")[0] or name


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Return a key by which 9 comes before 10."""
    pieces = _DIGITS.split(path.name)
    return [(0, int(piece), "") if piece.isdigit() else (1, 0, piece) for piece in pieces]


NAMED_BY_COUNT: Mapping[int, str] = {17: "coco_17", 26: "halpe_26", 33: "mediapipe_33"}
"""The skeleton that detectors of people mean by a number of landmarks, where one is usual."""


@dataclass
class Detections:
    """What grows while files are read, one entry for each detection.

    name and video as in a Recording; unordered, whether they are images of no video; numbers, x, y
    and, with `step` 3, the confidence of each landmark, empty where nothing was found; scores, the
    confidences where they stand by themselves; frames, labels and videos as in a Recording;
    identities what the file calls who it is, None or a negative number where it does not know.
    """

    name: str
    video: str
    step: int = 3
    unordered: bool = False
    videos: list[str] | None = None
    numbers: list[Sequence[float]] = field(default_factory=list)
    scores: list[Sequence[float]] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)
    labels: list[str] = field(default_factory=list)
    identities: list[Any] = field(default_factory=list)

    @classmethod
    def in_file(cls, path: Path, step: int = 3) -> Self:
        """Begin with those of one file."""
        return cls(str(path), path.name.partition(".")[0], step)

    @classmethod
    def in_images(cls, images: Images, step: int = 3) -> Self:
        """Begin with those of files of a frame each, of one video or several."""
        several = len({file.video for file in images.files}) > 1
        return cls(images.name, images.video, step, images.unordered, [] if several else None)

    def add(self, numbers: Sequence[float], file: FrameFile, who: Any) -> None:
        """Add a detection in a frame of a video, and whom the file calls it."""
        self.numbers.append(numbers)
        self.frames.append(file.frame)
        self.labels.append(file.label)
        self.identities.append(who)
        if self.videos is not None:
            self.videos.append(file.video)

    def of_images(self, images: Sequence[int | float | str], named: Iterable[Any] = ()) -> int:
        """Say in which image each detection is; return how many there are.

        Images have the order of their first appearance, those `named` (id, what it is called)
        before, and their names without folder and ending where these are unique.
        """
        called = dict(named)
        for image in images:
            called.setdefault(image, image)
        place = {image: number for number, image in enumerate(called)}
        texts = [str(name) for name in called.values()]
        short = [Path(n).stem if isinstance(n, str) else str(n) for n in called.values()]
        names = short if len(set(short)) == len(short) else texts
        self.frames = [place[image] for image in images]
        self.labels = [names[frame] for frame in self.frames]
        self.unordered = not are_series(names)
        return len(called)

    def values(self) -> Floats:
        """Return the numbers (N, p, step), NaN where a detection has none or they are not finite.

        Raises InputError where detections have different numbers of landmarks, and for texts.
        """
        return _numbers(self.numbers, self.step, self.name)

    def confidence(self) -> Floats:
        """Return the scores (N, p), as `values` returns the numbers."""
        return _numbers(self.scores, 1, self.name)[..., 0]


CHECK = "check what wrote the file"


def _numbers(given: list[Sequence[float]], step: int, name: str) -> Floats:
    sizes = Counter(map(len, given))
    sizes.pop(0, 0)
    width = next(iter(sizes), 0)
    if strange := [size for size in sizes if size % step]:
        found = f"a detection of {strange[0]} numbers, which are not {step} for each landmark"
        raise input_error(name, found, CHECK)
    if len(sizes) > 1:
        kinds = [f"{n} detections with {s // step}" for s, n in sorted(sizes.items())]
        fix = "give the files of each skeleton in a separate call"
        raise input_error(name, f"several skeletons: {listed(kinds, 'and')} landmarks", fix)
    nothing = [math.nan] * width
    try:
        values = np.array([row or nothing for row in given], dtype=np.float64)
        values = values.reshape(len(given), width // step, step)
    except (ValueError, TypeError, OverflowError) as error:
        found = f"keypoints that are not numbers ({str(error)[:80]})"
        raise input_error(name, found, CHECK) from error
    return np.where(np.isfinite(values), values, np.nan)


def as_recording(
    detections: Detections,
    values: Floats,
    missing: NDArray[np.bool_],
    *,
    confidence: Floats | None = None,
    frames: int,
    notes: tuple[str, ...] = (),
    **further: Any,
) -> Recording:
    """Return a recording of detections.

    values (N, p, 2 or more) are what was read, x and y first; missing (N, p). Where nobody was
    found, the recording is empty and says so. `further` are fields of a Recording; without names
    landmarks are those of the skeleton that detectors mean by their number.
    """
    if not values.size:
        notes += (f"nobody was found in {counted(frames, 'frame')}",)
        values, missing = np.empty((0, 0, 2)), np.empty((0, 0), bool)
        confidence, further = None, {"landmark_names": ()}
        detections = Detections(detections.name, detections.video)
    people, individuals, doubts = _identities(detections)
    known = NAMED_BY_COUNT.get(values.shape[1])
    further.setdefault("default_keypoints", None if further.get("landmark_names") else known)
    in_frames = np.array(detections.frames, dtype=np.int64)
    instances = {
        "points": np.where(missing[..., None], np.nan, values[..., :2]),
        "confidence": None if confidence is None else np.where(missing, 0.0, confidence),
        "frames": in_frames,
        "labels": detections.labels,
        "individuals": individuals,
        "videos": detections.videos,
    }
    first = numbered(detections.videos or [""] * len(values))[0]
    order = np.lexsort((in_frames, np.array(first))).astype(np.intp)
    return Recording(
        name=detections.name,
        video=detections.video,
        **take_instances(instances, order),
        individual_names=people,
        frame_count=frames,
        notes=notes + doubts,
        unit=further.pop("unit", "px"),
        unordered=detections.unordered,
        **further,
    )


def numbered(ids: Iterable[Any]) -> tuple[list[int], list[Any]]:
    """Return the places of ids in the order of their first appearance, and those ids."""
    place: dict[Any, int] = {}
    return [place.setdefault(one, len(place)) for one in ids], list(place)


def image_key(image: Any, place: str) -> int | float | str:
    """Return what identifies an image. Raises InputError at `place` for what cannot."""
    if not isinstance(image, int | float | str):
        raise input_error(place, f"no image ({str(image)[:40]})", "name images by number or text")
    return image


def _identities(detections: Detections) -> tuple[tuple[str, ...], Integers, tuple[str, ...]]:
    """Return the names of individuals, who each detection is, and doubts about that.

    Some tools number the people of each frame anew: where a number is twice in a frame, none is
    an identity.
    """
    ids = [_plain(one) for one in detections.identities]
    nobody = np.full(len(ids), ANYBODY, dtype=np.int64)
    known = [row for row, one in enumerate(ids) if one is not None]
    videos = detections.videos or [""] * len(ids)
    seen = Counter((videos[row], detections.frames[row], ids[row]) for row in known)
    if twice := sum(number > 1 for number in seen.values()):
        text = f"numbers of people are not used, as {twice} of them occur twice in a frame"
        return (), nobody, (text,)
    nobody[known], names = numbered(ids[row] for row in known)
    return tuple(names), nobody, ()


def _plain(identity: Any) -> str | None:
    """Return an identity as text, None for none: a number, a text, or a list of one of them."""
    while isinstance(identity, list) and len(identity) == 1:
        identity = identity[0]
    if isinstance(identity, bool) or not isinstance(identity, int | float | str):
        return None
    if isinstance(identity, str):
        return identity or None
    return None if identity < 0 or identity != identity else f"id {identity:g}"


Paths = tuple[Path, ...]

_NOT_JSON = re.compile(rb"\b(?:NaN|-?Infinity)\b")


def read_json(path: Path) -> Any:
    """Return the contents of a JSON file; NaN and Infinity, which Python writes, are read, too.

    Raises InputError for a file that is too large or damaged, naming the line.
    """
    data = read_whole(path).removeprefix(BYTE_ORDER_MARK)
    try:
        return orjson.loads(data)
    except orjson.JSONDecodeError as error:
        if _NOT_JSON.search(data):
            try:
                return json.loads(data)
            except (ValueError, RecursionError):
                pass
        if not data.strip():
            raise input_error(path, "is empty", "make or copy the file again") from error
        found = f"is not whole JSON ({error.msg})"
        raise input_error(f"{path}:{error.lineno}", found, "make or copy the file again") from error


def without_collection(record: Callable[[Paths], Recording]) -> Callable[[Paths], Recording]:
    """Return a reader during which the garbage collector rests.

    It would walk again and again over the millions of lists of a large file, several times as slow.
    """

    @wraps(record)
    def resting(paths: Paths) -> Recording:
        running = gc.isenabled()
        gc.disable()
        try:
            return record(paths)
        finally:
            if running:
                gc.enable()

    return resting
