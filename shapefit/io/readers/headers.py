"""What the columns of a table hold, by their names: a row per image, or per landmark.

A *wide* table has columns NAME_x and NAME_y, or x_NAME and y_NAME, or x1 and y1; a
*long* one has the columns landmark, x and y. Names are read in any case.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Mapping, Sequence
from difflib import get_close_matches
from typing import NamedTuple

from shapefit.io.formats import INDIVIDUALS
from shapefit.io.readers.poses import library_reads

ROLES: Mapping[str, str] = {
    name: role
    for role, names in {
        "item": (
            "item image filename file file_name image_name image_id img specimen"
            " specimen_id sample sample_id"
        ),
        "frame": (
            "frame frame# #frame frames frame_id frame_idx frame_index frame_number"
            " frame_no frame_num frameid frameindex frame_nr fnum"
        ),
        "time": "time timestamp time_s time_(s) time_seconds seconds frame_time",
        "sequence": "sequence video clip session port cam_id",
        "individual": " ".join([*INDIVIDUALS, "face_id"]),
        "landmark": (
            "landmark joint bodypart body_part keypoint part node marker landmark_name"
            " joint_name keypoint_name landmark_id joint_id keypoint_id landmark_index"
            " point_id"
        ),
        "x": "x x_px px img_loc_x",
        "y": "y y_px py img_loc_y",
        "z": "z",
        "confidence": (
            "confidence conf likelihood score visibility probability prob v c"
        ),
        "visible": "visible vis is_visible",
        "occluded": (
            "occluded is_occluded occlusion hidden is_hidden missing is_missing absent"
            " invisible"
        ),
    }.items()
    for name in names.split()
}
"""Name of a column, in small letters and with _ for spaces -> what it holds."""

OF_IMAGES = ("sequence", "item", "frame", "time", "individual")
WEIGHTS = ("confidence", "visible", "occluded")
OF_POINTS = ("x", "y", "z", *WEIGHTS)

_AXIS = (
    "x|y|z|likelihood|confidence|conf|score|visibility|prob|visible|vis|occluded|hidden"
    "|missing|is_visible|is_occluded|is_hidden"
)
_OF_LANDMARK = (
    re.compile(r"(?P<axis>x|y|z|visibility|v|c)_?(?P<name>[0-9]{1,9})", re.I),
    re.compile(rf"(?P<name>.+?)[_.: -](?P<axis>{_AXIS}|v|c)", re.I),
    re.compile(rf"(?P<axis>{_AXIS})[_.: -](?P<name>.+)", re.I),
)
"""Columns of a wide table: x_12, nose_x, x_nose."""

UNNAMED = re.compile(r"(?:Unnamed: \d+)?")
"""What a column without a name is called, as pandas reads it, too."""

MIN_NAME_SIMILARITY = 0.85
"""Similarity of a name to a known one, difflib's ratio, from which on it is a slip."""

SEPARATOR = re.compile(r"sep=([,;\t])\r?", re.I)
"""The first line by which Excel knows the delimiter."""

Axes = Mapping[str, int]
"""What a landmark has (x, y, z, confidence ...) -> its column."""

Body = Mapping[str, Axes]
"""The landmarks of a wide table that belong together -> their axes."""


