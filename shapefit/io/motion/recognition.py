"""How files of 3D points and motion begin."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

BOM = b"\xef\xbb\xbf"

C3D_BLOCK, C3D_MAGIC = 512, 0x50
"""Bytes of the header of C3D, and its second byte."""


def is_trc(_path: Path, head: bytes) -> bool:
    """Whether a file begins with the word that TRC begins with."""
    return head.removeprefix(BOM).lstrip()[:12].lower() == b"pathfiletype"


def is_bvh(_path: Path, head: bytes) -> bool:
    """Whether a file begins with the hierarchy of BVH."""
    words = head.removeprefix(BOM).split(maxsplit=2)
    return [word.upper() for word in words[:2]] == [b"HIERARCHY", b"ROOT"]


def is_acclaim(path: Path, head: bytes) -> bool:
    """Whether a file is named like ASF or AMC, and has lines as they have."""
    if path.suffix.lower() not in (".asf", ".amc"):
        return False
    return b"\0" not in head and any(
        line.lstrip()[:1] in (b":", b"#") for line in head.split(b"\n")
    )


def is_anipose_csv(_path: Path, head: bytes) -> bool:
    """Whether the first line has columns NAME_x, NAME_y, NAME_z and NAME_ncams or the like."""
    first = head.removeprefix(BOM).partition(b"\n")[0].decode("utf-8", "replace")
    return bool(find_landmarks(split_columns(first)))


def is_c3d(path: Path, head: bytes) -> bool:
    """Whether a file begins like C3D: where its parameters are, 0x50, and numbers that agree."""
    if len(head) < C3D_BLOCK or head[1] != C3D_MAGIC or head[0] == 0:
        return False
    if path.suffix.lower() == ".c3d":
        return True
    points, _, first, last = struct.unpack("<HHHH", head[2:10])
    start = struct.unpack("<H", head[16:18])[0]
    return 0 < points < 1024 and 0 < first <= last and 1 < start < 1024 and head[0] < 8


def is_mesh(path: Path, head: bytes) -> bool:
    """Whether a file begins like PLY or binary glTF, or is named and has lines like OBJ."""
    if head.startswith((b"ply\n", b"ply\r", b"glTF")):
        return True
    return path.suffix.lower() == ".obj" and any(
        line.startswith((b"v ", b"#", b"o ", b"mtllib ", b"g ")) for line in head.split(b"\n")
    )


def split_columns(line: str) -> list[str]:
    """Return the names of the columns in a header."""
    return [cell.strip().strip('"') for cell in line.split(",")]


def find_landmarks(columns: Sequence[str]) -> tuple[str, ...]:
    """Return the landmarks that have x, y, z and what anipose says of them, in order."""
    known = set(columns)
    names = [column[:-2] for column in columns if column.endswith("_x") and len(column) > 2]
    return tuple(
        name
        for name in dict.fromkeys(names)
        if {f"{name}_y", f"{name}_z"} <= known
        and known & {f"{name}_ncams", f"{name}_error", f"{name}_score"}
    )
