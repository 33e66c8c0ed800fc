"""Photographs under the landmarks: found by their names, read, made smaller."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from shapefit.errors import counted, input_error
from shapefit.meshes.pictures import PlacedPhotograph
from shapefit.viewer.page import Picture

if TYPE_CHECKING:
    from PIL.Image import Image

MAX_PICTURE_BYTES = 14_000_000
"""Of all pictures of a page; of more, every n-th is shown."""

MAX_PICTURE_SIDE = 960
"""Pixels of the longest side of a picture on the page."""

SIZE_TOLERANCE = 0.1
"""Share by which the size of a picture may differ from that of the images.

The latter may be twice the principal point of a camera, which is near the middle.
"""

PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png")
LAST_NUMBER = re.compile(r"(\d{1,12})\D*$")

Size = tuple[float, float]
"""Width and height."""


def embed_photographs(
    folder: Path, items: Sequence[str], image: Sequence[float] | None
) -> tuple[dict[int, Picture], list[str]]:
    """Return frame -> picture, encoded as a page has it, and notes.

    image is the size of the images, where it is known. Raises InputError as
    `read_photographs`.
    """
    paths = find_photographs(folder, items)
    _, first = next(_encode_photographs(paths, image, []))
    step = 1 + len(paths) * len(first["data"]) // MAX_PICTURE_BYTES
    notes = [*notes_on_missing(folder, len(items), len(paths))]
    if step > 1:
        notes.append(f"One of {step} photographs is shown, so that the page is small.")
    chosen = {frame: paths[frame] for frame in list(paths)[::step]}
    return dict(_encode_photographs(chosen, image, notes)), notes


def _encode_photographs(
    paths: Mapping[int, Path], image: Sequence[float] | None, notes: list[str]
) -> Iterator[tuple[int, Picture]]:
    """Yield each frame and its photograph as an encoded Picture; append to `notes`.

    image and notes as in `read_photographs`.
    """
    for frame, photograph in read_photographs(paths, image, notes):
        data = BytesIO()
        photograph.pixels.save(data, "JPEG", quality=75)
        text = b64encode(data.getvalue()).decode()
        size = photograph.size
        yield frame, {"data": f"data:image/jpeg;base64,{text}", "size": size}


def read_photographs(
    paths: Mapping[int, Path], image: Sequence[float] | None, notes: list[str]
) -> Iterator[tuple[int, PlacedPhotograph]]:
    """Yield each frame with its photograph, at most `MAX_PICTURE_SIDE` pixels long.

    image: width and height of the images, if known. Photographs that cannot be read,
    and those of another shape than the images, are told in the notes at the end. Raises
    InputError where none can be read.
    """
    unreadable: list[str] = []
    odd: list[str] = []
    for frame, path in paths.items():
        pixels = _read_upright(path, unreadable)
        if pixels is None:
            continue
        width, height = pixels.size
        size = size_among_landmarks((width, height), image)
        if size is None:
            odd.append(f"{path.name}, {width} x {height}")
            size = (width, height)
        pixels.thumbnail((MAX_PICTURE_SIDE, MAX_PICTURE_SIDE))
        yield frame, PlacedPhotograph(pixels, size)
    if len(unreadable) == len(paths):
        fix = "give PNG or JPEG"
        raise input_error(
            "images", f"no photograph can be read, such as {unreadable[0]}", fix
        )
    if unreadable:
        number = counted(len(unreadable), "photograph")
        notes.append(f"{number} cannot be read, such as {unreadable[0]}.")
    if odd and image is not None:
        number = counted(len(odd), "photograph")
        notes.append(
            f"{number} not of the shape of the images, which are {image[0]:.0f} x"
            f" {image[1]:.0f}: landmarks may not lie on them, such as on {odd[0]}."
        )


def size_among_landmarks(own: Size, image: Sequence[float] | None) -> Size | None:
    """Return the size of a picture in the unit of the landmarks, None if it has none.

    A smaller or larger copy of the image covers the image; one of the same size keeps
    its own, as does a picture of images whose size is not known.
    """
    if image is None:
        return own
    factor = image[0] / own[0]
    if abs(factor * own[1] / image[1] - 1) > SIZE_TOLERANCE:
        return None
    return own if abs(factor - 1) < SIZE_TOLERANCE else (factor * own[0], image[1])


def _read_upright(path: Path, unreadable: list[str]) -> Image | None:
    """Read a photograph upright; where that fails, None, and why in `unreadable`."""
    from PIL import Image, ImageOps

    try:
        with Image.open(path, formats=("JPEG", "PNG")) as image:
            upright = ImageOps.exif_transpose(image)
            return upright.convert("RGB")
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        unreadable.append(f"{path.name} ({error})")
        return None


def find_photographs(folder: Path, items: Sequence[str]) -> dict[int, Path]:
    """Return frame -> file of its photograph, for the frames that have one.

    A file is called by the item, or by what follows its last slash; or else the files
    are the frames of a video, in the order of the numbers in their names, from 0.
    Raises InputError where there is no such folder, no photograph, and no Pillow.
    """
    if find_spec("PIL") is None:
        raise input_error(
            "images", "Pillow is not installed", "run `pip install pillow`"
        )
    if not folder.is_dir():
        raise input_error(
            "images", f"there is no folder {folder}", "name a folder of pictures"
        )
    files = [
        path for path in folder.rglob("*") if path.suffix.lower() in PICTURE_SUFFIXES
    ]
    paths = _files_by_name(folder, files, items) or _files_by_number(files, items)
    if not paths:
        fault = f"no item has an image, such as {folder / items[0]}.jpg"
        raise input_error("images", fault, "correct the path")
    return paths


def _files_by_name(
    folder: Path, files: Sequence[Path], items: Sequence[str]
) -> dict[int, Path]:
    """Return frame -> file whose name is the item of the frame."""
    by_name: dict[str, Path] = {}
    for path in files:
        by_name[str(path.relative_to(folder).with_suffix(""))] = path
    for path in files:  # a whole name tells more than one without its ending
        by_name[str(path.relative_to(folder))] = path
    paths = {}
    for frame, item in enumerate(items):
        found = by_name.get(item) or by_name.get(item.rpartition("/")[2])
        if found is not None:
            paths[frame] = found
    return paths


def _files_by_number(files: Sequence[Path], items: Sequence[str]) -> dict[int, Path]:
    """Return frame -> file, by the number at the end of its item, from 0."""
    numbered = [(last_number(path.stem), path) for path in files]
    video = [path for number, path in sorted(numbered) if number >= 0]
    places = {frame: last_number(item) for frame, item in enumerate(items)}
    return {
        frame: video[place]
        for frame, place in places.items()
        if 0 <= place < len(video)
    }


def last_number(text: str) -> int:
    """Return the last number of a text, -1 for none."""
    end = LAST_NUMBER.search(text)
    return int(end[1]) if end else -1


def notes_on_missing(folder: Path, items: int, photographs: int) -> Iterator[str]:
    """Yield a note where a folder has fewer photographs than there are items."""
    if photographs < items:
        lacking = counted(items - photographs, "frame")
        yield f"{lacking} of {items} without a photograph in {folder.name}."
