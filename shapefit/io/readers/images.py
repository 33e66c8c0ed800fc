"""Which images files are of: their videos, and their places in these, by numbers in names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from shapefit.errors import input_error


class Images(NamedTuple):
    """The images of a recording, in order: their labels, videos, and positions in these (n).

    name is for messages; `unordered` images are, as far as names say, no frames of a video.
    """

    name: str
    labels: Sequence[str]
    videos: Sequence[str]
    frames: Sequence[int]
    unordered: bool = False


def number_images(path: Path, video: str, labels: Sequence[str]) -> Images:
    """Return the frames of a file of one video."""
    return Images(str(path), labels, [video] * max(len(labels), 1), range(len(labels)))


def name_images(path: Path, names: Sequence[Any]) -> Images:
    """Return the images of a file, called without folder and ending where that tells them apart."""
    stems = [Path(name).stem if isinstance(name, str) else str(name) for name in names]
    labels = stems if len({*stems}) == len(stems) else [*map(str, names)]
    images = number_images(path, path.name.partition(".")[0], labels)
    return images._replace(unordered=not are_series(labels))


_LAST_NUMBER = re.compile(r"^(.*?)([0-9]{1,18})([^0-9]*)$", re.DOTALL)


def are_series(names: Sequence[str]) -> bool:
    """Whether names differ in one number, by which they can be the frames of a video.

    Then there are less than 100 numbers from the least to the largest for each name.
    """
    matches = [match for name in names if (match := _LAST_NUMBER.match(name))]
    numbers = {int(match[2]) for match in matches}
    if len({(m[1], m[3]) for m in matches}) > 1 or len(numbers) < len(names):
        return False
    return not numbers or max(numbers) - min(numbers) < 100 * len(numbers)


def find_images(paths: Sequence[Path], suffix: str, but: str = "") -> tuple[Sequence[Path], Images]:
    """Return the files of a folder that is given as a whole, but for one, or these files, in order.

    The last number in a name is that of the frame. Names that differ in more than this number are
    of several videos, unless one of these would have a single frame: then each name is that of an
    image. Raises InputError for two files of one frame, and for links that lead nowhere, pipes and
    devices in a folder, which cannot be read whole.
    """
    folder, files = paths[0].parent, list(paths)
    if paths[0].is_dir():
        folder = paths[0]
        files = [f for f in folder.iterdir() if f.name.lower().endswith(suffix) and f.name != but]
        files = [file for file in files if not file.is_dir()]
    for file in files:
        if not file.is_file():
            problem = "leads to no file" if file.is_symlink() else "is not a regular file"
            raise input_error(file, problem, "remove it, or name the files themselves")
    name, video = str(paths[0] if len(files) == 1 else folder), folder.resolve().name
    files.sort(
        key=lambda file: [  # 9 stands before 10
            (False, int(piece), "") if piece.isdigit() else (True, 0, piece)
            for piece in re.split(r"([0-9]+)", file.name)
        ]
    )
    stems = [file.name.rpartition(".")[0] or file.name for file in files]
    series: dict[tuple[str, str], dict[int, Path]] = {}
    for file, stem in sorted(zip(files, stems, strict=True), key=lambda pair: pair[0].name):
        if match := _LAST_NUMBER.match(stem):
            numbered = series.setdefault((match[1], match[3]), {})
            if (other := numbered.setdefault(int(match[2]), file)) is not file:
                problem = f"two files of frame {int(match[2])}, {other.name} and {file.name}"
                raise input_error(folder, problem, "remove or rename one of them")
    counts = [len(numbered) for numbered in series.values()]
    if sum(counts) < len(files) or (len(counts) > 1 and 1 in counts):
        images = Images(name, stems, [video] * len(files), range(len(files)), unordered=True)
        return files, images._replace(unordered=not all(map(str.isdigit, stems)))
    names = [video]
    if len(series) > 1:  # what files have before the number, where that differs
        names = [before.rstrip("._- ") for before, _ in series]
        if len({*names, ""}) <= len(series):
            names = [before + after for before, after in series]
    rows = [
        (numbered[number], str(number), name, number - min(numbered))
        for name, numbered in zip(names, series.values(), strict=True)
        for number in sorted(numbered)
    ]
    files, labels, videos, frames = map(list, zip(*rows, strict=True)) if rows else ([], [], [], [])
    return files, Images(name, labels, videos or [video], frames)
