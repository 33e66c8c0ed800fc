"""The pictures under the landmarks: found by item, made small enough, embedded as JPEG."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Sequence
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path

from shapefit.errors import input_error
from shapefit.viewer.scene import Picture

MEGABYTES = 20
"""Largest page; of more frames than fit, every n-th is shown."""
SHARE_OF_PICTURES = 0.7
"""Most of a page that pictures take; of more, every n-th is shown."""
LONGEST_SIDE = 960
"""Pixels of the longest side of a picture on the page."""
QUALITY = 75
SUFFIXES = (".jpg", ".jpeg", ".png")
LAST_NUMBER = re.compile(r"(\d{1,12})\D*$")
PLACEHOLDER = "{item}"


def embed_images(images: Path, items: Sequence[str]) -> dict[int, Picture]:
    """Return the pictures of the frames that have one.

    In a folder, a file is called by the item, or by what follows its last slash; or else the files
    are the frames of a video, in the order of the numbers in their names, from 0. Raises InputError
    where there is no such folder, no image, no Pillow, and for what is no image.
    """
    if find_spec("PIL") is None:
        raise input_error("images", "Pillow is not installed", "run `pip install pillow`")
    if PLACEHOLDER not in str(images) and not images.is_dir():
        fix = f"name a folder, or a path with {PLACEHOLDER}"
        raise input_error("images", f"there is no folder {images}", fix)
    paths = {frame: _candidates(images, item) for frame, item in enumerate(items)}
    files = {f: next((p for p in each if p.is_file()), None) for f, each in paths.items()}
    found = {frame: path for frame, path in files.items() if path} or _numbered(images, items)
    if not found:
        tried = ", ".join(map(str, paths[0]))
        raise input_error("images", f"no item has an image, such as {tried}", "correct the path")
    first = _embed(next(iter(found.values())))
    step = 1 + int(len(found) * len(first.data) / (SHARE_OF_PICTURES * MEGABYTES * 1e6))
    return {frame: _embed(found[frame]) for frame in list(found)[::step]}


def _candidates(images: Path, item: str) -> list[Path]:
    """Return where the image of an item may be; never outside of the folder that the user named."""
    names = [n for n in dict.fromkeys((item, item.rpartition("/")[2])) if "\0" not in n]
    inside = [n for n in names if not Path(n).is_absolute() and ".." not in Path(n).parts]
    if PLACEHOLDER in str(images):
        return [Path(str(images).replace(PLACEHOLDER, name)) for name in inside]
    return [images / f"{name}{suffix}" for name in inside for suffix in ("", *SUFFIXES)]


def _numbered(folder: Path, items: Sequence[str]) -> dict[int, Path]:
    """Return the n-th numbered file for each item that ends in the number n, from 0."""
    if PLACEHOLDER in str(folder):
        return {}
    files = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES]
    numbered = [(int(end[1]), path) for path in files if (end := LAST_NUMBER.search(path.stem))]
    ordered = dict(enumerate(path for _, path in sorted(numbered)))
    ends = {frame: LAST_NUMBER.search(item) for frame, item in enumerate(items)}
    numbers = {frame: int(end[1]) for frame, end in ends.items() if end}
    return {frame: ordered[number] for frame, number in numbers.items() if number in ordered}


def _embed(path: Path) -> Picture:
    """Return an image as the page holds it. Raises InputError for what is no image."""
    from PIL import Image

    data = BytesIO()
    try:
        with Image.open(path, formats=("JPEG", "PNG")) as image:
            size = image.size
            image.draft("RGB", (LONGEST_SIDE, LONGEST_SIDE))
            small = image.convert("RGB")
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        fault = f"cannot be read as an image ({error})"
        raise input_error(path, fault, "give PNG or JPEG, or leave it out") from error
    small.thumbnail((LONGEST_SIDE, LONGEST_SIDE))
    small.save(data, "JPEG", quality=QUALITY)
    return Picture(f"data:image/jpeg;base64,{b64encode(data.getvalue()).decode()}", size)
