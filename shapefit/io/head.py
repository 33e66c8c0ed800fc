"""What a file begins with, looked at once: bytes, lines, columns, keys of JSON and of HDF5."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

from shapefit.errors import InputError, abbreviate, input_error, printable
from shapefit.io.inputs import BYTE_ORDER_MARK, HDF5_SIGNATURE, read_head

HEAD_BYTES = 4096
"""Of a file that decide its format."""

OWN_FORMAT = "shapefit-"
"""What the root attribute `format` of our own HDF5 files begins with."""

FIRST_FILES = 20
"""Of a folder that are looked at."""


@dataclass(frozen=True)
class JsonKeys:
    """The keys that JSON begins with.

    kind is { or [, "" where it is no JSON; keys are those of the outermost object, or of the
    objects in the outermost list; points says whether the keypoints of the first of these are
    pairs or flat, where they are so many that no other key is seen.
    """

    kind: str = ""
    keys: frozenset[str] = frozenset()
    points: Literal["pairs", "flat", ""] = ""


@dataclass(frozen=True)
class Hdf5Keys:
    """What the root of an HDF5 file of another tool holds; nothing for ours, and damaged ones.

    entries     names of its groups and datasets
    attributes  names of the attributes of the root
    pandas      groups of the root that pandas wrote
    inner       "group/name" of what the groups poseest, processing and metadata hold, and
                "group@name" of their attributes
    """

    entries: frozenset[str] = frozenset()
    attributes: frozenset[str] = frozenset()
    pandas: tuple[str, ...] = ()
    inner: frozenset[str] = frozenset()


class Head:
    """What decides the format of a file, or of a folder; each part is looked at once."""

    def __init__(self, path: Path) -> None:
        """Read the first bytes; those of a folder are none. Raises what reading raises."""
        self.path = path
        self.is_folder = path.is_dir()
        self.bytes = b"" if self.is_folder else read_head(path, HEAD_BYTES)

    def named(self, *endings: str) -> bool:
        """Whether the name of the file has one of these endings."""
        return self.path.name.lower().endswith(endings)

    @cached_property
    def text(self) -> bytes:
        """The first bytes without the mark that text in UTF-8 may begin with."""
        return self.bytes.removeprefix(BYTE_ORDER_MARK)

    @cached_property
    def lines(self) -> list[bytes]:
        """The first lines, whatever ends them; the last may be cut."""
        return self.text.replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")

    @cached_property
    def columns(self) -> frozenset[str]:
        """The cells of the first line, parted by commas, without spaces and quotes."""
        cells = self.lines[0].decode("utf-8", "replace").split(",")
        return frozenset(cell.strip(' "\t') for cell in cells)

    @cached_property
    def json(self) -> JsonKeys:
        """The keys that JSON begins with."""
        return find_json_keys(self.text)

    @cached_property
    def hdf5(self) -> Hdf5Keys:
        """What the root of an HDF5 file of another tool holds."""
        if not self.bytes.startswith(HDF5_SIGNATURE):
            return Hdf5Keys()
        return find_hdf5_keys(self.path)

    def files(self, ending: str) -> Iterator[Head]:
        """Yield the heads of the first files of a folder with this ending, by name."""
        if not self.is_folder:
            return
        names = sorted(name for name in os.listdir(self.path) if name.lower().endswith(ending))
        for name in names[:FIRST_FILES]:
            path = self.path / name
            if path.is_file() and os.access(path, os.R_OK):
                yield Head(path)


_NUMBERS = re.compile(rb"[-+\d.eE,\s]{8,}")
_TOKENS = re.compile(rb'"((?:[^"\\]|\\.)*)"\s*(:?)|[{}\[\]]', re.DOTALL)
_KEYPOINTS = re.compile(rb'\[\s*\{\s*"keypoints"\s*:\s*\[\s*([-\d\[])')


def find_json_keys(data: bytes) -> JsonKeys:
    """Return the keys in the first bytes of a file, which may end anywhere."""
    text = data.lstrip()
    if text[:1] not in (b"{", b"["):
        return JsonKeys()
    kind = text[:1].decode()
    level, depth, keys = (1 if kind == "{" else 2), 0, set()
    for token in _TOKENS.finditer(_NUMBERS.sub(b" ", text)):
        mark = token[0][:1]
        if mark in b"{[":
            depth += 1
        elif mark in b"}]":
            depth -= 1
        elif token[2] and depth == level:
            keys.add(token[1].decode("utf-8", "replace"))
    found = _KEYPOINTS.match(text) if keys == {"keypoints"} else None
    if found is None:
        return JsonKeys(kind, frozenset(keys))
    return JsonKeys(kind, frozenset(keys), "pairs" if found[1] == b"[" else "flat")


def find_hdf5_keys(path: Path) -> Hdf5Keys:
    """Open an HDF5 file, and return what its root holds."""
    from shapefit.io.hdf5_file import as_text, open_hdf5

    try:
        with open_hdf5(path) as file:
            if str(as_text(file.attrs.get("format", ""))).startswith(OWN_FORMAT):
                return Hdf5Keys()
            groups = {name: file.get(name) for name in file}
            inner: set[str] = set()
            for name in ("poseest", "processing", "metadata"):
                if (group := groups.get(name)) is not None:
                    inner |= {f"{name}@{each}" for each in group.attrs}
                    inner |= {f"{name}/{each}" for each in getattr(group, "keys", tuple)()}
            there = [(name, one.attrs) for name, one in groups.items() if one is not None]
            pandas = tuple(name for name, attributes in there if "pandas_type" in attributes)
            return Hdf5Keys(frozenset(groups), frozenset(file.attrs), pandas, frozenset(inner))
    except Exception:  # h5py has many kinds of error for damaged files; their reader names them
        return Hdf5Keys()


OF_A_DETECTOR = "give the file of landmarks that a detector made of it"

UNSUPPORTED: tuple[tuple[str, str, tuple[bytes, ...]], ...] = (
    ("is compressed", "unpack it first", (b"\x1f\x8b", b"BZh", b"\xfd7zXZ\0", b"\x28\xb5\x2f\xfd")),
    (
        "is a zip archive, as models of PyTorch are, too",
        "give a file of landmarks",
        (b"PK\x03\x04",),
    ),
    (
        "is a pickle of Python, which is never executed here",
        "give the CSV or HDF5 file that its program exports",
        tuple(bytes([128, protocol]) for protocol in range(2, 6)),
    ),
    ("is a file of MATLAB", "export its points as CSV", (b"MATLAB ",)),
    ("is netCDF 3", "write it as netCDF 4: to_netcdf(..., engine='h5netcdf')", (b"CDF",)),
    ("is a video, or a part of one", OF_A_DETECTOR, (b"RIFF", b"\x1aE\xdf\xa3")),
    (
        "is Parquet",
        "write it as CSV: pandas.read_parquet(...).to_csv(..., index=False)",
        (b"PAR1",),
    ),
    ("is a mesh", "give its landmarks as a table (docs/cars.md)", (b"ply\n", b"ply\r", b"glTF")),
    ("is an image", OF_A_DETECTOR, (b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"BM")),
)
"""What a file is, the fix, and the first bytes that such files have."""


def unsupported_file(head: Head) -> InputError | None:
    """Return the error for a file whose first bytes say what else it is; None without such."""
    if head.bytes[4:8] in (b"ftyp", b"moov", b"mdat"):
        return input_error(head.path, "is a video, or a part of one", OF_A_DETECTOR)
    for found, fix, starts in UNSUPPORTED:
        if head.bytes.startswith(starts) and not _is_text(head.bytes):
            return input_error(head.path, found, fix)
    return None


def _is_text(data: bytes) -> bool:
    """Whether bytes are the beginning of a text; the last letter may be cut."""
    try:
        data.decode()
    except UnicodeDecodeError as error:
        return error.start > len(data) - 4 and b"\0" not in data
    return b"\0" not in data


def unknown_json(head: Head) -> InputError:
    """Return the error for JSON that is in no known format: what it has, and what is known."""
    keys = head.json.keys
    place = "an object" if head.json.kind == "{" else "a list of objects"
    found = f"{place} with {abbreviate(sorted(keys))}" if keys else f"{place} without names"
    fix = (
        "give what OpenPose (version, people), AlphaPose, MMPose (instances) or MediaPipe write, "
        "COCO annotations (images, annotations, categories) or COCO results (image_id, keypoints)"
    )
    if {"shapes", "imagePath"} <= keys:
        fix = "it is LabelMe's: export it as COCO keypoints"
    return input_error(head.path, f"is JSON of no known kind, {found}", fix)


DELIMITERS = (",", ";", "\t")


def decode(data: bytes) -> str:
    """Return text in UTF-8 (with a mark or without), UTF-16 with a mark, or else Latin-1."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", "replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


ROLES: Mapping[str, str] = {
    name: role
    for role, names in {
        "item": "item image filename file file_name image_name image_id img",
        "frame": "frame frame_id frame_idx frame_index frame_number frame_no fnum",
        "sequence": "sequence video clip session",
        "landmark": "landmark joint bodypart body_part keypoint part node marker landmark_name "
        "joint_name keypoint_name landmark_id joint_id keypoint_id landmark_index",
        "x": "x x_px px",
        "y": "y y_px py",
        "z": "z",
        "confidence": "confidence conf likelihood score visibility probability prob v c",
    }.items()
    for name in names.split()
}
"""Name of a column, in small letters and with _ for spaces -> what it holds."""

OF_A_POINT = ("x", "y", "z", "confidence")

_NAMED = re.compile(
    r"(.+)[_.: -](x|y|z|likelihood|confidence|conf|score|visibility|prob|v|c)", re.I
)
_NUMBERED = re.compile(r"(x|y|z|visibility|v|c)_?([0-9]{1,9})", re.I)


@dataclass(frozen=True)
class Columns:
    """A header of no known tool as it was understood.

    roles: item, frame, sequence, and in a long table landmark, x, y, z and confidence -> column;
    landmarks: of a wide table, in order: role -> column for each name, None for a long table;
    others: names left out.
    """

    delimiter: str
    names: tuple[str, ...]
    roles: Mapping[str, int]
    landmarks: Mapping[str, Mapping[str, int]] | None
    others: tuple[str, ...]

    @property
    def axes(self) -> tuple[str, ...]:
        """The coordinates that there are columns for."""
        points = [self.roles] if self.landmarks is None else self.landmarks.values()
        return ("x", "y", "z") if any("z" in each for each in points) else ("x", "y")

    def describe(self, rows: Sequence[Sequence[str]]) -> str:
        """Return some rows as they were understood."""
        taken = dict(self.roles)
        if self.landmarks is not None:
            name, own = next(iter(self.landmarks.items()))
            taken |= {f"{role} of {name}": at for role, at in own.items()}
        shown = [
            ", ".join(f"{role} {printable(row[at])[:20]}" for role, at in taken.items())
            for row in rows
            if len(row) == len(self.names)
        ]
        return "; ".join(shown)


def parse_header(line: str) -> Columns | None:
    """Return what the columns of a header hold; None where it is not that of a table of landmarks.

    A long table has columns landmark, x, y, and item or frame; a wide one has columns NAME_x and
    NAME_y of two landmarks at least.
    """
    for delimiter in sorted(DELIMITERS, key=line.count, reverse=True):
        try:
            cells = next(csv.reader([line], delimiter=delimiter), [])
        except csv.Error:
            return None
        names = tuple(cell.strip() for cell in cells)
        found = _long_columns(delimiter, names) or _wide_columns(delimiter, names)
        if found is not None:
            return found
    return None


def _roles(names: Sequence[str]) -> tuple[dict[str, int], list[str]]:
    """Return the first column of each role, and the names of those without one."""
    roles: dict[str, int] = {}
    others = []
    for column, name in enumerate(names):
        role = ROLES.get(name.lower().replace(" ", "_"))
        if role is None or role in roles:
            others.append(name)
        else:
            roles[role] = column
    return roles, others


def _long_columns(delimiter: str, names: tuple[str, ...]) -> Columns | None:
    roles, others = _roles(names)
    if not {"landmark", "x", "y"} <= roles.keys() or not {"item", "frame"} & roles.keys():
        return None
    return Columns(delimiter, names, roles, None, tuple(filter(None, others)))


def _wide_columns(delimiter: str, names: tuple[str, ...]) -> Columns | None:
    landmarks: dict[str, dict[str, int]] = {}
    rest: dict[int, str] = {}
    for column, name in enumerate(names):
        numbered, named = _NUMBERED.fullmatch(name), _NAMED.fullmatch(name)
        if numbered:
            role, landmark = numbered[1], str(int(numbered[2]))
        elif named:
            landmark, role = named[1], named[2]
        else:
            rest[column] = name
            continue
        role = ROLES.get(role.lower(), "confidence")
        if role in landmarks.setdefault(landmark, {}):
            return None
        landmarks[landmark][role] = column
    whole = {name: own for name, own in landmarks.items() if {"x", "y"} <= own.keys()}
    if len(whole) < 2:
        return None
    roles, others = _roles(list(rest.values()))
    places = list(rest)
    roles = {role: places[at] for role, at in roles.items() if role not in OF_A_POINT}
    others += [name for name in landmarks if name not in whole]
    left = tuple(name for name in others if name and not name.lower().startswith("unnamed"))
    return Columns(delimiter, names, roles, whole, left)


def anipose_landmarks(columns: Iterable[str]) -> tuple[str, ...]:
    """Return the landmarks that have x, y, z and what anipose says of them, in order."""
    names = list(columns)
    known = set(names)
    stems = dict.fromkeys(name[:-2] for name in names if name.endswith("_x") and len(name) > 2)
    return tuple(
        stem
        for stem in stems
        if {f"{stem}_y", f"{stem}_z"} <= known
        and known & {f"{stem}_ncams", f"{stem}_error", f"{stem}_score"}
    )
