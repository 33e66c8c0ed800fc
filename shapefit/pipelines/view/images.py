"""The pictures under the landmarks: found by item, made small enough, embedded as JPEG."""

from __future__ import annotations

import os
import re
from base64 import b64encode
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path

from shapefit.errors import input_error
from shapefit.viewer.scene import Picture

MEGABYTES = 20
"""Largest page; of more frames than fit, every n-th is shown."""
LONGEST_SIDE = 960
"""Pixels of the longest side of a picture on the page."""
QUALITY = 75
SHARE_OF_PICTURES = 0.7
"""Most of a page that pictures take."""
SUFFIXES = (".jpg", ".jpeg", ".png")
LAST_NUMBER = re.compile(r"(\d{1,12})\D*$")
PLACEHOLDER = "{item}"


def embed_images(images: Path, items: Sequence[str]) -> dict[int, Picture]:
    """Return the pictures of the frames that have one, every n-th where all are too large.

    Raises InputError as `_find_images`, and for what is no image.
    """
    files = _find_images(images, items)
    room = SHARE_OF_PICTURES * MEGABYTES * 1e6
    first = _embed(next(iter(files.values())))
    step = max(1, -int(-len(files) * len(first.data) // room))
    pictures: dict[int, Picture] = {}
    for frame in list(files)[::step]:
        pictures[frame] = _embed(files[frame])
        room -= len(pictures[frame].data)
        if room < 0:
            break
    return pictures


def _find_images(images: Path, items: Sequence[str]) -> dict[int, Path]:
    """Return the image file of each frame that has one.

    In a folder, the file is called by the item, or by what follows its last slash; or else the
    files are the frames of a video, in the order of the numbers in their names. Raises InputError
    where there is no such folder, no image at all, or no Pillow to read one.
    """
    if find_spec("PIL") is None:
        fix = "install it with `pip install pillow`, or leave `images` out"
        raise input_error("images", "Pillow is not installed", fix)
    pattern = str(images)
    if PLACEHOLDER not in pattern and not os.path.isdir(images):
        fix = f"name a folder, or a path with {PLACEHOLDER}"
        raise input_error("images", f"there is no folder {images}", fix)
    found: dict[int, Path] = {}
    for frame, item in enumerate(items):
        path = next((p for p in _candidates(images, item) if os.path.isfile(p)), None)
        if path is not None:
            found[frame] = path
    if not found and PLACEHOLDER not in pattern:
        found = _numbered(images, items)
    if not found:
        tried = ", ".join(str(path) for path in _candidates(images, items[0]))
        raise input_error("images", f"no item has an image, such as {tried}", "correct the path")
    return found


def _numbered(folder: Path, items: Sequence[str]) -> dict[int, Path]:
    """Return the n-th numbered file for each item that ends in the number n, from 0."""
    files = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES]
    numbers = {path: LAST_NUMBER.findall(path.stem) for path in files}
    ordered = sorted((int(found[0]), path) for path, found in numbers.items() if found)
    wanted = ((frame, LAST_NUMBER.findall(item)) for frame, item in enumerate(items))
    return {
        frame: ordered[int(found[0])][1]
        for frame, found in wanted
        if found and int(found[0]) < len(ordered)
    }


def _embed(path: Path) -> Picture:
    """Return an image as the page holds it. Raises InputError for what is no image."""
    from PIL import Image

    try:
        with Image.open(path, formats=("JPEG", "PNG")) as image:
            size = image.size
            image.draft("RGB", (LONGEST_SIDE, LONGEST_SIDE))
            small = image.convert("RGB")
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        found = f"cannot be read as an image ({error})"
        raise input_error(path, found, "give PNG or JPEG, or leave it out") from error
    small.thumbnail((LONGEST_SIDE, LONGEST_SIDE))
    data = BytesIO()
    small.save(data, "JPEG", quality=QUALITY)
    text = b64encode(data.getvalue()).decode("ascii")
    return Picture(f"data:image/jpeg;base64,{text}", size)


def _candidates(images: Path, item: str) -> Iterator[Path]:
    """Yield where the image of an item may be; never outside of the folder that the user named."""
    pattern = str(images)
    for name in dict.fromkeys((item, item.rpartition("/")[2])):
        if os.path.isabs(name) or ".." in Path(name).parts or "\0" in name:
            continue
        if PLACEHOLDER in pattern:
            yield Path(pattern.replace(PLACEHOLDER, name))
        else:
            yield from (images / f"{name}{suffix}" for suffix in ("", *SUFFIXES))
