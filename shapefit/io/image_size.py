"""Width and height of an image file, from its header alone."""

from __future__ import annotations

import struct
from pathlib import Path

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")

_PNG = b"\x89PNG\r\n\x1a\n"
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
"""Markers of JPEG that begin a frame: height and width follow them."""


def read_image_size(path: Path) -> tuple[int, int] | None:
    """Return width and height in pixels of a PNG or JPEG; None for what is no such image."""
    try:
        with path.open("rb") as file:
            head = file.read(24)
            if head.startswith(_PNG) and head[12:16] == b"IHDR":
                width, height = struct.unpack(">II", head[16:24])
                return (width, height) if width and height else None
            if not head.startswith(b"\xff\xd8"):
                return None
            file.seek(2)
            while True:
                start, marker, length = struct.unpack(">BBH", file.read(4))
                if start != 0xFF or length < 2:
                    return None
                if marker in _FRAMES:
                    _, height, width = struct.unpack(">BHH", file.read(5))
                    return (width, height) if width and height else None
                file.seek(length - 2, 1)
    except (OSError, struct.error):
        return None
