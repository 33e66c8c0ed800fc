"""The pictures under the landmarks: found by item, made small enough, embedded as JPEG."""

from __future__ import annotations

import re
from base64 import b64encode
from collections.abc import Sequence
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

from shapefit.errors import input_error

MOST_BYTES = 14_000_000
"""Of all pictures of a page; of more, every n-th is shown."""
LONGEST_SIDE = 960
"""Pixels of the longest side of a picture on the page."""
QUALITY = 75
SUFFIXES = (".jpg", ".jpeg", ".png")
Picture = dict[str, Any]
"""A data URL, and the size in the pixels of the file."""
LAST_NUMBER = re.compile(r"(\d{1,12})\D*$")


def embed_images(folder: Path, items: Sequence[str]) -> dict[int, Picture]:
    """Return the pictures of the frames that have one.

    A file is called by the item, or by what follows its last slash; or else the files are the
    frames of a video, in the order of the numbers in their names, from 0. Raises InputError where
    there is no such folder, no image, no Pillow, and for what is no image.
    """
    if find_spec("PIL") is None:
        raise input_error("images", "Pillow is not installed", "run `pip install pillow`")
    if not folder.is_dir():
        raise input_error("images", f"there is no folder {folder}", "name a folder of pictures")
    files = {p.relative_to(folder): p for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES}
    by_name = {str(name.with_suffix("")): path for name, path in files.items()}
    by_name |= {str(name): path for name, path in files.items()}
    paths: dict[int, Path] = {}
    for frame, item in enumerate(items):
        path = by_name.get(item) or by_name.get(item.rpartition("/")[2])
        paths |= {frame: path} if path else {}
    paths = paths or _numbered(list(files.values()), items)
    if not paths:
        fault = f"no item has an image, such as {folder / items[0]}.jpg"
        raise input_error("images", fault, "correct the path")
    first = _embed(next(iter(paths.values())))
    step = 1 + int(len(paths) * len(first["data"]) / MOST_BYTES)
    return {frame: _embed(paths[frame]) for frame in list(paths)[::step]}


def _numbered(files: Sequence[Path], items: Sequence[str]) -> dict[int, Path]:
    """Return the n-th numbered file for each item that ends in the number n, from 0."""
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
    text = b64encode(data.getvalue()).decode()
    return {"data": f"data:image/jpeg;base64,{text}", "size": size}
