"""The header of a table of landmarks: which column holds what, in the layouts of several tools."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from shapefit.errors import printable

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
        "individual": "individual person person_id track track_id animal subject id",
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

OF_IMAGES = ("sequence", "item", "frame", "individual")
OF_POINTS = ("x", "y", "z", "confidence")

_AXIS = "x|y|z|likelihood|confidence|conf|score|visibility|prob"
_OF_LANDMARK = (
    re.compile(r"(?P<axis>x|y|z|visibility|v|c)_?(?P<number>[0-9]{1,9})", re.I),
    re.compile(rf"(?P<name>.+)[_.: -](?P<axis>{_AXIS}|v|c)", re.I),
    re.compile(rf"(?P<axis>{_AXIS})[_.: -](?P<name>.+)", re.I),
)
"""Columns of a wide table: x_12, nose_x, x_nose."""


@dataclass(frozen=True)
class Columns:
    """A header of no known tool as it was understood.

    roles: item, frame, sequence, individual, and in a long table landmark, x, y, z and confidence
    -> column;
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
        """The coordinates that there are columns for, and the confidence."""
        points = [self.roles] if self.landmarks is None else self.landmarks.values()
        return tuple(axis for axis in OF_POINTS if any(axis in columns for columns in points))

    def describe(self, rows: Sequence[Sequence[str]]) -> str:
        """Return some rows as they were understood."""
        columns = dict(self.roles)
        if self.landmarks is not None:
            name, axes = next(iter(self.landmarks.items()))
            columns |= {f"{axis} of {name}": column for axis, column in axes.items()}
        return "; ".join(
            ", ".join(f"{role} {printable(row[at])[:20]}" for role, at in columns.items())
            for row in rows
            if len(row) == len(self.names)
        )


def parse_header(line: str) -> Columns | None:
    """Return what the columns of a header hold; None where it is not that of a table of landmarks.

    A long table has columns landmark, x, y, and item or frame; a wide one has columns NAME_x and
    NAME_y, or x_NAME and y_NAME, of two landmarks at least.
    """
    for delimiter in sorted(DELIMITERS, key=line.count, reverse=True):
        try:
            cells = next(csv.reader([line], delimiter=delimiter), [])
        except csv.Error:
            return None
        names = tuple(cell.strip() for cell in cells)
        roles, others = _find_roles(dict(enumerate(names)))
        if {"landmark", "x", "y"} <= roles.keys() and {"item", "frame"} & roles.keys():
            return Columns(delimiter, names, roles, None, tuple(filter(None, others)))
        if (columns := _wide_columns(delimiter, names)) is not None:
            return columns
    return None


def _find_roles(names: Mapping[int, str]) -> tuple[dict[str, int], list[str]]:
    """Return the first column of each role, and the names of those without one."""
    roles: dict[str, int] = {}
    others = []
    for column, name in names.items():
        role = ROLES.get(name.lower().replace(" ", "_"))
        if role is None or role in roles:
            others.append(name)
        else:
            roles[role] = column
    if not {"item", "frame"} & roles.keys() and "individual" in roles:
        roles["item"] = roles.pop("individual")  # an id of each row or image
    return roles, others


def _wide_columns(delimiter: str, names: tuple[str, ...]) -> Columns | None:
    landmarks: dict[str, dict[str, int]] = {}
    rest: dict[int, str] = {}
    for column, name in enumerate(names):
        matches = (pattern.fullmatch(name) for pattern in _OF_LANDMARK)
        parts = next((match.groupdict() for match in matches if match), None)
        if parts is None:
            rest[column] = name
            continue
        landmark = parts.get("name") or str(int(parts["number"]))
        axis = ROLES.get(parts["axis"].lower(), "confidence")
        if axis in landmarks.setdefault(landmark, {}):
            return None
        landmarks[landmark][axis] = column
    placed = {name: axes for name, axes in landmarks.items() if {"x", "y"} <= axes.keys()}
    if len(placed) < 2:
        return None
    roles, others = _find_roles(rest)
    others += [name for name in landmarks if name not in placed]
    return Columns(
        delimiter,
        names,
        {role: column for role, column in roles.items() if role not in OF_POINTS},
        placed,
        tuple(name for name in others if name and not name.lower().startswith("unnamed")),
    )


def anipose_landmarks(columns: Iterable[str]) -> tuple[str, ...]:
    """Return the landmarks that have x, y, z and what anipose says of them, in order."""
    names = dict.fromkeys(columns)
    stems = dict.fromkeys(name[:-2] for name in names if name.endswith("_x") and len(name) > 2)
    return tuple(
        stem
        for stem in stems
        if {f"{stem}_y", f"{stem}_z"} <= names.keys()
        and names.keys() & {f"{stem}_ncams", f"{stem}_error", f"{stem}_score"}
    )