class Header(NamedTuple):
    """The columns of a table: their names, role -> column, the bodies of a wide table.

    A long table, with a row per landmark, has no bodies. `line` is the number of the
    line of names.
    """

    delimiter: str
    line: int
    names: Sequence[str]
    roles: Mapping[str, int]
    bodies: Sequence[Body]

    @property
    def is_long(self) -> bool:
        """Whether the table has a row per landmark, not per image."""
        return not self.bodies

    @property
    def is_triangulated(self) -> bool:
        """Whether the table has anipose's columns of the number of cameras."""
        return any(name.endswith("_ncams") for name in self.names)

    def describe(self, column: int) -> str:
        """Return how messages name a column, by its index."""
        return f"'{self.names[column]}'" if self.names[column] else "without a name"

    def list_unused(self, used: Collection[int]) -> list[str]:
        """Return names of columns that are not `used`, with guesses at misspelt ones.

        For instance `likelyhood (likelihood?)`.
        """
        names = []
        for column, name in enumerate(self.names):
            if column not in used:
                near = get_close_matches(
                    name.lower(), ROLES, n=1, cutoff=MIN_NAME_SIMILARITY
                )
                meant = f" ({near[0]}?)" if near and name.lower() not in ROLES else ""
                names.append(name + meant or f"column {column + 1} without a name")
        return names


def parse_header(text: str) -> Header | None:
    """Parse the first line of a table as names of columns; None if it is no header.

    After `sep=;` it is the second line. The columns must be landmark, x and y, or x and
    y of two landmarks at least.
    """
    first, _, rest = text.partition("\n")
    line, delimiters = 1, sorted((",", ";", "\t"), key=first.count, reverse=True)
    if stated := SEPARATOR.fullmatch(first.replace('"', "")):
        line, delimiters = 2, [stated[1]]
        first = rest.partition("\n")[0]
    for delimiter in delimiters:
        with library_reads("the header has a cell without an end"):
            cells = next(csv.reader([first.rstrip("\r")], delimiter=delimiter), [])
        names = [cell.replace('"', "").strip() for cell in cells]
        if header := _interpret_names(delimiter, line, names):
            return header
    return None


class _LandmarkColumn(NamedTuple):
    """A column of a landmark in a wide table."""

    column: int
    landmark: str
    axis: str
    capital: bool


def _interpret_names(delimiter: str, line: int, names: Sequence[str]) -> Header | None:
    """Make a Header of the names of columns; None where none is of a landmark.

    line: the number of the line of names.
    """
    roles: dict[str, int] = {}
    columns: list[_LandmarkColumn] = []
    for column, name in enumerate(names):
        role = ROLES.get(name.lower().replace(" ", "_"))
        matches = (pattern.fullmatch(name) for pattern in _OF_LANDMARK)
        match = next((match for match in matches if match), None)
        if role is not None:
            roles.setdefault(role, column)
        elif match is not None:
            axis = ROLES.get(match["axis"].lower(), "confidence")
            capital = match["axis"].isupper()
            columns.append(_LandmarkColumn(column, match["name"], axis, capital))
    if {"landmark", "x", "y"} <= roles.keys():
        return Header(delimiter, line, names, roles, ())
    bodies = _group_bodies(columns)
    return Header(delimiter, line, names, roles, bodies) if bodies else None


def _group_bodies(columns: Sequence[_LandmarkColumn]) -> list[Body]:
    """Group the columns of landmarks into bodies, the largest first.

    x and X of a landmark are two bodies, as OpenFace has pixels and millimetres; so are
    landmarks with z and without, unless confidences say that z is a guess.
    """
    seen = {(one.landmark, one.axis, one.capital) for one in columns}
    by_case = any((*key[:2], not key[2]) in seen for key in seen)
    bodies: list[Body] = []
    for capital in (False, True) if by_case else (None,):
        landmarks: dict[str, dict[str, int]] = {}
        for one in columns:
            if capital is None or one.capital == capital:
                axes = landmarks.setdefault(one.landmark, {})
                axes.setdefault(one.axis, one.column)
        whole = {
            name: axes for name, axes in landmarks.items() if {"x", "y"} <= {*axes}
        }
        flat = {name: axes for name, axes in whole.items() if "z" not in axes}
        deep = {name: axes for name, axes in whole.items() if "z" in axes}
        guessed = any({*WEIGHTS} & {*axes} for axes in whole.values())
        bodies += [whole] if guessed else [flat, deep]
    return sorted((body for body in bodies if len(body) > 1), key=len, reverse=True)
