"""Detections of people and animals as a recording, and the files that they come in.

Files of one frame each are one recording: their names say which video and which frame. JSON is read
whole.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import orjson
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import counted, input_error, listed
from shapefit.io.inputs import BYTE_ORDER_MARK, read_whole
from shapefit.io.readers.poses import Poses, parsing
from shapefit.io.skeletons import skeletons_of_size

CHECK = "check what wrote the file"

_LAST_NUMBER = re.compile(r"^(.*?)([0-9]{1,18})([^0-9]*)$", re.DOTALL)
_DIGITS = re.compile(r"([0-9]+)")


class Frame(NamedTuple):
    """A frame: its file, its video, its place there, and what the file calls it."""

    path: Path
    video: str
    number: int
    label: str


class Images(NamedTuple):
    """Files of one recording: how messages name them, their video, and each in order."""

    name: str
    video: str
    frames: list[Frame]


def images_in(paths: Sequence[Path], suffix: str, but: str = "") -> Images:
    """Return the files of a folder that is given as a whole, but for one, or these files.

    Raises InputError for two files of one frame, and for links that lead nowhere, pipes and devices
    in a folder, which cannot be read whole.
    """
    folder = paths[0] if paths[0].is_dir() else paths[0].parent
    own = paths
    if paths[0].is_dir():
        with os.scandir(folder) as entries:
            names = [each.name for each in entries if each.name.lower().endswith(suffix)]
        own = [path for path in map(folder.joinpath, names) if not path.is_dir()]
        own = [path for path in own if path.name != but]
    for path in own:
        if not path.is_file():
            what = "leads to no file" if path.is_symlink() else "is not a regular file"
            raise input_error(path, what, "remove it, or name the files themselves")
    video = folder.resolve().name
    return Images(str(paths[0] if len(own) == 1 else folder), video, _frames(own, video))


def _frames(paths: Sequence[Path], folder: str) -> list[Frame]:
    """Return files in order of videos and frames; `folder` is the name of a single video.

    The last number in a name is that of the frame. Names that differ in more than this number are
    of several videos, unless one of these would have a single frame: then each name is that of an
    image. Raises InputError where two files have the same number.
    """
    series: dict[tuple[str, str], dict[int, Path]] = {}
    parts = [_LAST_NUMBER.match(_stem(path)) for path in paths]
    for path, match in sorted(zip(paths, parts, strict=True), key=lambda each: each[0].name):
        if match is None:
            continue
        own, number = series.setdefault((match[1], match[3]), {}), int(match[2])
        if (other := own.setdefault(number, path)) is not path:
            found = f"two files of frame {number}, {other.name} and {path.name}"
            raise input_error(path.parent, found, "remove or rename one of them")
    if None in parts or (len(series) > 1 and any(len(own) == 1 for own in series.values())):
        images = sorted(paths, key=_natural)
        return [Frame(path, folder, place, _stem(path)) for place, path in enumerate(images)]
    names = [folder]
    if len(series) > 1:  # what files have before the number, where that differs
        names = [before.rstrip("._- ") for before, _ in series]
        if len({*names, ""}) <= len(series):
            names = [before + after for before, after in series]
    return [
        Frame(own[number], name, number - min(own), str(number))
        for name, own in zip(names, series.values(), strict=True)
        for number in sorted(own)
    ]


def _stem(path: Path) -> str:
    return path.name.rpartition(".")[0] or path.name


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Return a key by which 9 comes before 10."""
    pieces = _DIGITS.split(path.name)
    return [(0, int(piece), "") if piece.isdigit() else (1, 0, piece) for piece in pieces]


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


