"""How files of trackers, of 3D points and of motion begin; HDF5 is opened once for all formats."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from shapefit.io.sources import BYTE_ORDER_MARK, HDF5_SIGNATURE
from shapefit.stores.opening import StoreError
from shapefit.stores.shelf import THREADS, State, find_state

C3D_BLOCK, C3D_MAGIC = 512, 0x50
"""Bytes of the header of C3D, and its second byte."""


def is_trc(_path: Path, head: bytes) -> bool:
    """Whether a file begins with the word that TRC begins with."""
    return head.removeprefix(BYTE_ORDER_MARK).lstrip()[:12].lower() == b"pathfiletype"


def is_bvh(_path: Path, head: bytes) -> bool:
    """Whether a file begins with the hierarchy of BVH."""
    words = head.removeprefix(BYTE_ORDER_MARK).split(maxsplit=2)
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
    first = head.removeprefix(BYTE_ORDER_MARK).partition(b"\n")[0].decode("utf-8", "replace")
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


OWN_FORMAT = "shapefit-"
"""What the root attribute `format` of our own HDF5 files begins with."""


@dataclass(frozen=True)
class Look:
    """What the root of an HDF5 file holds.

    entries     names of its groups and datasets
    attributes  names of the attributes of the root
    pandas      groups of the root that pandas wrote
    points      whether a group `poseest` has points
    processing  whether a group `processing` is not empty
    slp         whether `metadata` has the version of a SLEAP file
    """

    entries: frozenset[str] = frozenset()
    attributes: frozenset[str] = frozenset()
    pandas: tuple[str, ...] = ()
    points: bool = False
    processing: bool = False
    slp: bool = False


NOTHING = Look()


def look(path: Path, head: bytes) -> Look:
    """Return what an HDF5 file of others holds; nothing for all other files, and damaged ones."""
    if not head.startswith(HDF5_SIGNATURE):
        return NOTHING
    state = find_state(path)
    return NOTHING if state is None else _look(path, state)


@lru_cache(maxsize=THREADS)
def _look(path: Path, _state: State) -> Look:
    """Open a file; the same state of it is not opened again for the next recogniser."""
    from shapefit.io.hdf5.opening import open_hdf5

    try:
        with open_hdf5(path) as file:
            return _describe(file)
    except StoreError:
        raise
    except Exception:  # h5py has many kinds of error for damaged files; their reader names them
        return NOTHING


def _describe(file: Any) -> Look:
    root = file.attrs
    stated = root.get("format", "")
    if isinstance(stated, bytes):
        stated = stated.decode("utf-8", "replace")
    if isinstance(stated, str) and stated.startswith(OWN_FORMAT):
        return NOTHING
    entries = frozenset(file)
    return Look(
        entries=entries,
        attributes=frozenset(root),
        pandas=tuple(name for name in file if _is_pandas(file, name)),
        points="poseest" in entries and "points" in file["poseest"],
        processing="processing" in entries and len(file["processing"]) > 0,
        slp="metadata" in entries and "format_id" in file["metadata"].attrs,
    )


def _is_pandas(file: Any, name: str) -> bool:
    """Whether a link of the root leads to a group that pandas wrote."""
    found = file.get(name)
    return found is not None and "pandas_type" in found.attrs


def is_deeplabcut_hdf5(path: Path, head: bytes) -> bool:
    """Whether pandas wrote a table into the file."""
    return bool(look(path, head).pandas)


def is_jabs(path: Path, head: bytes) -> bool:
    """Whether the file has poseest/points."""
    return look(path, head).points


def is_movement(path: Path, head: bytes) -> bool:
    """Whether the file says which kind of movement's data sets it is."""
    return "ds_type" in look(path, head).attributes


def is_nwb(path: Path, head: bytes) -> bool:
    """Whether the file says which version of NWB it is."""
    found = look(path, head)
    return "nwb_version" in found.attributes or found.processing


def is_sleap_analysis(path: Path, head: bytes) -> bool:
    """Whether the file has tracks, and names of the nodes of a skeleton."""
    return {"tracks", "node_names"} <= look(path, head).entries


def is_sleap_labels(path: Path, head: bytes) -> bool:
    """Whether the file has metadata with the version of SLEAP's format, and frames."""
    found = look(path, head)
    return found.slp and {"frames", "instances"} <= found.entries


def is_deeplabcut_csv(_path: Path, head: bytes) -> bool:
    """Whether the first cell of the file is `scorer`, and one of the next lines begins `bodyparts`.

    A first line can be longer than what is seen of the file; then the first cell decides.
    """
    text = head.removeprefix(BYTE_ORDER_MARK)
    lines = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
    firsts = [line.split(b",", 1)[0].strip(b' "') for line in lines[:-1] or lines]
    if firsts[0] == b"scorer" and b"," in lines[0]:
        return len(firsts) < 3 or b"bodyparts" in firsts[1:3]
    return firsts[0] in (b"bodyparts", b"individuals") and b"coords" in firsts[1:3]
