"""Files of one frame each: which are one recording, their videos, frames and order."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from shapefit.errors import input_error

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