@dataclass
class Detections:
    """What grows while files are read, one entry for each detection.

    name and video as in a Poses; `several`, whether there are several videos; unordered,
    whether they are images of no video; numbers, x, y and the confidence of each landmark, empty
    where nothing was found; frames, or what the file calls the image until `in_images`; identities
    what the file calls who it is, None or a negative number where it does not know.
    """

    name: str
    video: str
    unordered: bool = False
    several: bool = False
    numbers: list[Sequence[float]] = field(default_factory=list)
    frames: list[Any] = field(default_factory=list)
    identities: list[Any] = field(default_factory=list)

    @classmethod
    def in_file(cls, path: Path) -> Self:
        """Begin with those of one file."""
        return cls(str(path), path.name.partition(".")[0])

    @classmethod
    def in_files(cls, images: Images) -> Self:
        """Begin with those of files of a frame each, of one video or several."""
        unordered = not all(frame.label.isdigit() for frame in images.frames)
        several = len({frame.video for frame in images.frames}) > 1
        return cls(images.name, images.video, unordered, several)

    def add(self, numbers: Sequence[float], frame: Any, who: Any) -> None:
        """Add a detection in a frame of a video, or an image, and whom the file calls it."""
        self.numbers.append(numbers)
        self.frames.append(frame)
        self.identities.append(who)

    def in_images(self, named: Iterable[tuple[Any, Any]] = ()) -> int:
        """Take the images that the file names for frames; return how many there are.

        They have the order of their first appearance, those `named` (id, what it is called)
        before, and their names without folder and ending where these are unique.
        """
        called = dict(named)
        for image in self.frames:
            called.setdefault(image, image)
        names = [
            Path(name).stem if isinstance(name, str) else str(name) for name in called.values()
        ]
        if len(set(names)) < len(names):
            names = list(map(str, called.values()))
        frames = enumerate(zip(called, names, strict=True))
        place = {image: Frame(Path(), self.video, at, name) for at, (image, name) in frames}
        self.frames = [place[image] for image in self.frames]
        self.unordered = not are_series(names)
        return len(called)

    def values(self) -> Floats:
        """Return the numbers (N, p, 3), NaN where a detection has none or they are not finite.

        Raises InputError where detections have different numbers of landmarks, and for texts.
        """
        sizes = Counter(map(len, filter(None, self.numbers)))
        if len(sizes) > 1:
            kinds = [f"{n} detections with {s // 3}" for s, n in sorted(sizes.items())]
            fix = "give the files of each skeleton in a separate call"
            raise input_error(
                self.name, f"several skeletons: {listed(kinds, 'and')} landmarks", fix
            )
        width = next(iter(sizes), 0)
        nothing = [math.nan] * width
        with parsing(self.name, CHECK):
            values = np.array([row or nothing for row in self.numbers], dtype=np.float64)
            values = values.reshape(len(self.numbers), width // 3, 3)
        return np.where(np.isfinite(values), values, np.nan)


def as_poses(
    detections: Detections,
    frames: int,
    values: Floats | None = None,
    missing: NDArray[np.bool_] | None = None,
    *,
    scored: bool = True,
    notes: tuple[str, ...] = (),
    **further: Any,
) -> Poses:
    """Return the poses of detections in so many frames.

    values (N, p, 3) are x, y and the confidence, by default those of the detections, and `missing`
    (N, p) by default those without confidence; the others say how sure they are where they are
    `scored`. Where nobody was found, the recording is empty and says so. `further` are fields of a
    Poses; without names landmarks are those of the skeleton that detectors mean by their
    number.
    """
    values = detections.values() if values is None else values
    missing = np.asarray(~(values[..., 2] > 0)) if missing is None else missing
    if not values.size:
        notes += (f"nobody was found in {counted(frames, 'frame')}",)
        values, missing = np.empty((0, 0, 3)), np.empty((0, 0), bool)
        scored, further = False, {"landmark_names": ()}
        detections = Detections(detections.name, detections.video)
    individuals, doubts = _identities(detections)
    usual = next(iter(skeletons_of_size(values.shape[1])), None)
    further.setdefault("skeleton", None if further.get("landmark_names") else usual)
    videos = [frame.video for frame in detections.frames]
    numbers = np.array([frame.number for frame in detections.frames], dtype=np.int64)
    weights = np.where(missing, 0.0, np.nan_to_num(values[..., 2]))
    first = {video: number for number, video in enumerate(dict.fromkeys(videos))}
    poses = Poses(
        name=detections.name,
        video=videos if detections.several else detections.video,
        points=np.where(missing[..., None], np.nan, values[..., :2]),
        confidence=weights if scored else None,
        frame=numbers,
        label=[frame.label for frame in detections.frames],
        individual=individuals,
        frame_count=frames,
        notes=notes + doubts,
        unit=further.pop("unit", "px"),
        unordered=detections.unordered,
        **further,
    )
    return poses.take(np.lexsort((numbers, np.array([first[video] for video in videos]))))


def _identities(detections: Detections) -> tuple[list[str], tuple[str, ...]]:
    """Return who each detection is, "" for nobody in particular, and doubts about that.

    Some tools number the people of each frame anew: where a number is twice in a frame, none is
    an identity.
    """
    ids = [_plain(one) for one in detections.identities]
    seen = Counter((frame[1:3], who) for frame, who in zip(detections.frames, ids, strict=True))
    if twice := sum(number > 1 for (_, who), number in seen.items() if who):
        text = f"numbers of people are not used, as {twice} of them occur twice in a frame"
        return [""] * len(ids), (text,)
    return ids, ()


def _plain(identity: Any) -> str:
    """Return an identity as text, "" for none: a number, a text, or a list of one of them."""
    while isinstance(identity, list) and len(identity) == 1:
        identity = identity[0]
    if isinstance(identity, bool) or not isinstance(identity, int | float | str):
        return ""
    if isinstance(identity, str):
        return identity
    return "" if identity < 0 or identity != identity else f"id {identity:g}"


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
